"""Forces of one's own: in every integrator, in energies and derivatives, in files; and what is wrong with one is told."""

from dataclasses import dataclass

import numpy as np
import pytest
from numba import njit

import polyida as pi
from polyida.assembly import own_laws as laws


@dataclass(frozen=True, eq=False)
class Pull(pi.ForceElement):
    """A spring and a damper between two points, N, of rest length 0."""

    a: object
    b: object
    k: float = 20.0
    d: float = 0.0
    name: str | None = None

    def sides(self):
        return (self.a, self.b)

    def forces(self, t, x, v):
        pull = self.k * (x[1] - x[0]) + self.d * (v[1] - v[0])
        return np.stack((pull, -pull))

    def energy(self, x):
        return 0.5 * self.k * float((x[1] - x[0]) @ (x[1] - x[0]))


@dataclass(frozen=True, eq=False)
class Exact(Pull):
    """The same with its derivatives."""

    def forces_x(self, t, x, v):
        return self.k * np.einsum("ab,ij->aibj", [[-1.0, 1.0], [1.0, -1.0]], np.eye(2))

    def forces_v(self, t, x, v):
        return self.d * np.einsum("ab,ij->aibj", [[-1.0, 1.0], [1.0, -1.0]], np.eye(2))


@dataclass(frozen=True, eq=False)
class Push(pi.ForceElement):
    """Forces by any function of t, x and v."""

    at: object
    function: object
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return self.function(t, x, v)


def pulled(scenes, kind=Pull, **options):
    scene, upper = scenes.hinged()
    scene.add(kind(pi.ground.at((0.5, -2.0)), upper.section("right"), **options))
    return scene.build()


def test_a_constant_force_is_a_point_load(scenes):
    ends = []
    for make in (lambda at: pi.PointLoad(at, (0.0, 3.0)), lambda at: Push(at, lambda t, x, v: np.array([[0.0, 3.0]]))):
        scene, upper = scenes.hinged()
        scene.add(make(upper.section("right")))
        run = pi.solve(scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-10))
        assert run.success, run.message
        ends.append(run.q[-1])
    assert np.abs(ends[0] - ends[1]).max() < 1e-9


def test_energy_is_kept_and_counts_it(scenes):
    run = pi.solve(pulled(scenes), 0.2, pi.EnergyMomentum(h=2e-3))
    assert np.ptp(run.energy.total) < 1e-9 * np.ptp(run.energy.potential)
    assert run.energy.potential[0] == pytest.approx(0.5 * 20.0 * (0.5**2 + 2.0**2), rel=1e-9)


def test_derivatives(scenes):
    state = pi.solve(pulled(scenes, d=2.0), 0.02, pi.GeneralizedAlpha(h=1e-3)).state
    for kind in (Pull, Exact):
        found = pi.check_derivatives(pulled(scenes, kind, d=2.0), q=state.q, v=state.v)
        assert max(found.values()) < 1e-6


WRONG = {
    "must return real numbers of shape": lambda t, x, v: np.zeros(2),
    "writes into its arguments": lambda t, x, v: np.multiply(x, 0.0, out=x),
    "gave numbers that are not finite": lambda t, x, v: np.nan * x,
}


@pytest.mark.parametrize("words", WRONG)
def test_what_is_wrong_is_told_before_the_run(scenes, words):
    scene, upper = scenes.hinged()
    scene.add(Push(upper.section("right"), WRONG[words], name="push"))
    with pytest.raises(pi.InputError, match=f"push.*{words}|{words}.*push|push.*gave numbers"):
        pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=1e-3))


def test_parts_are_looked_at(scenes):
    class Bare(pi.ForceElement):
        pass

    scene, upper = scenes.hinged()
    with pytest.raises(pi.InputError, match="field `name"):
        scene.add(Bare())
    for side in (upper, pi.ground, 3.0, None):
        scene, upper = scenes.hinged()
        scene.add(Pull(upper.section("right"), side, name="pull"))
        with pytest.raises(pi.InputError, match="pull"):
            scene.build()
    scene, upper = scenes.hinged()
    scene.add(Pull(upper.section("right"), scenes.plate("other").section("left"), name="pull"))
    with pytest.raises(pi.InputError, match="not in the scene"):
        scene.build()


@pi.compiled
@dataclass(frozen=True, eq=False)
class Compiled(Pull):
    """The same, compiled."""


@pi.compiled
@dataclass(frozen=True, eq=False)
class Wind(pi.ForceElement):
    """A force that depends on time and speed, compiled."""

    at: object
    c: float = 0.2
    w: float = 30.0
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return np.array([[self.c * np.sin(self.w * t), -self.c * v[0, 1] * abs(v[0, 1])]])


def gusty(**functions):
    """A Wind with other functions."""
    return dataclass(frozen=True, eq=False)(type("Other", (Wind,), functions))


