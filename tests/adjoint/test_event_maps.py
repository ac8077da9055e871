"""Slopes through events: each way to locate one and each thing that it does, against closed forms and differences of runs."""

import numpy as np
import pytest

import polyida as pi

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


WHEN = {  # functions that are zero once, between 0.2 and 0.5 s
    "time": lambda s: s.t - 0.31,
    "place": lambda s: s.position("tip")[1] + 0.30,
    "speed": lambda s: s.velocity("tip")[1] + 1.9,
    "reaction": lambda s: s.reaction("pin")[1] + 0.9 - 4.0 * s.position("tip")[1] - 8.0,
    "acceleration": lambda s: s.a[1] + 12.0 * s.q[1] + 7.0,
}
THEN = {
    "remove": lambda scene, rod: pi.Remove("spring", "tip"),
    "joint off": lambda scene, rod: pi.Remove("pin"),
    "weld": lambda scene, rod: pi.Weld(pi.ground, rod.at("B"), name="weld"),
    "pin": lambda scene, rod: [pi.Remove("pin"), pi.Revolute(pi.ground, rod.at("B"), name="late")],
    "impulse": lambda scene, rod: pi.Impulse(rod.at("B"), (0.1, 0.3)),
    "function": lambda scene, rod: lambda s: 0.5 * s.v,
    "damper": lambda scene, rod: pi.SpringDamper(pi.ground.at((0.5, 0.5)), rod.at("B"), stiffness=5.0, damping=0.4, name="late"),
}


def arm(mass, when, then):
    """(model, events) of a rod on a pin, with a spring and a mass at its tip."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    rod = pi.RigidBody(mass=1.0, inertia=1 / 12, points={"A": (-0.5, 0.0), "B": (0.5, 0.0)}, origin=(0.5, 0.0), name="rod")
    scene.add(rod)
    scene.add(pi.Revolute(pi.ground, rod.at("A"), name="pin"))
    scene.add(pi.PointMass(rod.at("B"), mass, name="tip"))
    scene.add(pi.SpringDamper(pi.ground.at((1.0, 1.0)), rod.at("B"), stiffness=3.0, name="spring"))
    return scene.build(), pi.Event(when=WHEN[when], then=THEN[then](scene, rod), name="event")


@pytest.mark.parametrize("then", THEN)
@pytest.mark.parametrize("when", WHEN)
def test_every_event(when, then):
    def solved(change=0.0):
        model, event = arm(0.3 + change, when, then)
        return pi.solve(model, 0.6, pi.RadauIIA(h=0.004, tolerance=1e-14), events=event)

    run, J = solved(), last(1)
    assert run.success and run.events
    found = pi.gradient(run, J, parameters=["tip.mass"])["tip.mass"]
    assert found == pytest.approx(difference(lambda s: J(solved(s))), rel=2e-6, abs=1e-8)


@pytest.mark.parametrize("kind", ["spring", "contact"])
def test_check_gradient_of_a_run_with_events(kind):
    scene, one = body(x=1.0, speed=-1.5)
    if kind == "spring":
        events = pi.Event(**HALF, then=spring_of(one))
    else:
        events = []
        scene.add(pi.Contact(one.at("c"), pi.ground.at((0.6, 0.0), direction=(0.0, 1.0)), restitution=0.7, name="stop"))
    run = pi.solve(scene.build(), 1.0, ALPHA, events=events)
    assert len(run.events) == 1
    errors = pi.check_gradient(run, last(), parameters=["v0"] + ["spring.stiffness"] * (kind == "spring"))
    assert max(errors.values()) < 1e-3
