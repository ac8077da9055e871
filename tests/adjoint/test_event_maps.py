"""Slopes through events: each way to locate one and each thing that it does, against closed forms and differences of runs."""

from dataclasses import replace

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint.parameter import Parameter, total, with_part
from polyida.model.differences import along

ALPHA = pi.GeneralizedAlpha(h=5e-3, tolerance=1e-12)
RADAU = pi.RadauIIA(rtol=1e-9, tolerance=1e-13)
BOTH = pytest.mark.parametrize("integrator", [ALPHA, RADAU], ids=lambda one: type(one).__name__)
HALF = dict(when=lambda s: s.t - 0.5, name="half")


def last(k=0):
    """The coordinate q[k] at the end."""

    def slopes(run):
        q = np.zeros(run.q.shape)
        q[-1, k] = 1.0
        return {"q": q}

    return pi.objective.UserObjective(lambda run: float(run.q[-1, k]), slopes)


def difference(f, d=1e-3):
    """f'(0), of fourth order."""
    return (8.0 * (f(d) - f(-d)) - (f(2 * d) - f(-2 * d))) / (12.0 * d)


def body(x=0.0, speed=0.0):
    scene = pi.Scene()
    return scene, scene.add(
        pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, origin=(x, 0.0), velocity=(speed, 0.0), name="body")
    )


def spring_of(one):
    return pi.SpringDamper(pi.ground.at((0.0, 0.0)), one.at("c"), stiffness=4.0, length=0.5, name="spring")


@BOTH
def test_stiffness_of_a_spring_that_is_removed(integrator):
    """x - l = y cos(w t) up to T, then uniform motion: d/dk = dw/dk d/dw (y cos(w T) - y w sin(w T) (1 - T)), w^2 = k."""
    scene, one = body(x=1.0)
    scene.add(spring_of(one))
    run = pi.solve(scene.build(), 1.0, integrator, events=pi.Event(**HALF, then=pi.Remove("spring")))
    w, y, T, left = 2.0, 0.5, 0.5, 0.5
    by_w = -y * T * np.sin(w * T) - y * left * (np.sin(w * T) + w * T * np.cos(w * T))
    found = pi.gradient(run, last(), parameters=["spring.stiffness"])["spring.stiffness"]
    assert found == pytest.approx(by_w / (2 * w), rel=1e-4 if integrator is ALPHA else 1e-7)


@BOTH
def test_stiffness_of_a_spring_that_is_added(integrator):
    """x - l = y cos(w t) + v/w sin(w t) from T on."""
    scene, one = body(x=1.0, speed=-0.3)
    run = pi.solve(scene.build(), 1.0, integrator, events=pi.Event(**HALF, then=spring_of(one)))
    w, y, v, t = 2.0, 1.0 - 0.15 - 0.5, -0.3, 0.5
    by_w = -y * t * np.sin(w * t) + v * (t * np.cos(w * t) / w - np.sin(w * t) / w**2)
    found = pi.gradient(run, last(), parameters=["spring.stiffness"])["spring.stiffness"]
    assert found == pytest.approx(by_w / (2 * w), rel=1e-4 if integrator is ALPHA else 1e-7)


@BOTH
def test_force_before_a_weld_to_the_present_place(integrator):
    """The body stays where it is at T: x = F T^2/(2 m)."""
    scene, one = body()
    scene.add(pi.PointLoad(one.at("c"), (2.0, 0.0), name="load"))
    run = pi.solve(scene.build(), 1.0, integrator, events=pi.Event(**HALF, then=pi.Weld(pi.ground, one.at("c"), name="weld")))
    assert pi.gradient(run, last(), parameters=["load.force"])["load.force"][0] == pytest.approx(0.125, rel=1e-6)


class Falling(pi.Model):
    """A ball in free fall."""

    n, m, parameters = 1, 0, ("g",)
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)
    g = 9.81

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return np.array([self.g])


def test_impact_on_a_moving_table():
    """Between impacts the motion is a parabola; the slopes are those of its closed form, differentiated by complex steps."""
    table = lambda s: s.q[0] - 0.1 * np.sin(5.0 * s.t)  # noqa: E731
    run = pi.solve(Falling(), 0.9, RADAU, q0=[1.0], v0=[0.0], events=pi.Event(when=table, then=pi.Impact(0.8), name="table"))
    assert len(run.events) == 1
    time = complex(run.events.t[0])

    def end(g, v0):
        t = time
        for _ in range(60):  # Newton's method on the complex time of the impact
            gap = 1.0 + v0 * t - 0.5 * g * t * t - 0.1 * np.sin(5.0 * t)
            t = t - gap / (v0 - g * t - 0.5 * np.cos(5.0 * t))
        x, v, of_table = 0.1 * np.sin(5.0 * t), v0 - g * t, 0.5 * np.cos(5.0 * t)
        v = of_table - 0.8 * (v - of_table)
        return x + v * (0.9 - t) - 0.5 * g * (0.9 - t) ** 2

    slopes = pi.gradient(run, last())
    assert slopes["g"] == pytest.approx(end(9.81 + 1e-30j, 0.0).imag / 1e-30, abs=1e-8)
    assert slopes["v0"][0] == pytest.approx(end(9.81, 1e-30j).imag / 1e-30, abs=1e-8)


