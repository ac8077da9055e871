"""Each parameter's slope against differences of what it is the slope of, in scenes that have one of everything."""

import warnings
from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.parameter import AdjointMultipliers, total
from polyida.adjoint.parameters import InitialMotion, in_time, parameters_of
from polyida.model.differences import along

STEEL = pi.Material(E=2e7, nu=0.3, rho=1000.0, viscosity=1e-3, mass_damping=0.4)
SOFT = pi.Material(E=5e6, nu=0.2, rho=800.0, plane="strain")


@dataclass(frozen=True, eq=False)
class Wind(pi.ForceElement):
    """A force of one's own that has a profile's rate in it, and the time."""

    at: object
    gust: pi.profile.Profile
    size: float
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return self.size * np.exp(t) * np.array([[self.gust.d1(t), self.gust.value(t) + self.gust.d2(t)]])


def machine():
    """Two plates, a reduced one, a rigid one and a rigid body in a row, driven, loaded and held by everything."""
    scene = pi.Scene(gravity=(0.4, pi.profile.quintic(0.0, -9.0, 0.3)))
    strip = pi.mesh.quads(1.0, 0.2, 3, 1)
    one = scene.add(pi.Plate(strip, STEEL, 0.01, name="one", spin=1.5))
    two = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.2, cells=5, seed=2), SOFT, 0.02, (1.0, 0.0), name="two", element="virtual"))
    three = scene.add(pi.Reduced(pi.Plate(strip, STEEL, 0.01, (2.0, 0.0)), modes=2, name="three"))
    four = scene.add(pi.Rigid(pi.Plate(strip, SOFT, 0.01, (3.0, 0.0), velocity=(0.1, -0.2)), name="four"))
    bar = scene.add(pi.RigidBody.bar(1.0, 0.3, (4.0, 0.1), name="bar"))
    scene.add(pi.Revolute(pi.ground, one.section("left"), name="hub"))
    scene.add(pi.Prismatic(one.section("right"), two.section("left"), name="slide"))
    scene.add(pi.Weld(two.section("right"), three.section("left"), name="weld"))
    scene.add(pi.Slot(three.section("right"), four.section("left"), name="slot"))
    scene.add(pi.Distance(four.section("left"), bar.at("right"), name="rod"))
    scene.add(pi.AngleMotor(pi.ground, one.section("left"), pi.profile.ramp(0.0, 1.2, 0.5, 0.1), name="motor"))
    scene.add(pi.AngleMotor(three.section("right"), four.section("left"), lambda t: 0.3 * np.sin(4 * t), 0.1, name="own"))
    scene.add(pi.PrescribedPosition(bar.at("center"), pi.profile.sine(0.1, 2.0, 0.3), pi.profile.polynomial([0.1, 0.3, -0.2]), name="path"))
    for body in (one, four):
        scene.add(pi.PointMass(body.section("right"), 0.3, name=f"mass {body.name}"))
    scene.add(pi.PointLoad(three.section("top"), (1.0, -2.0), pi.profile.linear(0.2, 1.0, 0.4), name="load"))
    scene.add(pi.PointLoad(one.section("top"), (1.0, 2.0), name="steady"))
    scene.add(pi.EdgeTraction(two.section("top"), (3.0, -40.0), 2.0, name="traction"))
    scene.add(pi.Torque(two.section("right"), pi.profile.sine(0.3, 3.0), against=four.section("left"), name="torque"))
    scene.add(pi.Force(one.section("right"), (0.5, pi.profile.ramp(0.0, 1.0, 0.1)), follower=True, name="push"))
    scene.add(pi.SpringDamper(one.section("top"), pi.ground.at((0.2, 3.0)), 50.0, 0.3, name="spring"))
    scene.add(pi.PenaltyContact(bar.at("right"), pi.ground.at((0.0, 0.5)), 300.0, 0.1, name="contact"))
    scene.add(Wind(one.section("right"), pi.profile.sine(0.4, 1.0), 3.0, name="wind"))
    return scene.build().with_factors(one=(np.array([1.0, 0.5, 2.0]), np.array([0.3, 1.0, 1.0])))


MODEL = machine()
PARAMETERS = parameters_of(MODEL)


