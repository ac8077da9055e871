"""Gradients of runs against differences of the very same steps, by every way that a run can go."""

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.history import step_history
from polyida.problems.equations import Pendulum

CLOSE = 1e-6  # asked of every parameter; at a tolerance of 1e-10 errors are about 1e-9


def arm(element="wachspress", **material):
    """A soft plate that a motor turns, with a kink in the run, and a mass at its tip."""
    mesh = pi.mesh.rectangle(1.0, 0.25, cells=8, seed=1)
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = scene.add(pi.Plate(mesh, pi.Material(E=3e7, nu=0.3, rho=1100.0, **material), thickness=0.01, element=element, name="arm"))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hub"))
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=pi.profile.quintic(0.0, 1.0, 0.04), name="motor"))
    scene.add(pi.PointMass(plate.section("right"), 0.05, name="tip"))
    return scene.build()


def arm_without_motor():
    """A plate clamped on its left edge."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = scene.add(pi.Plate(pi.mesh.quads(1.0, 0.25, 4, 2), pi.Material(E=3e7, nu=0.3, rho=1100.0), thickness=0.01, name="arm"))
    scene.add(pi.Clamp(pi.ground, plate.section("left"), name="wall"))
    scene.add(pi.PointMass(plate.section("right"), 0.05, name="tip"))
    return scene.build()


MODEL = arm()
DEVIATION = pi.objective.Deviation("tip", (1.0, 0.3))
ALL = DEVIATION + 1e-6 * pi.objective.PeakReaction("motor", p=4) + 1e-3 * pi.objective.StrainEnergy("arm")
RUN = pi.solve(MODEL, 0.06, pi.GeneralizedAlpha(h=4e-3, tolerance=1e-10))
WAYS = {
    "fixed": ({"h": 2.3e-3}, {}),
    "a kink at a whole number of steps": ({"h": 2e-3}, {}),
    "few frames": ({"h": 2e-3}, {"every": 3}),
    "single precision": ({"h": 2e-3}, {"precision": "single"}),
    "cut steps": ({"h": 2e-2, "max_iterations": 2}, {}),
    "changes of h": ({"h": 4e-3, "rtol": 1e-3}, {}),
    "another member": ({"h": 2e-3, "member": (0.0, 0.1, 0.3025, 0.6)}, {}),
    "stabilised": ({"h": 2e-3, "form": "stabilised"}, {}),
    "a plain start": ({"h": 2e-3, "start": "plain"}, {}),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_gradient_is_that_of_the_steps_that_were_taken(way):
    settings, asked = WAYS[way]
    run = pi.solve(MODEL, 0.06, pi.GeneralizedAlpha(tolerance=1e-10, **settings), **asked)
    assert run.success and (run.counts.rejected > 0) == (way in ("cut steps", "changes of h"))
    names = ["arm.stiffness", "arm.mass", "tip.mass", "motor.end", "motor.duration", "v0"]
    errors = pi.check_gradient(run, ALL, parameters=names)
    assert set(errors) == set(names)
    assert max(errors.values()) < CLOSE, errors


def test_value_and_sums():
    run = pi.solve(MODEL, 0.06, pi.GeneralizedAlpha(2e-3))
    found = pi.gradient(run, DEVIATION)
    assert found.value == DEVIATION(run)
    assert found["arm.E"] * 3e7 == pytest.approx(found["arm.stiffness"].sum(), rel=1e-9)
    assert found["arm.rho"] * 1100.0 == pytest.approx(found["arm.mass"].sum(), rel=1e-9)
    assert found["arm.thickness"] * 0.01 == pytest.approx(found["arm.stiffness"].sum() + found["arm.mass"].sum(), rel=1e-9)
    assert found.counts.factorizations <= run.counts.factorizations + 1
    assert found.counts.solves < 4 * run.counts.solves
    assert set(pi.gradient(run, DEVIATION, parameters=["tip.mass"])) == {"tip.mass"}
    assert "arm.stiffness" in repr(found) and "arm.stiffness" in found._repr_html_() and len(found) == len(dict(found.items()))


@pytest.mark.parametrize("form", ["index3", "stabilised"])
def test_segments_between_checkpoints_are_the_same_bit_by_bit(form):
    run = pi.solve(MODEL, 0.3, pi.GeneralizedAlpha(5e-4, form=form), every=20)
    whole = step_history(run, MODEL)
    bytes_of_all = 8 * (3 * MODEL.n + MODEL.m) * len(whole.frames)
    parts = step_history(run, MODEL, bytes_of_all / 2)
    assert parts.segments == whole.segments and np.array_equal(parts.frames, whole.frames)
    for first in range(len(whole.frames) - 100, -1, -100):
        for one, other in zip(whole.states(first, first + 100), parts.states(first, first + 100)):
            assert np.array_equal(one, other)
    found, again = pi.gradient(run, DEVIATION), pi.gradient(run, DEVIATION, memory_limit=bytes_of_all / 2)
    assert all(np.array_equal(found[name], again[name]) for name in found)
    with pytest.raises(pi.InputError, match="memory_limit = .* has no room for checkpoints"):
        pi.gradient(run, DEVIATION, memory_limit=1e3)


def test_adaptive_runs_beyond_memory_are_read_from_their_frames():
    settings = pi.GeneralizedAlpha(4e-3, rtol=1e-4)
    run, few = pi.solve(MODEL, 0.06, settings), pi.solve(MODEL, 0.06, settings, every=5)
    found, again = pi.gradient(run, DEVIATION), pi.gradient(run, DEVIATION, memory_limit=1e4)
    assert all(np.array_equal(found[name], again[name]) for name in found)
    with pytest.raises(pi.InputError, match="keep every step as a frame"):
        pi.gradient(few, DEVIATION, memory_limit=1e4)


def test_a_run_that_failed_has_the_gradient_of_its_frames_and_a_word():
    run = pi.solve(MODEL, 1.0, pi.GeneralizedAlpha(2e-3, rtol=1e-6, max_num_steps=12))
    assert not run.success
    with pytest.warns(UserWarning, match="ended early .too many steps"):
        assert pi.gradient(run, DEVIATION, parameters=["tip.mass"]).value == DEVIATION(run)


def test_a_model_of_ones_own():
    model = Pendulum()
    run = pi.solve(model, 0.5, pi.GeneralizedAlpha(5e-3, tolerance=1e-10), q0=(1.0, 0.0))
    height = pi.objective.UserObjective(lambda run: float(run.q[-1, 1]), lambda run: {"q": np.eye(len(run))[-1][:, None] * (0.0, 1.0)})
    errors = pi.check_gradient(run, height)
    assert errors and max(errors.values()) < CLOSE, errors


@pytest.mark.parametrize(
    ("integrator", "asked", "word"),
    [
        (pi.IDA(1e-4), {}, "IDAS"),
        (pi.EnergyMomentum(2e-3), {}, "no adjoint"),
        (pi.GeneralizedAlpha(2e-3, extrapolate=True), {}, "extrapolate"),
        (pi.GeneralizedAlpha(2e-3), {"output": [0.0, 0.0151, 0.03]}, "between two steps"),
        (pi.GeneralizedAlpha(2e-3), {"until": lambda t, q, v: t - 0.0151}, "between two steps"),
    ],
)
def test_what_has_no_adjoint_is_refused(integrator, asked, word):
    with pytest.raises(pi.InputError, match=word):
        pi.gradient(pi.solve(MODEL, 0.03, integrator, **asked), DEVIATION)


def test_a_state_to_begin_from_is_held():
    hanging = arm_without_motor()
    run = pi.solve(hanging.with_factors(arm=(0.9, 1.1)), 0.06, pi.GeneralizedAlpha(2e-3, tolerance=1e-10), state=pi.static(hanging))
    errors = pi.check_gradient(run, DEVIATION, parameters=["arm.stiffness", "arm.mass", "tip.mass"])
    assert max(errors.values()) < CLOSE and "v0" not in pi.gradient(run, DEVIATION)
    with pytest.raises(pi.InputError, match="'v0' is no parameter"):
        pi.gradient(run, DEVIATION, parameters=["v0"])


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(2e-3), pi.RadauIIA(h=5e-3)])
def test_slopes_in_what_moves_the_constraints_of_a_held_state_are_refused(integrator):
    """The state of a rigid bar that has turned holds z, of which the length is the radius of gyration."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 0.5, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hub"))
    scene.add(pi.TorsionSpring(pi.ground, bar.at("left"), 20.0, name="spring"))
    model = scene.build()
    run, far = pi.solve(model, 0.02, integrator, state=pi.static(model)), pi.objective.Deviation(bar.at("right"), (1.0, 0.0))
    assert pi.gradient(run, far, parameters=["spring.stiffness"])
    for given in (run, pi.solve(model, 0.02, integrator, q0=run.q[0])):
        with pytest.raises(pi.InputError, match="'bar.inertia' .* constraints of the state that the run begins with"):
            pi.gradient(given, far, parameters=["bar.inertia"])


