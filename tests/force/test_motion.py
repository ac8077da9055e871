"""Motions under the ready forces and joints that are known in closed form."""

import numpy as np
import pytest
from scipy.optimize import brentq

import polyida as pi

MASS, INERTIA = 0.5, 0.02
METHODS = (pi.GeneralizedAlpha(h=1e-3), pi.IDA(rtol=1e-8), pi.RadauIIA(rtol=1e-8))


def lone(gravity=(0.0, 0.0), **options):
    """(scene, a rigid body with its centre "C" and an arm's end "A")."""
    scene = pi.Scene(gravity)
    return scene, scene.add(pi.RigidBody(MASS, INERTIA, {"C": (0.0, 0.0), "A": (0.3, 0.0)}, name="body", **options))


def direction(run):
    """z of the body over the frames, complex, m."""
    return np.sqrt(INERTIA / MASS) + run.q.reshape(len(run), -1, 2)[:, 1] @ (1.0, 1j)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: type(method).__name__)
def test_a_mass_on_a_spring_and_damper(method):
    """On a guide: x = exp(-d t) (cos w t + d/w sin w t) x0, d = c/2m, w^2 = k/m - d^2; what the damper takes is what is missing."""
    scene, body = lone(origin=(0.1, 0.0))
    scene.add(pi.Prismatic(pi.ground.at((-1.0, 0.0)), body.at("C")))
    scene.add(pi.SpringDamper(pi.ground.at((-1.0, 0.0)), body.at("C"), 80.0, 0.4, length=1.0, name="spring"))
    run = pi.solve(scene.build(), 0.6, method)
    d = 0.4 / (2 * MASS)
    w = np.sqrt(80.0 / MASS - d * d)
    x = 0.1 * np.exp(-d * run.t) * (np.cos(w * run.t) + d / w * np.sin(w * run.t))
    assert run.success and np.abs(run.position(body.at("C"))[:, 0] - x).max() < 1e-5
    assert np.abs(run.energy.total + run.energy.dissipated["spring"] - run.energy.total[0]).max() < 2e-5 * run.energy.total[0]


def test_a_hardening_spring_keeps_its_energy():
    """Duffing: k e + 4 e^3 through a function of one's own, whose energy is the integral."""
    scene, body = lone(origin=(1.2, 0.0))
    scene.add(pi.Prismatic(pi.ground, body.at("C")))
    scene.add(pi.SpringDamper(pi.ground.at((0.0, 0.0)), body.at("C"), 8.0, length=1.0, force=lambda e, rate: 400.0 * e**3, name="spring"))
    run = pi.solve(scene.build(), 1.0, pi.EnergyMomentum(h=5e-3))
    assert run.energy.potential[0] == pytest.approx(4.0 * 0.2**2 + 100.0 * 0.2**4)
    assert np.ptp(run.energy.total) < 1e-9 * run.energy.total[0] and run.energy.kinetic.max() > 0.5 * run.energy.total[0]


@pytest.mark.parametrize("slope", [0.3, -1.1])
def test_a_slider_on_an_incline(slope):
    """It slides by g sin t^2/2 along the guide, which carries m g cos and no moment."""
    scene, body = lone((0.0, -9.81), origin=(0.4 * np.cos(slope), 0.4 * np.sin(slope)))
    along = np.array([np.cos(slope), np.sin(slope)])
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), along), body.at("C"), name="guide"))
    run = pi.solve(scene.build(), 0.3, pi.GeneralizedAlpha(h=1e-3))
    way = 0.4 - 9.81 * np.sin(slope) * run.t**2 / 2
    assert np.abs(run.position(body.at("C")) - np.outer(way, along)).max() < 1e-9
    push = MASS * 9.81 * np.cos(slope) * np.array([-along[1], along[0]])
    assert np.abs(run.reaction("guide") - [*push, 0.0]).max() < 1e-6


