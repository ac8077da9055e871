"""Every ready force element: derivatives, virtual work, Newton's third law, kernels against Python, files; what is wrong is told."""

import numpy as np
import pytest

import polyida as pi
from polyida.model.differences import along

T = 0.13
WAVE = pi.profile.sine(2.0, 1.5, 0.3)
GUIDE = pi.ground.at((0.3, 1.0), (1.0, 0.2))
BETWEEN = {  # of two bodies: what one does to the other that does to the one
    "spring": lambda a, b: pi.SpringDamper(a, b, 30.0, 2.0, 0.4, 1.5),
    "further spring": lambda a, b: pi.SpringDamper(a, b, 30.0, force=lambda e, rate: 5.0 * e**3 + 0.3 * rate),
    "torsion spring": lambda a, b: pi.TorsionSpring(a, b, 3.0, 0.2, 0.4),
    "line of a body": lambda a, b: pi.PenaltyContact(a, b, 1e3, 0.02, 2.0),
    "motor": lambda a, b: pi.Torque(a, WAVE, against=b),
    "motor of state": lambda a, b: pi.Torque(a, lambda t, angle, rate: 1.0 + np.sin(angle) - 0.3 * rate + 3.0 * t, against=b),
    "circle": lambda a, b: pi.PenaltyContact(a, b, 1e3, 0.02, radius=2.5),
}
ALONE = {
    "spring to ground": lambda a, b: pi.SpringDamper(GUIDE, b, 30.0, 2.0),
    "torsion spring to ground": lambda a, b: pi.TorsionSpring(pi.ground, b, 3.0, 0.2, 0.4),
    "torque": lambda a, b: pi.Torque(a, WAVE),
    "torque of state": lambda a, b: pi.Torque(a, lambda t, angle, rate: np.sin(angle) - 0.3 * rate + 3.0 * t + 1.0),
    "force": lambda a, b: pi.Force(a, (WAVE, -1.0)),
    "follower": lambda a, b: pi.Force(a, (lambda t: t * t, -1.0), follower=True),
    "force of state": lambda a, b: pi.Force(a, lambda t, x, v: (x[0] * v[1], -v[0] + t), follower=True),
    "line": lambda a, b: pi.PenaltyContact(a, GUIDE, 1e3, 0.05),
}
ELEMENTS = BETWEEN | ALONE


def bodies(make):
    """A scene of two rigid bodies and one element on a point of each, away from their centres."""
    scene = pi.Scene()
    for name, at, angle in (("one", (0.0, 0.0), 0.2), ("other", (0.7, 0.3), -0.5)):
        scene.add(pi.RigidBody(0.5, 0.02, {"A": (0.1, 0.2)}, origin=at, angle=angle, name=name))
    one, other = (scene.parts[name].at("A", direction) for name, direction in (("one", (1.0, 0.3)), ("other", (-0.2, -1.0))))
    scene.add(make(one, other))
    return scene.build()


@pytest.fixture(params=ELEMENTS, scope="module")
def made(request):
    """(its name, a model of two rigid bodies with it, itself in its scene)."""
    model = bodies(ELEMENTS[request.param])
    return request.param, model, model.own_forces[0]


def moved(model, seed, size=0.4):
    """(q, v) drawn at random."""
    return size * np.random.default_rng(seed).standard_normal((2, model.n))


def test_derivatives(made):
    _, model, _ = made
    assert max(max(pi.check_derivatives(model, T, *moved(model, seed), seed=seed).values()) for seed in range(2)) < 1e-6
    assert max(pi.check_derivatives(model, T).values()) < 1e-6


def test_a_force_is_the_slope_of_its_energy(made):
    """At rest, along any move; the rest of it with motion only takes energy where it says so."""
    _, model, own = made
    for seed in range(6):
        q, v = moved(model, seed)
        x, speeds = own.places(q), own.velocities(v)
        still, moving = (np.vdot(own.forces(T, x, w), speeds) for w in (0.0 * speeds, speeds))
        if own.element.dissipates:
            assert still == pytest.approx(-along(lambda s, q=q, v=v: own.energy(own.places(q + s * v)), 0.1), rel=1e-6, abs=1e-9)
            assert moving <= still + 1e-12 * abs(still)
        else:
            assert own.energy(x) == 0.0


