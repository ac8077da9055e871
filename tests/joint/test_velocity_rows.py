"""Velocity rows of joints: rolling discs and skates against closed forms, in every integrator."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import polyida as pi

G, RADIUS = 9.81, 0.1
FOUR = (pi.RadauIIA(rtol=1e-9), pi.GeneralizedAlpha(h=1e-3), pi.IDA(rtol=1e-9), pi.EnergyMomentum(h=1e-3))


def slope(angle=0.35, inertia=0.01, side=1.0, brake=None):
    """(model of a disc of 2 kg on a slope, the slope's direction)."""
    along = np.array([np.cos(angle), -np.sin(angle)])
    scene = pi.Scene(gravity=(0.0, -G))
    at = RADIUS * np.array([-along[1], along[0]])
    disc = scene.add(pi.RigidBody(mass=2.0, inertia=inertia, points={"c": (0.0, 0.0)}, origin=at, name="disc"))
    scene.add(pi.RollingDisc(pi.ground.at((0.0, 0.0), direction=side * along), disc.at("c"), radius=RADIUS, name="contact"))
    if brake is not None:
        scene.add(brake(disc))
    return scene.build(), along


def gone(run, along, joint="contact"):
    """Way along a direction, m."""
    path = run.position(joint)
    return (path[-1] - path[0]) @ along


INTEGRATORS = {  # with the tolerance of the way, m
    "alpha": (pi.GeneralizedAlpha(h=1e-3), 1e-4),
    "alpha stabilised": (pi.GeneralizedAlpha(h=1e-3, form="stabilised"), 1e-4),
    "alpha adaptive": (pi.GeneralizedAlpha(rtol=1e-6), 1e-4),
    "alpha kkt": (pi.GeneralizedAlpha(h=4e-3, linear="kkt"), 1e-4),
    "Radau": (pi.RadauIIA(rtol=1e-9), 1e-9),
    "Radau index3": (pi.RadauIIA(rtol=1e-9, form="index3"), 1e-9),
    "Radau kkt": (pi.RadauIIA(rtol=1e-9, linear="kkt"), 1e-9),
    "Radau 2": (pi.RadauIIA(rtol=1e-7, stages=2), 1e-5),
    "IDA": (pi.IDA(rtol=1e-9), 1e-7),
    "IDA kkt": (pi.IDA(rtol=1e-9, linear="kkt"), 1e-7),
    "IDA whole": (pi.IDA(rtol=1e-9, linear="whole"), 1e-7),
    "IDA ggl1": (pi.IDA(rtol=1e-9, form="ggl1"), 1e-7),
    "IDA index2": (pi.IDA(rtol=1e-9, form="index2"), 1e-7),
    "IDA index1": (pi.IDA(rtol=1e-9, form="index1"), 1e-6),
    "IDA baumgarte": (pi.IDA(rtol=1e-9, form="baumgarte"), 1e-6),
    "energy": (pi.EnergyMomentum(h=1e-3), 1e-4),
}


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_disc_rolls_down_a_slope(name):
    integrator, tolerance = INTEGRATORS[name]
    inertia, angle, t = 0.013, 0.4, 0.25
    model, along = slope(angle, inertia)
    run = pi.solve(model, t, integrator)
    assert run.success, run.message
    rate = G * np.sin(angle) / (1.0 + inertia / (2.0 * RADIUS**2))
    assert abs(gone(run, along) - rate * t**2 / 2.0) < tolerance
    friction, normal = 2.0 * (rate - G * np.sin(angle)), 2.0 * G * np.cos(angle)
    assert run.reaction("contact")[-1] == pytest.approx(friction * along + normal * np.array([-along[1], along[0]]), rel=1e-2)
    assert run.energy.total[[0, -1]] == pytest.approx(run.energy.total[0], abs=10 * tolerance)
    velocity_drift = model.phi_rate(run.t[-1], run.q[-1], run.v[-1])[model.velocity_rows]
    assert run.drift.max() < 1e-6 and np.abs(velocity_drift).max() < 1e-3


def test_friction_of_a_homogeneous_disc_is_a_third_of_the_downhill_force():
    angle = 0.35
    for side in (1.0, -1.0):
        model, along = slope(angle, side=side)
        run = pi.solve(model, 1.0, pi.RadauIIA(rtol=1e-9))
        assert gone(run, along) == pytest.approx(G * np.sin(angle) / 3.0, abs=1e-9)
        assert run.reaction("contact")[-1] @ along == pytest.approx(-2.0 * G * np.sin(angle) / 3.0, abs=1e-8)
    assert model.labels == ["contact normal", "contact friction", "disc length"] and model.units[1] == "N"


class Sleigh:
    """Chaplygin's sleigh: a skate at the distance d behind the centre of mass; its closed form."""

    mass, inertia, d, speed, spin = 1.3, 0.2, 0.4, 0.7, 1.1

    def __init__(self):
        m, scene = self.mass, pi.Scene(gravity=(0.0, 0.0))
        start = {"velocity": (self.speed, self.spin * self.d), "spin": self.spin}
        points = {"knife": (-self.d, 0.0), "centre": (0.0, 0.0)}
        self.body = scene.add(pi.RigidBody(mass=m, inertia=self.inertia, points=points, origin=(self.d, 0.0), name="sleigh", **start))
        scene.add(pi.Skate(self.body.at("knife"), name="knife"))
        self.model = scene.build()
        self.whole = self.inertia + m * self.d**2
        self.c = np.sqrt(self.speed**2 + self.whole / m * self.spin**2)
        self.k, self.delta = self.d * m * self.c / self.whole, np.arctanh(self.speed / self.c)

    def errors(self, run):
        """Errors of (angle, rad; speed, m/s; force, N) at the end."""
        x, m = self.k * run.t[-1] + self.delta, self.mass
        turned = [2.0 * np.arctan(np.tanh(at / 2.0)) for at in (x, self.delta)]
        angle = np.sqrt(m / self.whole) * self.c / self.k * (turned[0] - turned[1])
        speed, spin = self.c * np.tanh(x), np.sqrt(m / self.whole) * self.c / np.cosh(x)
        ahead = np.array([np.cos(angle), np.sin(angle)])
        bar = run.position(self.body.at("centre"))[-1] - run.position(self.body.at("knife"))[-1]
        off = np.arctan2(ahead[0] * bar[1] - ahead[1] * bar[0], ahead @ bar)
        force = run.reaction("knife")[-1] @ np.array([-ahead[1], ahead[0]])
        velocity = self.model.displacement("knife", run.v[-1])
        return np.abs([off, velocity @ ahead - speed, force - m * speed * spin * self.inertia / self.whole])


@pytest.mark.parametrize(
    "make, steps, orders",
    [
        (lambda h: pi.GeneralizedAlpha(h=h, tolerance=1e-14), (0.02, 0.01), (2.0, 2.0, 2.0)),
        (lambda h: pi.GeneralizedAlpha(h=h, form="stabilised", tolerance=1e-14), (0.02, 0.01), (2.0, 2.0, 2.0)),
        (lambda h: pi.EnergyMomentum(h=h), (0.02, 0.01), (2.0, 2.0, 2.0)),
        (lambda h: pi.RadauIIA(h=h, tolerance=1e-14), (0.1, 0.05), (5.0, 5.0, 5.0)),
        (lambda h: pi.RadauIIA(h=h, form="index3", tolerance=1e-14), (0.1, 0.05), (5.0, 5.0, 5.0)),
        (lambda h: pi.RadauIIA(h=h, stages=2, tolerance=1e-14), (0.1, 0.05), (3.0, 3.0, 3.0)),
    ],
    ids=["alpha", "alpha stabilised", "energy", "Radau 3", "Radau 3 index3", "Radau 2"],
)
def test_orders_on_chaplygins_sleigh(make, steps, orders):
    sleigh = Sleigh()
    one, two = (sleigh.errors(pi.solve(sleigh.model, 2.0, make(h))) for h in steps)
    assert np.log2(one / two) == pytest.approx(np.array(orders), abs=0.15 if orders[0] == 2.0 else 0.25)


def test_tolerances_on_chaplygins_sleigh():
    sleigh = Sleigh()
    errors = [sleigh.errors(pi.solve(sleigh.model, 2.0, pi.IDA(rtol=rtol))).max() for rtol in (1e-5, 1e-7, 1e-9)]
    assert errors[1] < 0.1 * errors[0] and errors[2] < 1e-8
    assert sleigh.errors(pi.solve(sleigh.model, 2.0, pi.RadauIIA(rtol=1e-9))).max() < 1e-9


@pytest.mark.parametrize(
    "integrator, allowed", [(pi.EnergyMomentum(h=0.01), 1e-11), (pi.GeneralizedAlpha(h=0.01), 2e-4), (pi.RadauIIA(rtol=1e-9), 1e-8)]
)
def test_a_sleigh_keeps_its_energy(integrator, allowed):
    run = pi.solve(Sleigh().model, 20.0, integrator)
    assert np.ptp(run.energy.total) < allowed


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=0.01, form="stabilised"), pi.RadauIIA(h=0.01)])
def test_a_disc_that_turns_far_in_a_step_is_in_no_singular_position(integrator):
    scene = pi.Scene(gravity=(0.0, -G))
    start = {"velocity": (30.0, 0.0), "spin": -300.0, "origin": (0.0, 0.1)}
    disc = scene.add(pi.RigidBody(mass=2.0, inertia=0.01, points={"c": (0.0, 0.0)}, name="disc", **start))
    scene.add(pi.RollingDisc(pi.ground.at((0.0, 0.0)), disc.at("c"), radius=0.1, name="contact"))
    run = pi.solve(scene.build(), 0.2, integrator)
    assert run.status == "done", run.message
    assert run.velocity_drift.max() < 1e-11