def test_a_pin_in_a_turning_slot():
    """A pin on a circle of radius r about O drives a slotted arm about P: its angle is that from P to the pin, the force across the slot."""
    scene = pi.Scene()
    crank = scene.add(pi.RigidBody(0.2, 1e-3, {"O": (0.0, 0.0), "pin": (0.1, 0.0)}, name="crank"))
    arm = scene.add(pi.RigidBody(0.3, 4e-3, {"P": (0.0, 0.0)}, origin=(-0.25, 0.0), name="arm"))
    scene.add(pi.Revolute(pi.ground, crank.at("O")))
    scene.add(pi.Revolute(pi.ground, arm.at("P")))
    scene.add(pi.AngleMotor(pi.ground, crank.at("O"), pi.profile.ramp(0.0, 4.0, 0.3)))
    scene.add(pi.Slot(arm.at("P"), crank.at("pin"), name="slot"))
    run = pi.solve(scene.build(), 0.4, pi.GeneralizedAlpha(h=1e-3))
    pin, turned = run.position("slot"), 1.0 + run.q.reshape(len(run), -1, 2)[:, 3] @ (1.0, 1j) / arm.gyration
    assert run.success and np.abs(np.angle((pin + [0.25, 0.0]) @ (1.0, 1j) / turned)).max() < 1e-9
    force = run.reaction("slot") @ (1.0, 1j)
    assert np.abs((force / turned).real).max() < 1e-9 * np.abs(force).max()


def test_a_point_on_a_prescribed_path():
    """It is where the profiles say; the force that leads it is m (a - g), the work what the body has gained."""
    scene, body = lone((0.0, -9.81))
    x, y = pi.profile.quintic(0.0, 0.4, 0.3), pi.profile.sine(0.2, 2.0)
    scene.add(pi.PrescribedPosition(body.at("C"), x, y, name="path"))
    run = pi.solve(scene.build(), 0.3, pi.GeneralizedAlpha(h=5e-4))
    assert np.abs(run.position("path") - np.column_stack([x.value(run.t), y.value(run.t)])).max() < 1e-12
    force = MASS * np.column_stack([x.d2(run.t), y.d2(run.t) + 9.81])
    assert np.abs(run.reaction("path") - force)[1:-1].max() < 2e-3 * np.abs(force).max()
    gained = run.energy.total - run.energy.total[0]
    assert np.abs(run.energy.work["path"] - gained).max() < 1e-4 * np.abs(gained).max()


def test_a_pendulum_on_a_rod():
    """Let go at the height of its support: the rod's tension is 3 m g sin(angle below it)."""
    scene, body = lone((0.0, -9.81), origin=(0.7, 0.0))
    scene.add(pi.Distance(pi.ground.at((0.0, 0.0)), body.at("C"), name="rod"))
    run = pi.solve(scene.build(), 0.5, pi.GeneralizedAlpha(h=5e-4))
    where = run.position("rod")
    pull = 3.0 * MASS * 9.81 * where[:, 1:] / 0.7 * where / 0.7
    assert np.abs(np.hypot(*where.T) - 0.7).max() < 1e-12
    assert np.abs(run.reaction("rod") - pull)[1:].max() < 1e-4 * np.abs(pull).max()


def test_a_torsion_pendulum():
    """angle = a cos w t about the angle at which the spring rests, w^2 = k/J."""
    scene, body = lone()
    scene.add(pi.Revolute(pi.ground, body.at("C")))
    scene.add(pi.TorsionSpring(pi.ground, body.at("C"), 2.0, angle=0.6, name="coil"))
    run = pi.solve(scene.build(), 1.0, pi.RadauIIA(rtol=1e-9))
    angle = 0.6 - 0.6 * np.cos(np.sqrt(2.0 / INERTIA) * run.t)
    assert np.abs(np.angle(direction(run)) - angle).max() < 1e-6
    assert np.abs(run.energy.total - 0.36).max() < 1e-6