@pytest.mark.parametrize("name", BETWEEN)
def test_what_one_does_to_the_other_the_other_does_to_the_one(name):
    """Forces on points sum to nothing, and so do moments: x cross f of points, d cross f of directions."""
    own = bodies(BETWEEN[name]).own_forces[0]
    points = np.array([side.part == "point" for side in _sides(own)])
    x, v = np.random.default_rng(5).standard_normal((2, *own.rest.shape))
    f = own.forces(T, x, v)
    moments = x[:, 0] * f[:, 1] - x[:, 1] * f[:, 0]
    assert np.abs(moments).max() > 0.1 and abs(moments.sum()) < 1e-12 * np.abs(moments).max()
    assert np.abs(f[points].sum(axis=0)).max(initial=0.0) < 1e-12 * np.abs(f).max()


def _sides(own):
    from polyida.force.force_element import sides_of

    return sides_of(own.name, own.element)


def test_contact_never_pulls():
    element = bodies(BETWEEN["circle"]).own_forces[0]
    x, leaving = np.array([[2.49, 0.0], [0.0, 0.0]]), np.array([[100.0, 0.0], [0.0, 0.0]])
    assert not element.forces(0.0, x, leaving).any() and element.forces(0.0, x, 0.0 * x)[0, 0] > 0.0
    assert not element.forces(0.0, 1.01 * x, -leaving).any()


def test_a_torsion_spring_holds_less_than_half_a_turn():
    """A free body turned on and on by a torque: the run stops and says by how much it was turned; so does the start of one."""
    scene = pi.Scene()
    rotor = scene.add(pi.RigidBody(1.0, 1.0, {"O": (0.0, 0.0)}, name="rotor"))
    scene.add(pi.Revolute(pi.ground, rotor.at("O")))
    scene.add(pi.TorsionSpring(pi.ground, rotor.at("O"), 1.0, name="coil"))
    scene.add(pi.Torque(rotor.at("O"), 5.0))
    for method in (pi.GeneralizedAlpha(h=1e-2), pi.IDA(rtol=1e-6)):
        run = pi.solve(scene.build(), 10.0, method)
        turned = np.unwrap(np.arctan2(*run.q.reshape(len(run), -1, 2)[:, 1].T[::-1] + [[0.0], [1.0]]))
        assert not run.success and "'coil' gave numbers that are not finite: it is turned by" in run.message
        assert 2.8 < turned[-1] < 0.95 * np.pi


def test_the_centre_of_a_circle_leads_nowhere_and_is_named():
    scene = pi.Scene()
    ball = scene.add(pi.RigidBody(1.0, 0.1, {"C": (0.0, 0.0)}))
    scene.add(pi.PenaltyContact(ball.at("C"), pi.ground.at((0.0, 0.0)), 1e3, radius=0.5, name="hoop"))
    with pytest.raises(pi.InputError, match="hoop.*its point is at the centre of its circle"):
        pi.consistent_state(scene.build())


@pytest.mark.parametrize("method", [pi.GeneralizedAlpha(h=0.02), pi.IDA(rtol=1e-3)], ids=["alpha", "IDA"])
def test_no_step_turns_a_torsion_spring_past_the_half_turn(method):
    """Steps of half a radian jump over the angles at which its force is undefined; behind them it would turn the other way.

    It reaches half a turn at 0.126 s.
    """
    scene = pi.Scene()
    rotor = scene.add(pi.RigidBody(1.0, 1.0, {"O": (0.0, 0.0)}, spin=25.0, name="rotor"))
    scene.add(pi.Revolute(pi.ground, rotor.at("O")))
    scene.add(pi.TorsionSpring(pi.ground, rotor.at("O"), 1.0, name="coil"))
    run = pi.solve(scene.build(), 0.5, method)
    assert not run.success and "coil" in run.message and run.t[-1] < 0.2