@pytest.mark.parametrize("inside", [True, False])
def test_a_disc_rolls_on_a_circle(inside):
    """`(1 + J/(m r^2)) m l angle'' = -m g sin(angle)`, l the distance of the centres, at the bottom of a hollow or on top of a hill."""
    from scipy.integrate import solve_ivp

    circle, mass, inertia, begin = 0.5, 2.0, 0.012, 0.6
    distance = circle - RADIUS if inside else circle + RADIUS
    angle = begin - np.pi / 2 if inside else np.pi / 2 - begin
    scene = pi.Scene(gravity=(0.0, -G))
    at = distance * np.array([np.cos(angle), np.sin(angle)])
    disc = scene.add(pi.RigidBody(mass=mass, inertia=inertia, points={"c": (0.0, 0.0)}, origin=at, name="disc"))
    scene.add(pi.RollingDisc(pi.ground.at((0.0, 0.0)), disc.at("c"), radius=RADIUS, circle=circle, name="contact"))
    run = pi.solve(scene.build(), 0.6, pi.RadauIIA(rtol=1e-10))
    factor = G / distance / (1.0 + inertia / (mass * RADIUS**2))
    ode = solve_ivp(lambda t, y: (y[1], -factor * np.cos(y[0])), (0.0, 0.6), (angle, 0.0), rtol=1e-12, atol=1e-13)
    end = run.position("contact")[-1]
    assert np.arctan2(end[1], end[0]) == pytest.approx(ode.y[0, -1], abs=1e-8)
    assert run.energy.total[-1] == pytest.approx(run.energy.total[0], abs=1e-8)


