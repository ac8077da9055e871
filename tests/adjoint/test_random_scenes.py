"""The gradient of runs against differences of them, in every parameter at once, over scenes of all joints, bodies and loads."""

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.parameters import parameters_of
from polyida.model.differences import along

T, H = 0.02, 1.25e-3
PLACED = {"motor.start", "motor.phase", "path.start"}  # with another one the scene is not drawn where it begins
JOINTS = [pi.Revolute, pi.Weld, pi.Slot, pi.Prismatic, pi.Clamp, pi.Revolute]

ALPHA = {"tolerance": 1e-13, "rho_inf": 0.8}
STABILISED = pi.GeneralizedAlpha(h=H, form="stabilised", **ALPHA)
INDEX3 = pi.GeneralizedAlpha(h=H, **ALPHA)
RADAU = [pi.RadauIIA(h=2 * H, form=form, tolerance=1e-15) for form in ("ggl", "index3")]


def scene_of(number):
    """A plate on a hinge and a second body behind it, by number: what joins, drives and loads them takes turns."""
    random = np.random.default_rng(number)
    u = lambda low, high: float(random.uniform(low, high))  # noqa: E731
    take = lambda *options: options[number % len(options)]  # noqa: E731
    scene = pi.Scene(gravity=(u(-3, 3), take(u(-9, 9), pi.profile.quintic(0.0, u(-9, 9), 0.0112, -0.01))))

    def plate(name, x, turned):
        mesh = pi.mesh.rectangle(1.0, 0.3, cells=5, seed=number) if number % 2 else pi.mesh.quads(1.0, 0.3, 3, 2)
        damping = {"viscosity": u(1e-4, 1e-3), "mass_damping": u(0.0, 3.0)} if number % 3 else {}
        material = pi.Material(10 ** u(6.5, 8), u(0.1, 0.4), 10 ** u(2.7, 3.3), take("stress", "strain"), **damping)
        moves = {"velocity": (u(-1, 1), u(-1, 1)), "spin": u(-2, 2)} if number % 3 == turned else {}
        element = ("wachspress", "virtual")[(number + turned) % 2]
        return pi.Plate(mesh, material, u(0.005, 0.02), (x, 0.0), name=name, element=element, **moves)

    one, behind = scene.add(plate("one", 0.0, 0)), plate("two", 1.0, 1)
    bar = pi.RigidBody.bar(1.0, 0.5, (1.0, 0.0), spin=0.3, name="two")
    two = scene.add(take(behind, pi.Reduced(behind, modes=2, name="two"), pi.Rigid(behind, name="two"), bar))
    left, right = one.section("left"), one.section("right")
    begin, end = (two.at(name) if two is bar else two.section(name) for name in ("left", "right"))
    scene.add(pi.Revolute(pi.ground, left, name="hub"))
    scene.add(JOINTS[number](right, begin, name="elbow"))
    turns = pi.profile.quintic(0.0, u(0.1, 0.3), 0.0091, 0.0042), pi.profile.sine(u(0.05, 0.2), u(3, 9)), lambda t: 0.3 * np.sin(7 * t)
    if number == 0:
        scene.add(pi.Distance(pi.ground.at((1.5, 1.0)), end, name="rod"))
    elif number == 5:
        scene.add(pi.PrescribedPosition(end, None, pi.profile.ramp(float(end.point[1]), u(0.01, 0.02), 0.01, 0.0041), name="path"))
    else:
        scene.add(pi.AngleMotor(pi.ground, left, take(*turns), name="motor"))
    scene.add(pi.PointMass(take(end, right), u(0.05, 1.0), name="mass"))
    pushes = pi.profile.linear(0.2, 1.0, 0.0087, 0.0031), 1.0, pi.profile.sine(1.0, 30.0)
    scene.add(pi.PointLoad(end, (u(-3, 3), u(-3, 3)), take(*pushes), name="load"))
    scene.add(pi.EdgeTraction(one.section("top"), (u(-9, 9), u(-90, 90)), pi.profile.polynomial([u(0, 1), u(-30, 30)]), name="traction"))
    if number % 2:
        scene.add(pi.SpringDamper(pi.ground.at((1.5, 0.6)), end, u(10, 50), u(0.1, 1.0), name="spring"))
        scene.add(pi.Torque(left, pi.profile.sine(u(0.1, 0.5), u(5, 20)), name="torque"))
        scene.add(pi.Force(right, (u(-1, 1), pi.profile.ramp(0.0, u(0.5, 2.0), 0.0119, -0.003)), follower=number > 2, name="push"))
    return scene


class Weighed:
    """`sum x + x^2` over frames and over q, v, a and lam, x = weights . q and so on, as an objective of one's own."""

    def __init__(self, model):
        random, sizes = np.random.default_rng(1), {"q": (1.0, model.n), "v": (1e-2, model.n), "a": (1e-5, model.n), "lam": (1e-4, model.m)}
        self.weights = {name: size * random.standard_normal(count) for name, (size, count) in sizes.items()}

    def value(self, run):
        along_weights = [np.asarray(getattr(run, name))[1:] @ w for name, w in self.weights.items()]
        return float(sum((x + x**2).sum() for x in along_weights))

    def slopes(self, run):
        found = {name: np.outer(1.0 + 2.0 * np.asarray(getattr(run, name)) @ w, w) for name, w in self.weights.items()}
        for slopes in found.values():
            slopes[0] = 0.0
        return found


def direction(known, slopes, number):
    """{name: change}, of every other parameter as much as moves J like the others do, and how much that is."""
    random, units = np.random.default_rng(2), {}
    for name in sorted(slopes.keys() & known.keys() - PLACED)[1 - number % 2 :: 2]:
        value = np.asarray(known[name].value, float)
        size = known[name].scale(np.zeros(0)) if name.endswith((".begin", ".duration")) else np.where(value, np.abs(value), 1.0)
        units[name] = size * random.uniform(0.5, 1.0, value.shape)
    shares = {name: abs(float(np.sum(slopes[name] * unit))) for name, unit in units.items()}
    share = float(np.median([*shares.values()]))
    return {name: unit * min(1.0, share / shares[name]) if shares[name] else unit for name, unit in units.items()}, share


def changed(model, units, s):
    for name, unit in units.items():
        parameter = parameters_of(model)[name]
        value = parameter.value + s * unit
        model = parameter.replaced(value if np.ndim(value) else float(value))
    return model


@pytest.mark.filterwarnings("ignore:the joints do not let", "ignore::polyida.ReductionWarning")
@pytest.mark.parametrize(("number", "integrator"), [*enumerate([STABILISED, INDEX3] * 3), *enumerate(RADAU, 2)])
def test_a_gradient_is_that_of_the_run(number, integrator):
    model = scene_of(number).build()
    weighed = Weighed(model)
    J = pi.objective.UserObjective(weighed.value, weighed.slopes)
    run = pi.solve(model, T, integrator)
    gradient = pi.gradient(run, J)
    assert gradient.value == J(run)
    units, share = direction(parameters_of(model), gradient.slopes, number)
    exact = along(lambda s: J(pi.solve(changed(model, units, s), T, integrator)), 1.0)
    found = sum(np.sum(gradient[name] * unit) for name, unit in units.items())
    assert abs(found - exact) <= 1e-6 * share
