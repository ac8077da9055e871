"""Gradients of equilibria and of modes against differences of those of other models, in every parameter."""

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.parameters import parameters_of
from polyida.errors import StepFailure
from polyida.problems.equations import Pendulum

of = pi.objective


def scene(bent=0.2, element="virtual"):
    """A plate that a motor holds bent up, a reduced one welded to it, weight, a load, a spring and a mass on its end."""
    mesh, material = pi.mesh.rectangle(1.0, 0.2, cells=6, seed=1), pi.Material(5e6, 0.3, 1100.0)
    made = pi.Scene(gravity=(0.0, -9.81))
    beam = made.add(pi.Plate(mesh, material, 0.01, name="beam", element=element))
    low = made.add(pi.Reduced(pi.Plate(mesh, material, 0.01, origin=(1.0, 0.0)), modes=2, name="low"))
    made.add(pi.Revolute(pi.ground, beam.section("left"), name="hub"))
    made.add(pi.AngleMotor(pi.ground, beam.section("left"), angle=pi.profile.constant(bent), name="motor"))
    made.add(pi.Weld(beam.section("right"), low.section("left"), name="elbow"))
    made.add(pi.PointLoad(low.section("right"), (1.0, -3.0), pi.profile.sine(1.0, 0.3, 0.5), name="load"))
    made.add(pi.SpringDamper(pi.ground.at((2.0, 1.0)), low.section("right"), stiffness=30.0, damping=0.0, length=0.9, name="spring"))
    made.add(pi.PointMass(low.section("right"), 0.05, name="tip"))
    return made.build().with_factors(beam=(np.linspace(0.6, 1.5, 6), np.linspace(1.3, 0.7, 6)))


def compare(model, answer, objectives, gradient, asked=()):
    """Each slope against differences; answer: of a model, what the objectives are of. asked: further parameters."""
    here, random = answer(model), np.random.default_rng(2)
    known = parameters_of(model)
    names = [name for name, one in known.items() if name in asked or not one.only_by_name and np.any(one.value)]
    found = [gradient(here, objective, names) for objective in objectives]
    for name in names:
        value = np.array(known[name].value, float)
        way = 2e-4 * random.uniform(0.5, 1.0, value.shape) * np.abs(value)
        ahead, behind = (answer(known[name].replaced((value + s * way)[()])) for s in (1.0, -1.0))
        for objective, slopes in zip(objectives, found):
            expected, size = (objective(ahead) - objective(behind)) / 2, abs(objective(here))
            assert np.sum(slopes[name] * way) == pytest.approx(expected, rel=1e-6, abs=1e-10 * size), (name, objective)


OBJECTIVES = (
    of.Compliance(),
    of.StrainEnergy() + 0.1 * of.PeakReaction("elbow", unit="N m"),
    1e-5 * of.PeakStress(p=4) + of.Deviation("tip", (2.0, 0.5)),
)


@pytest.mark.parametrize("linear", [False, True])
def test_equilibria(linear):
    answer = lambda model: pi.static(model, t=0.3, tolerance=1e-13, linear=linear)  # noqa: E731
    compare(scene(), answer, OBJECTIVES, pi.gradient, ("beam.nu", "beam.tau", "low.E", "spring.length"))


def test_they_are_checked_as_runs_are():
    """The spring's slopes are differences, which third derivatives of its energy tell."""
    model, names = scene(), ["beam.E", "beam.mass", "tip.mass"]
    still, place = pi.static(model, t=0.3), of.Deviation(model.parts["low"].section("right"), (2.0, 0.5))
    subjects = (still, place, 1e-8), (pi.modes(model, still, count=1), of.Frequency(), 1e-5), (pi.modes(scene(0.0)), of.Frequency(), 1e-7)
    for subject, objective, least in subjects:
        errors = pi.check_gradient(subject, objective, names)
        assert list(errors) == names and max(errors.values()) < least


def test_one_solve():
    found = pi.static(scene(), t=0.3)
    assert found.model.n == len(found.q)
    counts = pi.gradient(found, sum(OBJECTIVES[:2])).counts
    assert (counts.factorizations, counts.solves) == (1, 1)