def test_numbers_of_laws_and_places_are_said_to_have_no_slope():
    scene = pi.Scene(gravity=(0.0, -9.81))
    ball = scene.add(pi.RigidBody(1.0, 0.01, {"centre": (0.0, 0.3)}, name="ball"))
    scene.add(pi.Contact(ball.at("centre"), pi.ground.at((0.0, 0.0)), restitution=0.7, friction=0.2, name="floor"))
    run, height = pi.solve(scene.build(), 2e-3, pi.RadauIIA(h=1e-3)), pi.objective.Deviation("floor", (0.0, 0.0))
    for name, value in (("floor.restitution", 0.7), ("floor.friction", 0.2), ("ball.angle", 0)):
        with pytest.raises(pi.InputError, match=f"^gradient: '{name}', which is {value}, has no slope: numbers of laws of contact"):
            pi.gradient(run, height, [name])
    with pytest.raises(pi.InputError, match="'floor.resitution' is no parameter here; known: "):
        pi.gradient(run, height, ["floor.resitution"])


@pytest.mark.parametrize(
    ("slopes", "word"),
    [({"arm.stifness": 1.0}, "'arm.stifness' is no parameter"), ({"arm.mass": 1.0}, r"has shape \(\), the parameter \(8,\)")],
)
def test_own_slopes_in_parameters_are_looked_at(slopes, word):
    with pytest.raises(pi.InputError, match=word):
        pi.gradient(RUN, pi.objective.UserObjective(lambda run: 1.0, lambda run: slopes))


def test_a_motor_that_holds_the_state_of_a_run_is_left_out():
    """With the state held, another start of the motor would jump; its end, to which it moves later, would not."""
    run = pi.solve(MODEL, 0.02, pi.GeneralizedAlpha(2e-3), state=pi.static(MODEL))
    found = pi.gradient(run, DEVIATION)
    assert "moves the constraints of the state" in found.left_out["motor.start"] and "motor.start" not in found
    assert {"motor.end", "motor.duration", "arm.E"} <= {*found}
