"""The compiled backward sweep: a scene's products against differences of the residual, steps against those with exact matrices."""

from dataclasses import replace

import numpy as np
import pytest

import polyida as pi
from polyida import environment
from polyida.adjoint import alpha_sweep as loop
from polyida.adjoint.alpha_sweep import AdjointState, Sweep
from polyida.adjoint.dense_steps import DenseAdjoint
from polyida.adjoint.products import products_at, reaction_product
from polyida.errors import REFACTOR
from polyida.model.differences import along
from polyida.model.guarded import guard
from polyida.objective.objective import Slopes
from polyida.system import scene as compiled_loop

H, STEPS = 1e-3, 8
DAMPED = {"viscosity": 1e-3, "mass_damping": 2.0}


def pushed(scene):
    """A scene with loads and force elements too."""
    end, upper = scene.parts["lower"].section("right"), scene.parts["upper"]
    scene.add(pi.SpringDamper(pi.ground.at((1.5, 0.6)), end, 50.0, damping=3.0))
    scene.add(pi.TorsionSpring(upper.section("right"), end, 1.0))
    scene.add(pi.Force(end, (1.0, pi.profile.ramp(0.0, 1.0, duration=0.1)), follower=True))
    scene.add(pi.EdgeTraction(upper.section("top"), (0.0, 30.0), pi.profile.sine(1.0, 4.0)))
    return scene


CASES = {
    "plates": lambda scenes: scenes.jointed("slot", cells=12),
    "virtual": lambda scenes: scenes.jointed("motor between", cells=12, element="virtual"),
    "damped": lambda scenes: scenes.jointed("prismatic", cells=12, element="virtual", material=DAMPED),
    "reduced": lambda scenes: scenes.jointed("distance", cells=12, level="reduced"),
    "damped and reduced": lambda scenes: scenes.jointed("weld", cells=12, level="reduced", material=DAMPED),
    "rigid": lambda scenes: scenes.jointed("path", level="rigid", material=DAMPED),
    "forces": lambda scenes: pushed(scenes.jointed("clamp between", cells=12)),
    "free": lambda scenes: scenes.single(cells=12)[0],
}


@pytest.fixture(params=CASES)
def case(request, scenes):
    """The model of each case in turn."""
    return CASES[request.param](scenes).build()


def bent(model, random):
    """(q, v) some way from rest, smooth within each body."""
    x = model.reference
    shapes = np.stack([np.sin(2 * x[:, 0]), np.cos(3 * x[:, 0] + x[:, 1]), x[:, 0] * x[:, 1]])
    return (0.02 * (random.standard_normal((2, 2, 3)) @ shapes)).transpose(0, 2, 1).reshape(2, -1)


def test_products_are_derivatives_of_the_residual(case):
    random, t = np.random.default_rng(0), 0.05
    (q, v), lam = bent(case, random), random.standard_normal(case.m)
    (w, d), mu, zero = random.standard_normal((2, case.n)), random.standard_normal(case.m), np.zeros(case.n)
    x = products_at(case, case.drives(t), q, v, lam, w, mu)

    def check(product, function, reach=1.0):
        wanted = along(function, reach)
        size = np.abs(product).max(initial=1e-300) * np.abs(d).max()
        assert abs(product.ravel() @ d - wanted) < 1e-7 * size

    check(x.stiff, lambda s: w @ case.residual(t, q + s * d, v, zero, lam) + mu @ case.phi(t, q + s * d), 1e-3)
    check(x.heavy, lambda s: w @ case.residual(t, q, v, s * d, lam))
    if case.needs.velocity_forces:
        check(x.slowing, lambda s: w @ case.residual(t, q, v + s * d, zero, lam))
    assert np.allclose(x.rows, case.phi_q(t, q) @ w, rtol=1e-12)
    assert np.allclose(x.rotation, case.rotation(q), rtol=1e-12)
    assert np.allclose(reaction_product(case, t, lam, w), case.reaction_q(t, q, lam).T @ w, rtol=1e-12, atol=1e-12)