@pytest.mark.parametrize(
    "method, apart",
    [
        (pi.GeneralizedAlpha(h=1e-3, tolerance=1e-11, start="plain"), 1e-12),
        (pi.GeneralizedAlpha(h=1e-3, form="stabilised", tolerance=1e-11, start="plain"), 1e-12),
        (pi.EnergyMomentum(h=1e-3), 1e-12),
        (pi.IDA(rtol=1e-8, max_order=5), 1e-7),
        (pi.RadauIIA(rtol=1e-6), 1e-7),
    ],
)
def test_compiled_it_is_the_same_force(scenes, method, apart):
    """As in Python: to what Newton leaves, or the error of steps that IDA chooses; a start has the factor's precision."""
    models = [pulled(scenes, kind, d=2.0) for kind in (Pull, Compiled)]
    assert ["the Python of" in model.remark for model in models] == [True, False]
    runs = [pi.solve(model, 0.02, method) for model in models]
    assert np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < apart
    assert np.allclose(runs[0].energy.total[-1], runs[1].energy.total[-1], rtol=0, atol=30 * apart)


def ceasing(self, t, x, v):
    return np.array([[1.0, 1.0 if t < 5e-3 else np.nan]])


def dividing(self, t, x, v):
    return np.array([[1.0, 1.0 / (0.0 if t > 5e-3 else 1.0)]])


def growing(self, t, x, v):
    return np.zeros((1 if t < 5e-3 else 2, 2))


def raising(self, t, x, v):
    if t > 5e-3:
        raise ValueError("late")
    return np.zeros((1, 2))


@pytest.mark.parametrize("method", [pi.GeneralizedAlpha(h=1e-3), pi.RadauIIA(h=1e-3), pi.EnergyMomentum(h=1e-3), pi.IDA()], ids=repr)
@pytest.mark.parametrize("forces", [ceasing, dividing, growing, raising])
def test_a_compiled_force_that_fails_ends_the_run_at_its_time_and_is_named(scenes, method, forces):
    scene, upper = scenes.hinged()
    scene.add(gusty(forces=forces)(upper.section("right"), name="push"))
    run = pi.solve(scene.build(), 0.02, method)
    assert not run.success and "push" in run.message and 2e-3 < run.t[-1] < 6.5e-3, run.message


def scaling(self, t, x, v):
    v *= -0.1
    return v


def setting(self, t, x, v):
    v[0] = 0.0
    return v


@pytest.mark.parametrize(
    "functions, words",
    [
        ({"forces": scaling}, "scaling writes into its arguments, or into arrays of self; take a copy first"),
        ({"forces": setting}, "setting writes into its arguments, or into arrays of self; take a copy first"),
        ({"forces": lambda self, t, x, v: np.nonsense(v)}, "cannot be compiled by numba: AttributeError: .*nonsense"),
        ({"forces": lambda self, t, x, v: np.zeros((1, 2)) * x.nonsense}, "cannot be compiled by numba.*nonsense"),
        ({"forces": lambda self, t, x, v: v * self.nonsense}, "Other has no field `nonsense`; its fields: at, c, w, name$"),
        ({"forces": lambda self, t, x, v: v * self.at.x}, "`self.at` cannot be read in compiled code; numbers, arrays, .* functions can$"),
        ({"forces": lambda self, t, x, v: 0.0}, "must return an array of 2 dimensions of real numbers"),
        ({"forces": lambda self, t, x, v: x * 1j}, "must return an array of 2 dimensions of real numbers"),
        ({"forces": lambda self, t, x, v: np.zeros((2, 2))}, "forces must return real numbers of shape"),
        ({"forces": lambda self, t, x: x}, "|".join(["positional argument", "its arguments must be"])),
        ({"forces": lambda self, t, places, v: v}, "its arguments must be .self, t, x, v., not 'places'"),
        ({"energy": lambda self, x: x}, "must return a number"),
        ({"energy": lambda self, x: 0.0 if type(x) is list else None}, "cannot be compiled|must return a number"),
    ],
)
def test_what_is_wrong_with_a_compiled_force_is_told(scenes, functions, words):
    scene, upper = scenes.hinged()
    with pytest.raises((pi.InputError, TypeError), match=f"(wind|positional).*({words})|{words}"):
        scene.add(gusty(**functions)(upper.section("right"), name="wind"))
        pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=1e-3))


@pi.compiled
@dataclass(frozen=True, eq=False)
class Everything(pi.ForceElement):
    """Reads numbers, arrays, a profile, a tuple of profiles and a compiled function."""

    at: object
    size: int
    table: object
    move: object
    pair: object
    further: object
    _hidden: float = 0.5
    on: bool = True
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        pull = self.size * self.table[1, 0] + self.move(t) * self._hidden + self.further(x[0, 0]) if self.on else 0.0
        return np.array([[pull, self.pair[0](t) + self.pair[1].value(t) * self.move.value(t)]])


@pi.compiled
def cubed(x):
    return powered(x) + 0.1


def powered(x):
    return x**3