def work_of(model, seed=0, frames=3):
    random = np.random.default_rng(seed)
    x = model.reference
    waves = [random.standard_normal((2, 2)) @ np.array([np.sin(2 * x[:, 0] + k), np.cos(3 * x[:, 1] + k)]) for k in range(4 * frames)]
    q, v, a, w = (np.array([0.02 * wave.T.ravel() for wave in waves[i::4]]) for i in range(4))
    lam, mu, kappa, nu = random.standard_normal((4, frames, model.m))
    return AdjointMultipliers(np.array([0.17, 0.32, 0.55])[:frames], q, 20 * v, 500 * a, lam, w, mu, kappa, nu)


WORK = work_of(MODEL)


LINEAR = (".stiffness", ".mass", ".E", ".rho", ".force", ".traction", ".value", ".amplitude", ".coefficients")


def along_value(parameter, unit, function, linear=False):
    """The derivative of `function(model)` along a unit of a parameter's value."""
    value = np.asarray(parameter.value, float)
    size = abs(float((unit * value).sum())) or 1.0

    def changed(s):
        given = value + s * unit
        return function(parameter.replaced(given if given.ndim else float(given)))

    if linear:
        step = 1e-3 * size
        return (changed(step) - changed(-step)) / (2 * step)
    return along(changed, 0.3 * size, (0.0, np.inf) if parameter.only_by_name and not value.any() else (-np.inf, np.inf))


SEEN = [
    name
    for name, parameter in PARAMETERS.items()
    if not (isinstance(parameter, InitialMotion) or parameter.only_by_name and name.endswith(".scale"))
]


@pytest.mark.parametrize("name", SEEN)
def test_a_slope_is_that_of_the_models(name):
    parameter, random = PARAMETERS[name], np.random.default_rng(3)
    slope, unit = parameter.slope(WORK), random.uniform(0.5, 1.0, np.shape(parameter.value))
    assert np.shape(slope) == np.shape(parameter.value)
    exact = along_value(parameter, unit, lambda model: total(model, WORK), name.endswith(LINEAR))
    noise = 3e-11 * abs(total(MODEL, WORK)) / (np.abs(parameter.value).max() or 1.0)
    assert abs((slope * unit).sum() - exact) <= 1e-8 * abs(exact) + noise


def thrown():
    """Two plates and two rigid bodies on hinges, which change the motions that they were given."""
    scene = pi.Scene()
    strip = pi.mesh.quads(1.0, 0.2, 3, 1)
    one = scene.add(pi.Plate(strip, STEEL, 0.01, name="one", spin=1.5))
    two = scene.add(pi.Plate(strip, SOFT, 0.02, (1.0, 0.0), name="two", velocity=(0.3, 1.0)))
    three = scene.add(pi.Rigid(pi.Plate(strip, SOFT, 0.01, (2.0, 0.0)), name="three"))
    bar = scene.add(pi.RigidBody.bar(1.0, 0.3, (3.0, 0.0), velocity=(1.0, 0.0), name="bar"))
    scene.add(pi.Revolute(one.section("right"), two.section("left"), name="elbow"))
    scene.add(pi.Revolute(two.section("right"), three.section("left"), name="wrist"))
    scene.add(pi.Revolute(three.section("right"), bar.at("left"), name="finger"))
    scene.add(pi.PrescribedPosition(one.node(0), None, pi.profile.sine(0.1, 1.0), name="path"))
    scene.add(pi.AngleMotor(one.section("right"), two.section("left"), pi.profile.linear(0.2, 1.0, 0.4), name="motor"))
    scene.add(pi.PointMass(two.section("right"), 0.3, name="mass"))
    scene.add(pi.PointLoad(two.section("right"), (1.0, 3.0), scene.parts["motor"].angle, name="load"))
    return scene.build().with_factors(one=(None, np.array([0.3, 1.0, 1.0])))


THROWN = thrown()
STARTS, MOVING = (
    parameters_of(THROWN),
    (".velocity", ".spin", ".mass", ".rho", ".thickness", ".inertia", "path.frequency", "path.phase", "motor.start", "motor.duration"),
)


