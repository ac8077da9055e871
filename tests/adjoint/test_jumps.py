"""Gradients through located events: closed forms, and central differences of runs."""

import numpy as np
import pytest

import polyida as pi

RADAU = pi.RadauIIA(rtol=1e-10, tolerance=1e-13)
SMOOTH = pi.Needs(mass_varies=False, velocity_forces=True, driven=False, phi_q_varies=False)


class Balls(pi.Model):
    """Two equal balls on a line, from x1 and x2, m, with e = 1; q are displacements."""

    n, m, needs = 2, 1, SMOOTH
    row_laws = (pi.RowLaw(0, "balls", restitution=1.0),)
    parameters = "x1", "x2"
    x1, x2 = 0.0, 0.52

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.zeros(2)

    def phi(self, t, q):
        return np.array([self.x2 + q[1] - self.x1 - q[0] - 0.2])

    def phi_q(self, t, q):
        return np.array([[-1.0, 1.0]])


class Ball(pi.Model):
    """A ball that falls in air on a floor."""

    n, m, needs = 1, 1, SMOOTH
    row_laws = (pi.RowLaw(0, "floor", restitution=0.8),)
    parameters = "weight", "floor", "drag", "inertia"
    weight, floor, drag, inertia = 12.0, 0.0, 0.05, 1.3

    def mass(self, q):
        return self.inertia * np.eye(1)

    def force(self, t, q, v):
        return np.array([self.weight]) + self.drag * v

    def phi(self, t, q):
        return q - self.floor

    def phi_q(self, t, q):
        return np.eye(1)


class Free(Ball):
    """The same without its floor."""

    m, row_laws, parameters = 0, (), ("weight", "drag", "inertia")


class Belt(pi.Model):
    """A block on a belt, held by a spring; it sticks to 3 N."""

    n, m, p, needs = 1, 0, 1, pi.Needs(mass_varies=False, velocity_forces=False)
    row_laws = (pi.RowLaw(0, "belt", constant=3.0),)
    parameters = "stiffness", "speed"
    stiffness, speed = 1.0, 1.0

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return self.stiffness * q

    def psi(self, t, q, v):
        return v - self.speed


def last(k):
    """The objective q[k] at the end."""

    def slopes(run):
        q = np.zeros(run.q.shape)
        q[-1, k] = 1.0
        return {"q": q}

    return pi.objective.UserObjective(lambda run: float(run.q[-1, k]), slopes)


def difference(f, d=1e-4):
    """f'(0), of fourth order."""
    return (8.0 * (f(d) - f(-d)) - (f(2 * d) - f(-2 * d))) / (12.0 * d)


def changed(model, **values):
    for name, change in values.items():
        setattr(model, name, getattr(model, name) + change)
    return model


@pytest.mark.parametrize("integrator", [pi.RadauIIA(rtol=1e-8), pi.GeneralizedAlpha(h=0.01)], ids=lambda x: type(x).__name__)
def test_two_balls(integrator):
    """They exchange their velocities: the second ends where the first would be, 0.2 m farther."""
    run = pi.solve(Balls(), 1.0, integrator, v0=[1.0, 0.0])
    slopes = pi.gradient(run, last(1))
    assert slopes["v0"] == pytest.approx([1.0, 0.0], abs=1e-10)
    assert slopes.value == pytest.approx(1.0 + 0.2 - 0.52, abs=1e-12)
    assert [slopes["x1"], slopes["x2"]] == pytest.approx([1.0, -1.0], abs=1e-10)  # of the displacement: 1 and 0 of the place
    assert pi.gradient(run, last(0))["v0"] == pytest.approx([0.0, 1.0], abs=1e-10)


@pytest.mark.parametrize("kind", [Ball, Free])
def test_ball_with_three_bounces(kind):
    """On a row of contact, and by an event of the user with pi.Impact."""
    events = [pi.Event(when=lambda s: s.q[0], then=pi.Impact(restitution=0.8), name="floor")] if kind is Free else []
    solved = lambda speed=0.1, **values: pi.solve(changed(kind(), **values), 1.9, RADAU, q0=[1.0], v0=[speed], events=events)  # noqa: E731
    run, J = solved(), last(0)
    assert len(run.events) == 3
    slopes = pi.gradient(run, J)
    assert abs(slopes["v0"][0] - difference(lambda s: J(solved(0.1 + s)))) < 1e-8
    for name in kind.parameters[:3]:
        assert abs(slopes[name] - difference(lambda s, name=name: J(solved(**{name: s})))) < 2e-8 * max(1.0, abs(slopes[name])), name


def test_stick_and_slip():
    solved = lambda **values: pi.solve(changed(Belt(), **values), 3.6, RADAU)  # noqa: E731
    run, J = solved(), last(0)
    assert [one.name for one in run.events] == ["belt sticks", "belt slips"]
    slopes = pi.gradient(run, J)
    for name in Belt.parameters:
        assert abs(slopes[name] - difference(lambda s, name=name: J(solved(**{name: s})))) < 1e-8, name