def falling_rod(mass, then):
    """A rod that falls freely and turns. then: function of the rod -> what happens where its end is 0.05 m below its start."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    ends = {"A": (-0.5, 0.0), "B": (0.5, 0.0)}
    rod = scene.add(pi.RigidBody(mass=mass, inertia=1 / 12, points=ends, origin=(0.5, 0.0), spin=0.4, name="rod"))
    event = pi.Event(lambda s: s.position(rod.at("B"))[1] + 0.05, then(rod), name="low")
    return scene.build(), event


def load_of(rod):
    return pi.PointLoad(rod.at("B"), (1.0, 0.5), name="load")


@BOTH
def test_mass_of_a_body_whose_place_locates_an_event(integrator):
    """The mass moves no place, but the coordinates in which it is told: dx/dm = -F/m^2 (1/2) (T - t)^2, t that of the event."""
    model, event = falling_rod(1.0, load_of)
    run = pi.solve(model, 0.27, integrator, events=event)
    expected = -0.5 * (0.27 - run.events.t[0]) ** 2
    assert pi.gradient(run, last(), parameters=["rod.mass"])["rod.mass"] == pytest.approx(expected, rel=1e-7)
    assert pi.check_gradient(run, last(), parameters=["rod.mass"])["rod.mass"] < 1e-6


PUSHES = {
    "impact": lambda rod: pi.Impact(0.6),
    "impulse": lambda rod: pi.Impulse(rod.at("B"), (0.1, 0.4)),
    "function": lambda rod: lambda s: (0.5 + s.position(rod.at("B"))[1] + 0.1 * s.velocity(rod.at("A"))[1]) * s.v,
}


@pytest.mark.parametrize("push", PUSHES)
def test_mass_of_a_body_that_an_event_pushes_at_a_point(push):
    """The direction of the push in the coordinates depends on the mass, and so does what functions see of places."""

    def end(change):
        model, event = falling_rod(1.0 + change, PUSHES[push])
        return pi.solve(model, 0.2, RADAU, events=event)

    J, run = last(3), end(0.0)
    assert len(run.events) == 1
    assert pi.gradient(run, J, parameters=["rod.mass"])["rod.mass"] == pytest.approx(difference(lambda s: J(end(s))), rel=1e-6)


VALUES = {  # of the parameters of the arm; all are changed at once
    "rod.mass": 1.0,
    "rod.inertia": 1 / 12,
    "tip.mass": 0.3,
    "spring.stiffness": 3.0,
    "element.damping": 0.4,
    "drive.kp": 0.6,
    "push.force": 0.9,
    "load.force": 0.7,
    "late.stiffness": 5.0,
}
WEIGHTS = dict(zip(VALUES, (0.9, -0.6, 1.0, -0.7, 0.6, 0.8, 1.1, -0.9, 0.5)))  # relative changes
WHEN = {  # functions that are zero between 0.15 and 0.3 s
    "time": lambda s: s.t - 0.21,
    "place": lambda s: s.position("tip")[1] + 0.20,
    "speed": lambda s: s.velocity("tip")[1] + 1.8,
    "reaction": lambda s: s.reaction("pin")[0] + 5.0 + 3.0 * s.q[1] - 0.5 * s.t,
    "acceleration": lambda s: s.a[0] + 3.0 - s.q[0],
    "state": lambda s: s.x[0] - 0.5 * s.t * s.t - 0.03,
}


class Arm:
    """A rod on a pin with one part of each kind, and what an event may do to it."""

    def __init__(self, change=0.0):
        value = {name: VALUES[name] * (1.0 + change * WEIGHTS[name]) for name in VALUES}
        self.scene = scene = pi.Scene(gravity=(0.0, -9.81))
        self.rod = rod = pi.RigidBody(
            mass=value["rod.mass"], inertia=value["rod.inertia"], points={"A": (-0.5, 0.0), "B": (0.5, 0.0)}, origin=(0.5, 0.0), name="rod"
        )
        self.end, high = rod.at("B"), pi.ground.at((1.0, 1.0))
        scene.add(rod)
        scene.add(pi.Revolute(pi.ground, rod.at("A"), name="pin"))
        scene.add(pi.PointMass(self.end, value["tip.mass"], name="tip"))
        scene.add(pi.SpringDamper(high, self.end, stiffness=value["spring.stiffness"], name="spring"))
        scene.add(pi.Maxwell(high, self.end, stiffness=8.0, damping=value["element.damping"], name="element"))
        scene.add(pi.PID(rod.at("B"), kp=value["drive.kp"], ki=2.0, kd=0.1, target=0.3, filter=0.02, name="drive"))
        scene.add(pi.PointLoad(self.end, (value["push.force"], 0.2), name="push"))
        self.late = pi.SpringDamper(pi.ground.at((0.5, 0.5)), self.end, stiffness=value["late.stiffness"], damping=0.4, name="late")
        self.load = pi.PointLoad(self.end, (value["load.force"], 0.5), name="load")
        self.mass = pi.PointMass(self.end, 0.2, name="mass")


THEN = {
    "spring off": lambda arm: pi.Remove("spring", "push"),
    "states off": lambda arm: pi.Remove("element", "drive"),
    "mass off": lambda arm: pi.Remove("tip"),
    "joint off": lambda arm: pi.Remove("pin"),
    "spring": lambda arm: arm.late,
    "load": lambda arm: [arm.load, pi.Remove("push")],
    "mass": lambda arm: arm.mass,
    "weld": lambda arm: pi.Weld(pi.ground, arm.end, name="joint"),
    "pin": lambda arm: [pi.Remove("pin"), pi.Revolute(pi.ground, arm.end, name="joint")],
    "slot": lambda arm: [pi.Remove("pin"), pi.Slot(pi.ground, arm.end, name="joint")],
    "guide": lambda arm: [pi.Remove("pin"), pi.Prismatic(pi.ground, arm.end, name="joint")],
    "impulse": lambda arm: pi.Impulse(arm.end, (0.1, 0.3)),
    "function": lambda arm: lambda s: 0.5 * s.v,
}


def solved(when, then, change=0.0):
    arm = Arm(change)
    event = pi.Event(when=WHEN[when], then=THEN[then](arm), name="event")
    return pi.solve(arm.scene.build(), 0.31, pi.RadauIIA(h=0.01, tolerance=1e-14), events=event)


@pytest.mark.parametrize("then", THEN)
@pytest.mark.parametrize("shift", [0, 1])
def test_what_events_do(then, shift):
    """Each with two ways to locate the event. The gradient is that of the motions between events, which other steps make in the run."""
    when = list(WHEN)[(2 * list(THEN).index(then) + 3 * shift) % len(WHEN)]
    run, J = solved(when, then), last(1)
    assert run.success and run.events
    slopes = pi.gradient(run, J, parameters=[name for name in VALUES if name.split(".")[0] in run.model.parts])
    found = sum(np.ravel(slope)[0] * VALUES[name] * WEIGHTS[name] for name, slope in slopes.items())
    assert found == pytest.approx(difference(lambda s: J(solved(when, then, s))), rel=1e-4, abs=1e-7)


@pytest.mark.parametrize("kind", ["spring", "contact"])
def test_check_gradient_of_a_run_with_events(kind):
    scene, one = body(x=1.0, speed=-0.3 if kind == "spring" else -1.5)
    if kind == "spring":
        events = pi.Event(**HALF, then=spring_of(one))
    else:
        events = []
        scene.add(pi.Contact(one.at("c"), pi.ground.at((0.6, 0.0), direction=(0.0, -1.0)), restitution=0.7, name="stop"))
    run = pi.solve(scene.build(), 1.0, ALPHA, events=events)
    assert len(run.events) == 1
    errors = pi.check_gradient(run, last(), parameters=["v0"] + ["spring.stiffness"] * (kind == "spring"))
    assert max(errors.values()) < 1e-6


def test_the_time_of_an_event_of_reactions_is_that_of_consistent_ones():
    """The root of a run with tight tolerance."""

    def time(integrator):
        arm = Arm()
        event = pi.Event(when=WHEN["reaction"], then="stop", name="event")
        return pi.solve(arm.scene.build(), 0.4, integrator, events=event).events.t[0]

    expected = time(pi.RadauIIA(rtol=1e-10, tolerance=1e-14))
    assert time(pi.RadauIIA(rtol=1e-5)) == pytest.approx(expected, abs=1e-5)
    assert time(pi.GeneralizedAlpha(h=2e-3)) == pytest.approx(expected, abs=1e-4)


def test_parameters_that_move_a_given_start_are_refused():
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 0.5, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hub"))
    scene.add(pi.TorsionSpring(pi.ground, bar.at("left"), 20.0, name="spring"))
    model = scene.build()
    event = pi.Event(when=lambda s: s.t - 0.01, then=pi.Remove("spring"), name="off")
    run = pi.solve(model, 0.02, pi.RadauIIA(h=5e-3), state=pi.static(model), events=event)
    assert pi.gradient(run, last(1), parameters=["spring.stiffness"])
    with pytest.raises(pi.InputError, match="'bar.inertia' .* constraints of the state that the run begins with"):
        pi.gradient(run, last(1), parameters=["bar.inertia"])


def test_a_mean_over_time_through_an_event_at_a_place():
    """x = v t until it is d, then d + v/2 s up to the end, s = 1 - d/v: the mean of x^2 is d^3/(3 v) + d^2 s + d v s^2/2 + v^2 s^3/12."""
    scene, one = body(speed=1.0)
    d, v, left, by_v = 0.3, 1.0, 0.7, 0.3
    slower = pi.Event(lambda s: s.position(one.at("c"))[0] - d, lambda s: 0.5 * s.v, name="slower")
    run = pi.solve(scene.build(), 1.0, RADAU, events=slower)
    J = pi.objective.Deviation(one.at("c"), (0.0, 0.0))
    of_time = (d**2 + d * v * left + v**2 * left**2 / 4) * by_v
    exact = -(d**3) / (3 * v**2) + d * left**2 / 2 + v * left**3 / 6 + of_time
    assert pi.gradient(run, J, ["v0"])["v0"][0] == pytest.approx(exact, rel=1e-4)


class Pendulum(pi.Model):
    """A mass on a rod of length L with a torsion spring k; its tip is a named point."""

    n, m, parameters = 1, 0, ("L", "k")
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)

    def __init__(self, L, k):
        self.L, self.k = L, k

    def mass(self, q):
        return np.array([[self.L**2]])

    def force(self, t, q, v):
        return np.array([9.81 * self.L * np.sin(q[0]) + self.k * q[0]])

    def position(self, name, q):
        return self.L * np.stack([np.sin(q[:, 0]), -np.cos(q[:, 0])], axis=1)


@pytest.mark.parametrize("then", [lambda s: (s.position("tip")[0] - 1.1) * s.v, pi.Impact(0.5)], ids=["function", "impact"])
def test_parameters_by_which_an_own_model_places_a_point(then):
    """The length counts in where the tip is, also at a held angle."""

    def solved(L, k=2.0):
        event = pi.Event(lambda s: s.position("tip")[0] - 0.4, then, name="event")
        return pi.solve(Pendulum(L, k), 0.9, RADAU, q0=[1.0], v0=[0.0], events=event)

    run, J = solved(1.3), last()
    assert len(run.events) == 1
    slopes = pi.gradient(run, J)
    assert slopes["L"] == pytest.approx(difference(lambda s: J(solved(1.3 + s))), rel=1e-6)
    assert slopes["k"] == pytest.approx(difference(lambda s: J(solved(1.3, 2.0 + s))), rel=1e-6)


class Stiffness(Parameter):
    """The stiffness of the spring, as a parameter of one's own."""

    def replaced(self, value):
        return with_part(self.model, "spring", replace(self.model.parts["spring"], stiffness=value))

    def slope(self, work):
        return float(along(lambda s: total(self.replaced(self.value + s), work), self.value))


