"""Each parameter's slope against differences of what it is the slope of, in scenes that have one of everything."""

import numpy as np
import pytest

import polyida as pi
from polyida.gradient.parameters import parameters_of
from polyida.gradient.parameters.parameter import total
from polyida.gradient.parameters.work import Work
from polyida.model.differences import along

STEEL = pi.Material(E=2e7, nu=0.3, rho=1000.0, viscosity=1e-3, mass_damping=0.4)
SOFT = pi.Material(E=5e6, nu=0.2, rho=800.0, plane="strain")


def machine():
    """Two plates, a reduced one, a rigid one and a rigid body in a row, driven, loaded and held by everything."""
    scene = pi.Scene(gravity=(0.4, pi.profile.quintic(0.0, -9.0, 0.3)))
    strip = pi.mesh.quads(1.0, 0.2, 3, 1)
    one = scene.add(pi.Plate(strip, STEEL, 0.01, name="one", spin=1.5))
    two = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.2, cells=5, seed=2), SOFT, 0.02, (1.0, 0.0), name="two", element="virtual"))
    three = scene.add(pi.Reduced(pi.Plate(strip, STEEL, 0.01, (2.0, 0.0)), modes=2, name="three"))
    four = scene.add(pi.Rigid(pi.Plate(strip, SOFT, 0.01, (3.0, 0.0), velocity=(0.1, -0.2)), name="four"))
    bar = scene.add(pi.RigidBody.bar(1.0, 0.3, (4.0, 0.1), name="bar"))
    bodies = one, two, three, four
    scene.add(pi.Revolute(pi.ground, one.section("left"), name="hub"))
    scene.add(pi.Prismatic(one.section("right"), two.section("left"), name="slide"))
    scene.add(pi.Weld(two.section("right"), three.section("left"), name="weld"))
    scene.add(pi.Slot(three.section("right"), four.section("left"), name="slot"))
    scene.add(pi.Distance(four.section("left"), bar.at("right"), name="rod"))
    scene.add(pi.AngleMotor(pi.ground, one.section("left"), pi.profile.ramp(0.0, 1.2, 0.5, 0.1), name="motor"))
    scene.add(pi.AngleMotor(three.section("right"), four.section("left"), lambda t: 0.3 * np.sin(4 * t), name="own"))
    scene.add(pi.Path(bar.at("center"), pi.profile.sine(0.1, 2.0, 0.3), pi.profile.polynomial([0.1, 0.3, -0.2]), name="path"))
    for number, body in enumerate(bodies):
        scene.add(pi.PointMass(body.section("right"), 0.1 + number, name=f"mass {number}"))
        scene.add(pi.PointLoad(body.section("top"), (1.0, -2.0), pi.profile.linear(0.2, 1.0, 0.4), name=f"load {number}"))
    scene.add(pi.PointLoad(one.section("top"), (1.0, 2.0), name="steady"))
    scene.add(pi.EdgeTraction(two.section("top"), (3.0, -40.0), 2.0, name="traction"))
    scene.add(pi.Torque(two.section("right"), pi.profile.sine(0.3, 3.0), against=four.section("left"), name="torque"))
    scene.add(pi.Force(one.section("right"), (0.5, pi.profile.ramp(0.0, 1.0, 0.1)), follower=True, name="push"))
    scene.add(pi.SpringDamper(one.section("top"), pi.ground.at((0.2, 3.0)), 50.0, 0.3, name="spring"))
    scene.add(pi.TorsionSpring(one.section("right"), three.section("left"), 2.0, 0.1, name="torsion"))
    scene.add(pi.Contact(bar.at("right"), pi.ground.at((0.0, 0.5)), 300.0, 0.1, name="contact"))
    return scene.build()


MODEL = machine()
PARAMETERS = parameters_of(MODEL)


def work_of(model, seed=0, frames=3):
    random = np.random.default_rng(seed)
    x = model.reference
    waves = [random.standard_normal((2, 2)) @ np.array([np.sin(2 * x[:, 0] + k), np.cos(3 * x[:, 1] + k)]) for k in range(4 * frames)]
    q, v, a, w = (np.array([0.02 * wave.T.ravel() for wave in waves[i::4]]) for i in range(4))
    lam, mu, kappa, nu = random.standard_normal((4, frames, model.m))
    return Work(np.array([0.17, 0.32, 0.55])[:frames], q, 20 * v, 500 * a, lam, w, mu, kappa, nu)


WORK = work_of(MODEL)


def differences(parameter, work):
    """Of fourth order, of the models with another value."""
    value = np.asarray(parameter.value, float)
    found = []
    for unit in np.eye(value.size).reshape(value.size, *value.shape):
        size = 0.3 * (abs(float((unit * value).sum())) or 1.0)

        def changed(s, unit=unit):
            given = value + s * unit
            return total(parameter.replaced(given if given.ndim else float(given)), work)

        found.append(along(changed, size, (0.0, np.inf) if parameter.asked and not value.any() else (-np.inf, np.inf)))
    return np.reshape(found, value.shape)


@pytest.mark.parametrize("name", PARAMETERS)
def test_a_slope_is_that_of_the_models(name):
    parameter = PARAMETERS[name]
    slope = parameter.work(WORK)
    assert np.shape(slope) == np.shape(parameter.value)
    exact = differences(parameter, WORK)
    assert np.abs(slope - exact).max() <= 1e-8 * np.abs(exact).max() + 1e-12 * abs(total(MODEL, WORK))