def test_mean_over_time_with_alpha():
    """The times of frames move with the event; differences and slopes agree to the order of the method."""

    def weights(t):
        return 0.5 * (np.diff(t, prepend=t[0]) + np.diff(t, append=t[-1]))

    def slopes(run):
        y, q, t = run.q[:, 0] ** 2, np.zeros(run.q.shape), np.zeros(len(run))
        q[:, 0] = 2.0 * weights(run.t) * run.q[:, 0]
        t[1:] += 0.5 * (y[1:] + y[:-1])
        t[:-1] -= 0.5 * (y[1:] + y[:-1])
        return {"q": q, "t": t}

    J = pi.objective.UserObjective(lambda run: float(weights(run.t) @ run.q[:, 0] ** 2), slopes)
    solved = lambda **values: pi.solve(changed(Ball(), **values), 1.1, pi.GeneralizedAlpha(h=2e-3, tolerance=1e-12), q0=[1.0])  # noqa: E731
    found = pi.gradient(solved(), J)
    for name in ("weight", "floor"):
        assert found[name] == pytest.approx(difference(lambda s, name=name: J(solved(**{name: s}))), abs=2e-4, rel=2e-4), name


def pendulum(kind, spin=0.0):
    """A rod on a pin with a mass at its tip, and what happens to it."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    points = {"A": (-0.5, 0.0), "B": (0.5, 0.0)}
    rod = pi.RigidBody(mass=1.0, inertia=1 / 12, points=points, origin=(0.5, 0.0), velocity=(0.0, 0.5 * spin), spin=spin, name="rod")
    scene.add(rod)
    scene.add(pi.Revolute(pi.ground, rod.at("A"), name="pin"))
    scene.add(pi.PointMass(rod.at("B"), 0.3, name="tip"))
    if kind == "contact":
        scene.add(pi.Contact(rod.at("B"), pi.ground.at((0.0, -0.8), direction=(1.0, 0.2)), restitution=0.7, name="stop"))
        return scene.build(), []
    if kind == "impact":
        height = lambda s: s.position("tip")[1] + 0.8 - 0.2 * s.position("tip")[0]  # noqa: E731
        return scene.build(), [pi.Event(when=height, then=pi.Impact(0.7), name="stop")]
    scene.add(pi.SpringDamper(pi.ground.at((1.0, 1.0)), rod.at("B"), stiffness=20.0, name="spring"))
    return scene.build(), [pi.Event(when=lambda s: s.position("tip")[1] + 0.5, then=pi.Remove("spring"), name="loose")]


@pytest.mark.parametrize("kind", ["contact", "impact", "loose"])
def test_pendulum(kind):
    def solved(spin=0.0):
        model, events = pendulum(kind, spin)
        return pi.solve(model, 0.6, RADAU, events=events)

    turning = solved(1.0).v[0]
    run, J = solved(), last(2)
    assert len(run.events) == 1
    assert abs(pi.gradient(run, J)["v0"] @ turning - difference(lambda s: J(solved(s)))) < 1e-8


def test_contact_and_event_have_the_same_slopes():
    masses = []
    for kind in ("contact", "impact"):
        model, events = pendulum(kind)
        masses.append(pi.gradient(pi.solve(model, 0.6, RADAU, events=events), last(2), parameters=["tip.mass"])["tip.mass"])
    assert masses[0] == pytest.approx(masses[1], abs=1e-9)


@pytest.mark.parametrize(
    "slopes, match", [(pi.objective.Slopes(q=np.ones(3)), r"\.q has the shape \(3,\); it must be \(\d+, 4\)"), (np.ones(3), " must return")]
)
def test_wrong_slopes_of_own_objectives_are_refused_by_name(slopes, match):
    class Height(pi.objective.Objective):
        def __call__(self, run):
            return float(run.q[-1, 1])

        def slopes(self, run):
            return lambda part: slopes

    model, events = pendulum("loose")
    run = pi.solve(model, 0.6, RADAU, events=events)
    assert len(run.events) == 1
    with pytest.raises(pi.InputError, match=rf"Height: slopes\(run\)\(part\){match}"):
        pi.gradient(run, Height())


def test_what_has_no_adjoint_is_refused():
    J = last(0)
    run = pi.solve(Ball(), 0.6, pi.NonsmoothAlpha(h=1e-2), q0=[1.0])
    with pytest.raises(pi.InputError, match="'floor' are no equations; time steps pass impacts without locating them"):
        pi.gradient(run, J)
    stop = pi.Event(when=lambda s: s.q[0] - 0.5)
    with pytest.raises(pi.InputError, match="ended at an event"):
        pi.gradient(pi.solve(Free(), 0.6, RADAU, q0=[1.0], events=stop), J)
    scene = pi.Scene(gravity=(0.0, -9.81))
    block = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)}, velocity=(2.0, 0.0), name="block"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), block.at("c"), friction=0.3, name="guide"))
    with pytest.raises(pi.InputError, match="'guide' slips with friction that its pressure gives"):
        pi.gradient(pi.solve(scene.build(), 0.1, RADAU), J)
    with pytest.raises(pi.InputError, match="hit at the start of the run, t = 0 s"):
        pi.gradient(pi.solve(Ball(), 0.1, RADAU, v0=[-1.0]), J)