def test_a_torque_works_by_the_angle():
    """J w = int M dt, and its work is the kinetic energy, over several turns."""
    scene, body = lone()
    scene.add(pi.Revolute(pi.ground, body.at("C")))
    scene.add(pi.Torque(body.at("A"), pi.profile.quintic(0.0, 3.0, 0.2), name="drive"))
    run = pi.solve(scene.build(), 0.6, pi.RadauIIA(rtol=1e-8))
    speed = 3.0 * (0.1 + 0.4) / INERTIA
    assert run.energy.kinetic[-1] == pytest.approx(INERTIA * speed**2 / 2, rel=1e-5)
    assert np.abs(run.energy.work["drive"] - run.energy.kinetic).max() < 1e-4 * run.energy.kinetic[-1]
    assert np.abs(np.unwrap(np.angle(direction(run))))[-1] > 2 * np.pi


@pytest.mark.parametrize("surface", ["line", "circle"])
def test_a_ball_comes_back_as_the_energy_balance_of_hunt_and_crossley_says(surface):
    """With s = 3/2 c, `s v0 - ln(1 + s v0) = -s v1 - ln(1 - s v1)` for the speeds before and behind: whatever k, n and m are."""
    c, before = 0.2, 1.5
    scene, body = lone(origin=(0.0, 0.02), velocity=(0.0, -before))
    floor = {"line": {}, "circle": {"radius": 3.0}}[surface]
    scene.add(pi.PenaltyContact(body.at("C"), pi.ground.at((0.0, -floor.get("radius", 0.0))), 1e6, c, name="floor", **floor))
    run = pi.solve(scene.build(), 0.05, pi.RadauIIA(rtol=1e-8))
    s = 1.5 * c
    after = brentq(lambda v: s * before - np.log1p(s * before) + s * v + np.log1p(-s * v), 1e-3, before)
    speed = run.v.reshape(len(run), -1, 2)[-1, 0]
    assert run.success and speed == pytest.approx([0.0, after], rel=1e-5, abs=1e-9)
    assert run.energy.dissipated["floor"][-1] == pytest.approx(MASS * (before**2 - after**2) / 2, rel=2e-3)


def test_welded_bodies_are_one():
    """Two free bodies welded at an angle: they turn about their common centre with the spin of the whole."""
    scene = pi.Scene()
    one = scene.add(pi.RigidBody(1.0, 0.1, {"end": (0.5, 0.0)}, name="one"))
    other = scene.add(
        pi.RigidBody(1.0, 0.1, {"end": (-0.5, 0.0)}, origin=(0.5 + 0.5 * np.cos(0.7), 0.5 * np.sin(0.7)), angle=0.7, name="other")
    )
    scene.add(pi.Weld(one.at("end"), other.at("end"), name="weld"))
    model = scene.build()
    apart = np.array([0.5 + 0.5 * np.cos(0.7), 0.5 * np.sin(0.7)])
    v0 = np.zeros((4, 2))
    v0[0], v0[2] = 4.0 * np.array([0.5 * apart[1], -0.5 * apart[0]]), 4.0 * np.array([-0.5 * apart[1], 0.5 * apart[0]])
    v0[1], v0[3] = 4.0 * np.sqrt(0.1) * np.array([[0.0, 1.0], [-np.sin(0.7), np.cos(0.7)]])
    run = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=1e-3), v0=v0.ravel())
    centre = run.q.reshape(len(run), -1, 2)[:, 0] @ (1.0, 1j)
    half = 0.5 * apart @ (1.0, 1j)
    assert model.m == 5 and np.abs(centre - (half - half * np.exp(4j * run.t))).max() < 1e-4
    force, arm = run.reaction("weld")[1:, :2] @ (1.0, 1j), -0.5 * np.exp(1j * (0.7 + 4.0 * run.t[1:]))
    assert np.abs(force + 16.0 * half * np.exp(4j * run.t[1:])).max() < 1e-2
    assert np.abs(run.reaction("weld")[1:, 2] + (arm.conjugate() * force).imag).max() < 1e-2, "no moment about its own centre"
