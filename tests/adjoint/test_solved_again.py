"""Gradients against differences of scenes that are built and solved again with another number."""

import numpy as np
import pytest

import polyida as pi

ALPHA = pi.GeneralizedAlpha(h=5e-3, tolerance=1e-12)
RADAU = pi.RadauIIA(h=1e-2, tolerance=1e-15)
FAR = 3e-4  # of a number, between the scenes: round-off of runs is small beside their change


def error(build, numbers, name, t_end, integrator, objective):
    """Of the slope in a number, relative to the difference of fourth order of scenes built with others."""

    def value(s):
        return objective(pi.solve(build({**numbers, name: numbers[name] * (1 + s * FAR)}), t_end, integrator))

    exact = (8 * (value(1) - value(-1)) - (value(2) - value(-2))) / (12 * FAR * numbers[name])
    found = pi.gradient(pi.solve(build(numbers), t_end, integrator), objective, parameters=[name])
    return abs(found[name] / exact - 1)


def double_pendulum(numbers):
    scene, end = pi.Scene(gravity=(0.0, -9.81)), np.exp(0.3j)
    upper = pi.RigidBody(1.0, 0.1, {"left": (0, 0), "right": (1, 0)}, center=(0.5, 0), angle=0.3, name="upper")
    about = {"center": (0.4, 0.05), "origin": (end.real, end.imag), "angle": -0.5, "name": "lower"}
    lower = pi.RigidBody(numbers["lower.mass"], numbers["lower.inertia"], {"left": (0, 0), "right": (0.8, 0)}, **about)
    scene.add(upper)
    scene.add(lower)
    scene.add(pi.Revolute(pi.ground, upper.at("left"), name="hub"))
    scene.add(pi.Revolute(upper.at("right"), lower.at("left"), name="elbow"))
    scene.add(pi.PointMass(lower.at("right"), 0.2, name="tip"))
    return scene.build()


HEAVY = {"lower.mass": 0.7, "lower.inertia": 0.05}


def test_an_objective_that_other_models_cannot_be_asked_for_is_refused():
    model = double_pendulum(HEAVY)
    point = model.parts["lower"].at("right")
    far = pi.objective.UserObjective(lambda run: float(run.position(point)[-1, 0]), lambda run: {})
    with pytest.raises(pi.InputError, match="value.run. fails for the same frames .* use names of parts"):
        pi.gradient(pi.solve(model, 0.05, ALPHA), far, parameters=["lower.mass"])


def moved_by(kind, where):
    """A plate that a straight move pushes, or turns; both of its kinks lie within the run."""

    def build(numbers):
        move = getattr(pi.profile, kind)(0.0, 0.2, numbers[f"{where}.duration"], numbers[f"{where}.begin"])
        scene = pi.Scene(gravity=(0.0, -3.0))
        plate = scene.add(pi.Plate(pi.mesh.quads(1.0, 0.3, 3, 1), pi.Material(2e7, 0.3, 1000.0), 0.01, name="arm"))
        scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hub"))
        scene.add(pi.PointMass(plate.section("right"), 0.2, name="tip"))
        if where == "motor":
            scene.add(pi.AngleMotor(pi.ground, plate.section("left"), move, name="motor"))
        else:
            scene.add(pi.PointLoad(plate.section("right"), (5.0, 10.0), move, name="load"))
        return scene.build()

    return build


@pytest.mark.parametrize("key", ["begin", "duration"])
@pytest.mark.parametrize(
    ("where", "integrator", "objective"),
    [
        ("load", RADAU, pi.objective.Compliance()),
        ("load", ALPHA, pi.objective.Compliance()),
        ("motor", ALPHA, pi.objective.PeakReaction("hub", p=4)),
    ],
)
def test_kinks_of_a_straight_move(where, key, integrator, objective):
    numbers = {f"{where}.duration": 0.0237, f"{where}.begin": 0.0312}
    assert error(moved_by("linear", where), numbers, f"{where}.{key}", 0.08, integrator, objective) < 1e-5


def reduced(numbers):
    scene = pi.Scene(gravity=(0.0, -9.0))
    material = pi.Material(2e7, numbers["arm.nu"], 1000.0)
    arm = scene.add(pi.Reduced(pi.Plate(pi.mesh.quads(1.0, 0.3, 3, 1), material, 0.01), modes=2, name="arm"))
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="hub"))
    scene.add(pi.PointMass(arm.section("right"), 0.2, name="tip"))
    return scene.build()


@pytest.mark.filterwarnings("ignore::polyida.ReductionWarning")
@pytest.mark.parametrize("objective", [pi.objective.StrainEnergy(), pi.objective.PeakStress(p=4), pi.objective.PeakReaction("hub", p=4)])
def test_modes_of_a_reduced_plate_change_with_poissons_ratio(objective):
    assert error(reduced, {"arm.nu": 0.3}, "arm.nu", 0.03, pi.RadauIIA(h=5e-3, tolerance=1e-15), objective) < 1e-6


@pytest.mark.parametrize(
    "integrator", [pi.GeneralizedAlpha(h=1e-2, tolerance=1e-10), pi.GeneralizedAlpha(h=7.1e-3, tolerance=1e-10), pi.RadauIIA(h=1e-2)]
)
def test_a_motor_whose_speed_jumps_beside_a_path_that_bends(integrator):
    """The path bends at the end of the motor's move: J has a kink in the duration, and its slope is the mean of both sides."""
    angle = pi.profile.linear(0.0, 1.5, duration=0.3)
    scene = pi.Scene(gravity=(0.0, -9.81))
    crank = scene.add(pi.RigidBody(1.0, 0.5, {"hub": (-0.5, 0.0), "knee": (0.5, 0.0)}, name="crank"))
    rod = scene.add(pi.RigidBody(0.3, 0.05, {"knee": (-0.5, 0.0), "tip": (0.5, 0.0)}, origin=(1.0, 0.0), name="rod"))
    scene.add(pi.Revolute(pi.ground.at((-0.5, 0.0)), crank.at("hub"), name="hub"))
    scene.add(pi.AngleMotor(pi.ground.at((-0.5, 0.0)), crank.at("hub"), angle=angle, name="motor"))
    scene.add(pi.Revolute(crank.at("knee"), rod.at("knee"), name="joint"))
    scene.add(pi.TorsionSpring(crank.at("knee"), rod.at("knee"), stiffness=20.0, damping=0.05, name="spring"))
    run = pi.solve(scene.build(), 0.35, integrator)
    bent = pi.objective.Deviation(rod.at("tip"), lambda t: (np.cos(angle.at(t)[0]), np.sin(angle.at(t)[0])))
    at = int(np.argmin(np.abs(run.t - 0.3)))
    near = np.zeros((len(run), 1))
    near[at - 1 : at + 2, 0] = 1.0, 3.0, 2.0  # frames at the jump and on both sides of it
    ways = {name: near * np.cos(np.arange(getattr(run, name).shape[1])) for name in ("v", "a", "lam")}
    states = pi.objective.UserObjective(lambda run: sum(float(np.sum(way * getattr(run, n))) for n, way in ways.items()), lambda run: ways)
    for objective in (bent, pi.objective.PeakReaction("motor", p=8), states):
        errors = pi.check_gradient(run, objective, parameters=["motor.end", "motor.duration"])
        assert len(errors) == 2 and max(errors.values()) < 1e-6, errors