def test_small_displacements_are_linear_in_the_load(scenes):
    made, upper = scenes.cantilever()
    made.add(pi.PointLoad(upper.section("right"), (1.0, -2.0), pi.profile.linear(0.0, 1.0, 1.0), name="load"))
    model = made.build()
    whole, part = pi.static(model, t=1.0, linear=True), pi.static(model, t=1e-5, linear=True)
    assert np.allclose(whole.q, 1e5 * part.q, rtol=1e-12, atol=0.0) and np.allclose(whole.lam, 1e5 * part.lam, rtol=1e-9, atol=1e-9)
    exact = pi.static(model, t=1e-5, tolerance=1e-15)
    assert np.abs(part.q - exact.q).max() < 1e-3 * np.abs(exact.q).max()
    assert "small displacements" in whole.summary() and whole.stable is None
    compliance = pi.gradient(whole, of.Compliance())
    assert compliance["upper.E"] * 50e6 == pytest.approx(-compliance.value, rel=1e-9)
    assert compliance["load.force"] @ (1.0, -2.0) == pytest.approx(2.0 * compliance.value, rel=1e-9)


def test_small_displacements_of_what_moves_freely(scenes):
    with pytest.raises(StepFailure, match="move freely"):
        pi.static(scenes.hinged()[0].build(), linear=True)


@pytest.mark.parametrize("bent", [0.0, 0.2])
def test_modes(bent):
    """At rest, and about an equilibrium that moves with the parameters."""
    answer = (lambda model: pi.modes(model, state=pi.static(model, t=0.3, tolerance=1e-13), count=3)) if bent else pi.modes
    objectives = [of.Frequency(0), of.Frequency(1) - 0.2 * of.Frequency(2) + of.Compliance()]
    compare(scene(bent), answer, objectives, pi.gradient)


def test_modes_of_a_state_that_is_held(scenes):
    model = scenes.cantilever((0.0, -9.81))[0].build()
    still = pi.static(model)
    held = pi.State(0.0, still.q, still.v, still.a, still.lam)
    moving, fixed = (pi.gradient(pi.modes(model, state, count=1), of.Frequency()) for state in (still, held))
    assert fixed.value == moving.value and fixed["upper.rho"] != pytest.approx(moving["upper.rho"], rel=1e-4)
    assert fixed["upper.rho"] * 1100.0 == pytest.approx(-fixed.value / 2, rel=1e-7)


class Hanging(Pendulum):
    """The pendulum: its state depends on its length, and by that its frequency."""

    parameters = ("length", "gravity", "weight")


def test_modes_of_own_models():
    model = Hanging()
    still = pi.static(model, q0=[0.0, -1.0])
    modes = pi.modes(model, still, count=1)
    found = pi.gradient(modes, of.Frequency())
    assert found.value == pytest.approx(np.sqrt(9.81) / (2 * np.pi), rel=1e-9)
    assert found["length"] == pytest.approx(-found.value / 2, rel=1e-6)
    assert found["gravity"] == pytest.approx(found.value / (2 * 9.81), rel=1e-6)
    assert found["weight"] == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize(
    "modes, match",
    [
        (lambda scenes: pi.modes(scenes.hinged()[0].build(), count=2), "a rigid motion, at 0 Hz"),
        (lambda scenes: pi.modes(scenes.cantilever()[0].build(), count=1, damped=True), "these modes are damped"),
        (lambda scenes: pi.modes(twins(), count=1), "shares its .* Hz with another"),
    ],
)
def test_frequencies_without_slopes(scenes, modes, match):
    with pytest.raises(pi.InputError, match=match):
        of.Frequency().slopes(modes(scenes))


def twins():
    """Two equal cantilevers, apart."""
    made, mesh = pi.Scene(), pi.mesh.rectangle(1.0, 0.2, cells=4, seed=1)
    for name in ("one", "other"):
        made.add(pi.Clamp(made.add(pi.Plate(mesh, pi.Material(5e6, 0.3, 1100.0), 0.01, name=name)).section("left")))
    return made.build()