def test_a_disc_rolls_on_a_cart():
    """The cart feels a third of the disc's mass."""
    scene = pi.Scene(gravity=(0.0, -G))
    cart = scene.add(pi.RigidBody(mass=3.0, inertia=1.0, points={"c": (0.0, 0.0)}, name="cart"))
    disc = scene.add(pi.RigidBody(mass=1.5, inertia=0.5 * 1.5 * RADIUS**2, points={"c": (0.0, 0.0)}, origin=(0.2, RADIUS), name="disc"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0)), cart.at("c"), name="rail"))
    scene.add(pi.PointLoad(cart.at("c"), (7.0, 0.0), name="push"))
    scene.add(pi.RollingDisc(cart.at("c"), disc.at("c"), radius=RADIUS, name="contact"))
    run = pi.solve(scene.build(), 0.5, pi.RadauIIA(rtol=1e-9))
    assert gone(run, [1.0, 0.0], "push") == pytest.approx(7.0 / (3.0 + 1.5 / 3.0) * 0.5**2 / 2.0, abs=1e-9)
    assert gone(run, [1.0, 0.0], "contact") == pytest.approx(7.0 / (3.0 + 1.5 / 3.0) * 0.5**2 / 6.0, abs=1e-9)


@dataclass(frozen=True, eq=False)
class Brake(pi.ForceElement):
    """A force `-c x'` at a point, in Python."""

    at: Any
    c: float
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return -self.c * v