@pytest.mark.parametrize("name", [name for name in STARTS if name.endswith((*MOVING, ".stiffness", ".E"))])
def test_the_start_follows_the_motions_that_are_given_and_the_masses(name):
    parameter, random = STARTS[name], np.random.default_rng(4)
    q, unit, bar = work_of(THROWN).q[0], random.uniform(0.5, 1.0, np.shape(parameter.value)), random.standard_normal(THROWN.n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that joints change the motions
        exact = along_value(parameter, unit, lambda model: bar @ model.initial_velocity(0.17, q))
    found = parameter.start(0.17, q, bar)
    assert np.isclose(
        0.0 if found is None else (found * unit).sum(), exact, rtol=1e-7, atol=1e-12 / np.abs(parameter.value).max(initial=1e-9)
    )
    assert bool(exact) == name.endswith(MOVING)


def test_a_field_of_floats_may_be_given_a_whole_number():
    def slope(size):
        scene = pi.Scene()
        ball = scene.add(pi.RigidBody(1.0, 0.1, {"c": (0.0, 0.0)}, name="ball"))
        scene.add(Wind(ball.at("c"), pi.profile.sine(1.0, 2.0), size, name="wind"))
        scene.add(pi.PointMass(ball.at("c"), 0.1, name="tip"))
        run = pi.solve(scene.build(), 0.1, pi.GeneralizedAlpha(h=0.01))
        return pi.gradient(run, pi.objective.Deviation("tip", lambda t: np.zeros(2)), ["wind.size"])["wind.size"]

    assert slope(2) == pytest.approx(slope(2.0), rel=1e-9) and slope(2) > 0.0


def test_slopes_in_time():
    """Of each entry by itself, beside elements of the scene that are laws of state too."""
    model = driven()
    work = work_of(model)
    for k, found in enumerate(in_time(model, work)):
        entry = AdjointMultipliers(*(x[k : k + 1] for x in work))
        assert np.isclose(found, along(lambda s, entry=entry: total(model, entry._replace(t=entry.t + s)), 0.1), rtol=1e-7)
    sprung = in_time(MODEL, WORK)
    assert np.isclose(sprung[1], along(lambda s: total(MODEL, WORK._replace(t=WORK.t + [0.0, s, 0.0])), 1.0), rtol=1e-7)


def driven():
    scene = pi.Scene(gravity=(pi.profile.sine(9.0, 1.0), 0.0))
    arm = scene.add(pi.Plate(pi.mesh.quads(1.0, 0.2, 2, 1), STEEL, 0.01, name="arm"))
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="hub"))
    scene.add(pi.AngleMotor(pi.ground, arm.section("left"), pi.profile.ramp(0.0, 1.0, 0.2, 0.1), name="motor"))
    scene.add(pi.PointLoad(arm.section("right"), (0.0, 1.0), pi.profile.linear(0.0, 1.0, 0.2, 0.3), name="load"))
    return scene.build()


def test_entries_beside_a_kink_stay_on_their_side():
    """The load's straight move from 0.3 s to 0.5 s: its slope in `begin` is minus its speed inside and nothing outside."""
    model = driven()
    known, speed = parameters_of(model), 1.0 / 0.2
    assert known["load.begin"].kinks(0.0, 1.0) == pytest.approx({0.3: 1.0, 0.5: 1.0})
    assert known["load.duration"].kinks(0.0, 1.0) == pytest.approx({0.5: 1.0})
    assert known["load.duration"].kinks(0.0, 0.4) == {} == known["load.end"].kinks(0.0, 1.0)
    one = work_of(model, frames=1)
    for t, inside in ((0.3 - 1e-14, 0), (0.3 + 1e-14, 1), (0.5 - 1e-14, 1), (0.5 + 1e-14, 0)):
        work = one._replace(t=np.array([t]))
        per_unit = known["load.scale"].slope(work._replace(t=np.array([0.6])))
        assert known["load.begin"].slope(work) == pytest.approx(-inside * speed * per_unit, rel=1e-9, abs=1e-12)


def test_a_gradient_shows_its_scalar_slopes():
    found = pi.Gradient(value=2.5, slopes={"bob.mass": -1.25, "arm.stiffness": np.ones(8)}, left_out={"v0": "why"})
    assert repr(found) == "Gradient(value=2.5, bob.mass: -1.25, arm.stiffness; left out, to be asked for by name: v0)"