class Heaviness(Stiffness):
    """The same, which is said to move places."""

    changes_coordinates = True


def test_parameters_of_ones_own_through_events():
    """They count where the parts stay the same, and are refused by name if parts change, or if they may move places."""

    def solved(then):
        scene, one = body(x=1.0)
        scene.add(spring_of(one))
        return pi.solve(scene.build(), 1.0, RADAU, events=pi.Event(**HALF, then=then))

    slower, removed = solved(lambda s: 0.5 * s.v), solved(pi.Remove("spring"))
    known = pi.gradient(slower, last(), parameters=["spring.stiffness"])["spring.stiffness"]
    own = pi.gradient(slower, last(), parameters=[Stiffness("own", 4.0, slower.model)])["own"]
    assert own == pytest.approx(known, rel=1e-8)
    with pytest.raises(pi.InputError, match="'own' has no slope: it is one of the whole model, and events change the model"):
        pi.gradient(removed, last(), parameters=[Stiffness("own", 4.0, removed.model)])
    with pytest.raises(pi.InputError, match="'own' has no slope: it may move the places that events read or push"):
        pi.gradient(slower, last(), parameters=[Heaviness("own", 4.0, slower.model)])
    with pytest.raises(pi.InputError, match="error_of: the run has events or impacts, whose times have errors of their own"):
        pi.error_of(slower, last())