@pytest.mark.parametrize("integrator", FOUR, ids=lambda one: type(one).__name__)
def test_velocity_rows_beside_forces_in_python(integrator):
    """`(m + J/r^2) x'' + c x' = m g sin(angle)`."""
    model, along = slope(angle=0.5, brake=lambda disc: Brake(disc.at("c"), 4.0, name="brake"))
    run = pi.solve(model, 0.25, integrator)
    assert run.success, run.message
    rate, last = 4.0 / (2.0 + 0.01 / RADIUS**2), 2.0 * G * np.sin(0.5) / 4.0
    assert gone(run, along) == pytest.approx(last * (0.25 - (1.0 - np.exp(-rate * 0.25)) / rate), abs=2e-5)


class Gears(pi.Joint):
    """No slip between two discs of radius 0.2 and 0.1 m that turn about fixed centres."""

    def velocity_rows(self):
        return [0.2 * pi.cross(self.a.d, self.a.d.rate) + pi.cross(self.b.d, self.b.d.rate) / 10.0]


@dataclass(frozen=True, eq=False)
class Conveyor(pi.Joint):
    """The point moves with a speed, m/s, along the direction of a."""

    speed: Any

    def velocity_rows(self):
        return [pi.dot(self.b.x.rate, self.a.d) - self.speed]


@pytest.mark.parametrize("integrator", FOUR, ids=lambda one: type(one).__name__)
def test_driven_velocity_rows(integrator):
    """A motor turns gears; a conveyor of a given speed and one that follows a profile."""
    scene = pi.Scene(gravity=(0.0, 0.0))
    one = scene.add(pi.RigidBody(mass=1.0, inertia=0.02, points={"c": (0.0, 0.0)}, name="one"))
    two = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.3, 0.0), name="two"))
    for name, gear in (("pin", one), ("other pin", two)):
        scene.add(pi.Revolute(pi.ground, gear.at("c"), name=name))
    scene.add(pi.AngleMotor(pi.ground.at((0.0, 0.0)), one.at("c"), pi.profile.ramp(0.0, 1.0, 0.5), name="motor"))
    scene.add(Gears(one.at("c"), two.at("c"), name="teeth"))
    boxes = [scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(0.0, y), name=f"box {y}")) for y in (1.0, 2.0)]
    for box, speed in zip(boxes, (0.3, pi.profile.polynomial([0.3, 0.2]))):
        scene.add(Conveyor(pi.ground.at((0.0, 0.0)), box.at("c"), speed, name=f"conveyor of {box.name}"))
    model = scene.build()
    run = pi.solve(model, 1.0, integrator)
    assert run.success, run.message
    turned = [float(np.angle(model.place((gear.at("c"), "direction"), run.q)[-1])) for gear in (one, two)]
    assert turned == pytest.approx([1.0, -2.0], abs=5e-5)
    ways = [gone(run, [1.0, 0.0], f"conveyor of {box.name}") for box in boxes]
    assert ways == pytest.approx([0.3, 0.4], abs=1e-6)
    energy = run.energy
    assert energy.total[-1] - energy.total[0] == pytest.approx(sum(work[-1] for work in energy.work.values()), abs=2e-4)


def test_a_steered_skate_on_a_flexible_plate():
    """A plate whose middle is a wheel: all integrators agree, and the wheel does no work."""
    material, mesh = pi.Material(E=5e6, nu=0.3, rho=1100.0), pi.mesh.rectangle(0.5, 0.1, cells=12, seed=1)
    scene = pi.Scene(gravity=(0.0, 0.0))
    plate = scene.add(pi.Plate(mesh, material, 0.01, velocity=(1.0, 0.0), name="plate"))
    scene.add(pi.Skate(plate.section("left"), angle=pi.profile.polynomial([-np.pi / 2, 3.0]), name="wheel"))
    model = scene.build()
    runs = [
        pi.solve(model, 0.1, integrator)
        for integrator in (pi.RadauIIA(rtol=1e-8), pi.GeneralizedAlpha(h=1e-4), pi.IDA(rtol=1e-7), pi.EnergyMomentum(h=1e-4))
    ]
    for run in runs:
        assert run.success, run.message
        assert np.abs(run.q[-1] - runs[0].q[-1]).max() < 2e-4
        assert run.energy.total[-1] == pytest.approx(run.energy.total[0], rel=1e-3)