def test_a_compiled_force_reads_its_fields(scenes):
    scene, upper = scenes.hinged()
    wave, table = pi.profile.sine(2.0, 1.5, 0.3), np.arange(6.0).reshape(3, 2)
    scene.add(Everything(upper.section("right"), 3, table, wave, (wave, pi.profile.constant(2.0)), cubed))
    model = scene.build()
    own, q = model.own_forces[0], 0.1 * np.random.default_rng(1).standard_normal(model.n)
    r = np.zeros((model.n_nodes, 2))
    laws.add_own_forces(model.laws, model.arrays.links, model.drives(0.3), q.reshape(-1, 2), 0.0 * r, r)
    expected = -own.A.T @ own.forces(0.3, own.places(q), np.zeros((1, 2))).ravel()
    assert model.compiled and np.abs(expected).max() > 1.0 and np.abs(r.ravel() - expected).max() < 1e-12


def early(self, t, x, v):
    return np.array([[self.pair[0](t - 0.1), 0.0]])


def test_a_profile_is_known_at_the_time_of_the_force_alone(scenes):
    scene, upper = scenes.hinged()
    wave = pi.profile.sine(2.0, 1.5)
    kind = dataclass(frozen=True, eq=False)(type("Early", (Everything,), {"forces": early}))
    scene.add(kind(upper.section("right"), 3, 0.0, wave, (wave, wave), cubed, name="early"))
    run = pi.solve(scene.build(), 0.01, pi.GeneralizedAlpha(h=1e-3))
    assert not run.success


def test_a_function_of_state_may_be_compiled(scenes):
    functions = (
        lambda e, rate: 5.0 * e**3 + 0.3 * rate,
        lambda t, angle, rate: np.sin(angle) - 0.3 * rate + t,
        lambda t, x, v: (x[0] * v[1], t),
    )
    runs = []
    for made in ((lambda f: f,) * 3, (pi.compiled, njit, pi.compiled)):
        scene = pi.Scene()
        body = scene.add(pi.RigidBody(0.5, 0.02, {"A": (0.1, 0.2)}, name="body"))
        at, (further, moment, force) = body.at("A"), (wrap(function) for wrap, function in zip(made, functions))
        scene.add(pi.SpringDamper(pi.ground.at((0.3, 1.0)), at, 30.0, force=further))
        scene.add(pi.Torque(at, moment))
        scene.add(pi.Force(at, force, follower=True))
        model = scene.build()
        assert ("the Python of" in model.remark) != bool(runs)
        runs.append(pi.solve(model, 0.02, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-11, start="plain")))
    assert all(np.abs(run.q - runs[0].q).max() < 1e-11 for run in runs)


def swirl(self, t, x, v):
    return np.array([[self.c * x[0, 1], 0.0]])


def test_the_step_matrix_and_its_transpose_know_laws(scenes):
    scene, upper = scenes.hinged()
    scene.add(gusty(forces=swirl)(upper.section("right"), c=1e6))
    model, b = scene.build(), np.random.default_rng(3).standard_normal((2, 1000))
    system, (q, b) = model.step_matrix(), (1e-4 * b[0, : model.n], b[1, : model.n])
    at = 0.3, q, np.zeros(model.n), np.zeros(model.n), np.zeros(model.m)
    system.factor(*at, 4e6, 2e3)
    S = model.tangent(*at, 4e6, 2e3, 1.0).toarray()
    one, other = (np.linalg.solve(matrix, b) for matrix in (S, S.T))
    assert np.abs(one - other).max() > 1e-2 * np.abs(one).max()
    for transposed, exact in ((False, one), (True, other)):
        assert np.abs(system.solve(q, b, transposed) - exact).max() < 1e-3 * np.abs(exact).max()


@dataclass(frozen=True, eq=False)
class TwiceAsMuch(Pull):
    """Its energy is not that of its force."""

    def energy(self, x):
        return 2.0 * super().energy(x)


@dataclass(frozen=True, eq=False)
class Actuator(Pull):
    """A spring with a force beside its energy."""

    works = True

    def forces(self, t, x, v):
        return super().forces(t, x, v) + [[1.0, 0.0], [-1.0, 0.0]]


@dataclass(frozen=True, eq=False)
class Shaken(Pull):
    """A spring with a force that follows time."""

    def forces(self, t, x, v):
        return super().forces(t, x, v) * (1.0 + 0.1 * np.sin(t))


def test_an_energy_that_is_not_that_of_the_force_is_seen(scenes):
    keeping = pi.EnergyMomentum(h=1e-3)
    model = pulled(scenes, TwiceAsMuch, d=2.0, name="spring")
    assert pi.check_derivatives(model, q=np.zeros(model.n))["energy of spring"] == pytest.approx(0.5, rel=1e-6)
    with pytest.raises(pi.InputError, match="spring: its energy must have minus the forces at v = 0 as its gradient.*works = True"):
        pi.solve(model, 5e-3, keeping)
    for kind in (Pull, Actuator, Shaken):
        model = pulled(scenes, kind, d=2.0, name="spring")
        assert pi.check_derivatives(model, q=np.zeros(model.n)).get("energy of spring", 0.0) < 1e-8
        assert pi.solve(model, 2e-3, keeping).success