def steps_of(model):
    """(settings, what a sweep goes back over) of a short run and random slopes."""
    settings = pi.GeneralizedAlpha(h=H, tolerance=1e-9)
    run, random = pi.solve(model, STEPS * H, settings), np.random.default_rng(0)
    frames = tuple(np.array(x[1:]) for x in (run.t, run.q, run.v, run.a, run.lam))
    sizes = (1.0, 1e-3, 1e-6, 1e-4)
    own = Slopes(**{name: s * random.standard_normal(x.shape) for name, s, x in zip(("q", "v", "a", "lam"), sizes, frames[1:])})
    return settings, (*frames, [own], [AdjointState(*np.zeros((4, model.n)))])


def exact(model, settings, h, counts):
    """A sweep with a factor of each step's own matrices."""
    return Sweep(model, replace(settings, linear="kkt"), h, counts)


def swept(sweep, steps, keep=False):
    """All that a sweep gives for its last column, as one list of arrays."""
    found = sweep.back(*steps, keep=keep)[-1]
    return [*found.adjoints, found.w, found.mu, *(found.keep if keep else ())]


def agree(found, wanted, tolerance=1e-9):
    return all(np.abs(x - y).max(initial=0) <= tolerance * np.abs(y).max(initial=0) for x, y in zip(found, wanted, strict=True))


def test_a_step_that_no_factor_contracts_is_solved_directly(scenes, monkeypatch):
    model = scenes.jointed("slot", cells=12).build()
    settings, steps = steps_of(model)
    wanted = swept(exact(model, settings, H, pi.Counts()), steps, True)
    compiled, calls = loop.sweep_back, iter(range(99))
    monkeypatch.setattr(loop, "sweep_back", lambda *given: (given[5], REFACTOR) if next(calls) in (0, 2) else compiled(*given))
    assert agree(swept(Sweep(model, settings, H, pi.Counts()), steps, True), wanted)


@pytest.mark.parametrize("columns", [2, 5])
def test_columns_of_other_objectives_change_nothing(case, columns):
    settings, (*frames, own, bars) = steps_of(case)
    scale = np.linspace(1e-12, 1e9, columns - 1)
    others = [Slopes(q=s * own[0].q) if k % 2 else Slopes(lam=s * own[0].lam) for k, s in enumerate(scale)]
    sweep = Sweep(case, settings, H, pi.Counts(), columns)
    together = swept(sweep, (*frames, others + own, bars * columns), True)
    assert agree(together, swept(exact(case, settings, H, pi.Counts()), (*frames, own, bars), True))


def test_two_threads_give_the_same(scenes, monkeypatch):
    monkeypatch.setattr(environment, "cores", lambda: 2)
    monkeypatch.setattr(compiled_loop, "SHARED", 1)
    model = scenes.jointed("revolute").build()
    settings, steps = steps_of(model)
    try:
        alone, together = ((pi.threads(count), swept(Sweep(model, settings, H, pi.Counts()), steps))[1] for count in (1, 2))
    finally:
        pi.threads(1)
    assert agree(together, alone)


@pytest.mark.parametrize(("problem", "by_numba"), [("pendulum", False), ("pendulum", True), ("car-axis", False), ("andrews", False)])
def test_small_models_of_ones_own_take_compiled_steps(problem, by_numba):
    given = pi.problems.get(problem)
    kind, settings, random = type(given.model), pi.GeneralizedAlpha(h=1e-4, tolerance=1e-11), np.random.default_rng(0)
    model = (pi.compiled(type(kind.__name__, (kind,), {})) if by_numba else kind)()
    run = pi.solve(model, STEPS * 1e-4, settings, q0=given.q0, v0=given.v0)
    frames = tuple(np.array(x[1:]) for x in (run.t, run.q, run.v, run.a, run.lam))
    own = Slopes(**{name: random.standard_normal(x.shape) for name, x in (("q", frames[1]), ("lam", frames[4]))})
    steps, model, counts = (*frames, [own], [AdjointState(*np.zeros((4, model.n)))]), guard(model), pi.Counts()
    sweep = Sweep(model, settings, 1e-4, counts)
    assert type(sweep.table) is DenseAdjoint
    assert agree(swept(sweep, steps), swept(exact(model, settings, 1e-4, pi.Counts()), steps), 1e-7)
    assert counts.solves == STEPS