def test_an_equilibrium_depends_on_the_path_and_small_motions_do_not():
    scene = pi.Scene(gravity=(0.0, -G))
    disc = scene.add(pi.RigidBody(mass=2.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.0, RADIUS), name="disc"))
    scene.add(pi.RollingDisc(pi.ground.at((0.0, 0.0)), disc.at("c"), radius=RADIUS, name="contact"))
    scene.add(pi.SpringDamper(pi.ground.at((1.0, RADIUS)), disc.at("c"), stiffness=50.0, length=1.0 - 1e-3, name="spring"))
    model = scene.build()
    with pytest.warns(UserWarning, match="contact friction the equilibrium depends on the path"):
        rest = pi.static(model)
    assert rest.q[0] == pytest.approx(1e-3, abs=1e-9)
    assert pi.modes(model, state=rest, count=1).frequencies[0] == pytest.approx(np.sqrt(50.0 / 3.0) / (2.0 * np.pi), rel=1e-4)


def test_velocity_rows_in_files(tmp_path):
    model, _ = slope()
    run = pi.solve(model, 0.1, pi.RadauIIA(rtol=1e-6), out=tmp_path / "roll.h5")
    loaded = pi.load(tmp_path / "roll.h5")
    assert np.array_equal(loaded.reaction("contact"), run.reaction("contact"))
    assert loaded.model.velocity_rows.tolist() == [1]


def test_dependent_velocity_rows_are_refused():
    scene = pi.Scene(gravity=(0.0, 0.0))
    box = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, name="box"))
    scene.add(pi.Slot(pi.ground.at((0.0, 0.0)), box.at("c"), name="slot"))
    scene.add(pi.Skate(box.at("c"), name="skate"))
    with pytest.raises(pi.InputError, match="slot.* skate|skate.* slot"):
        pi.solve(scene.build(), 1.0, pi.RadauIIA(rtol=1e-6))


def test_what_cannot_take_velocity_rows_refuses_them():
    model, _ = slope()
    with pytest.raises(pi.InputError, match='form "index3" has no equation for the velocity row contact friction'):
        pi.solve(model, 0.1, pi.IDA(form="index3"))

    class Own:
        def steps(self, model, state, t_end, counts):
            yield state

    with pytest.raises(pi.InputError, match="Own knows no velocity rows"):
        pi.solve(model, 0.1, Own())


MISTAKES = {
    "no rate": ("velocity_rows", lambda a, b: [pi.dot(a.d, b.x)], "row 1 of 1: each product of a velocity row has one factor with .rate"),
    "a rate in phi": ("rows", lambda a, b: [pi.dot(a.d, b.x.rate)], "row 1 of 1: only velocity_rows.. have .rate"),
    "two rates": ("velocity_rows", lambda a, b: [pi.dot(b.d.rate, b.x.rate)], "a product of two rates"),
    "a rate of a rate": ("velocity_rows", lambda a, b: [b.x.rate.rate], "no rate of a rate"),
    "a sum": ("velocity_rows", lambda a, b: [pi.dot(a.d, b.x + b.x.rate)], "added to a rate"),
    "some": ("velocity_rows", lambda a, b: [pi.dot(a.d, b.x.rate) + pi.dot(a.d, b.x)], "each product"),
    "a turned vector": ("velocity_rows", lambda a, b: [pi.dot(a.d, b.d.turned(pi.profile.ramp(0.0, 1.0, 1.0)).rate)], "a profile turns"),
    "a turned rate": ("velocity_rows", lambda a, b: [pi.dot(a.d, b.d.rate.turned(pi.profile.ramp(0.0, 1.0, 1.0)))], "other factor"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_in_velocity_rows_is_named(kind):
    function, formula, words = MISTAKES[kind]
    mistaken = type("Mistaken", (pi.Joint,), {function: lambda self: formula(self.a, self.b)})
    scene = pi.Scene()
    wheel = scene.add(pi.RigidBody(1.0, 1.0, {"rim": (0.5, 0.0)}, name="wheel"))
    scene.add(mistaken(pi.ground.at((0.5, 0.0), direction=(1.0, 0.0)), wheel.at("rim"), name="rail"))
    with pytest.raises(pi.InputError, match=rf"^rail: {function}\(\) of Mistaken.*{words}"):
        scene.build()


def test_a_disc_that_does_not_touch_its_line_is_refused():
    disc = pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(0.0, 0.2), name="disc")
    scene = pi.Scene()
    scene.add(disc)
    scene.add(pi.RollingDisc(pi.ground.at((0.0, 0.0)), disc.at("c"), radius=0.1, name="contact"))
    with pytest.raises(pi.InputError, match="contact: it does not hold at rest.*touches the line"):
        scene.build()
