"""Dry friction in joints whose motion is prescribed: the loss is mu N times the way, whatever the motion was before."""

import numpy as np
import pytest

import polyida as pi

G = 9.81
EAST = pi.ground.at((0.0, 0.0), direction=(1.0, 0.0))
LOCATED = [pi.RadauIIA(h=1e-2), pi.GeneralizedAlpha(h=4e-3), pi.IDA(rtol=1e-8), pi.EnergyMomentum(h=4e-3)]
STEPPED = [pi.NonsmoothAlpha(h=2e-3), pi.MoreauJean(h=2e-3)]  # errors where slip begins and ends: 1e-3 at h = 4e-3, 1e-4 here
FORWARD, BACK = pi.profile.quintic(0.0, 0.1, 0.1, begin=0.05), pi.profile.quintic(0.0, 0.06, 0.1, begin=0.2)
MOVE = pi.profile.difference(FORWARD, BACK)  # there and back, 0.16 m in all, with three dwells
ALL = pytest.mark.parametrize("integrator", LOCATED + STEPPED, ids=lambda x: type(x).__name__)


def body(scene, mass=2.0, name="body"):
    return scene.add(pi.RigidBody(mass=mass, inertia=0.01, points={"c": (0.0, 0.0)}, name=name)).at("c", direction=(1.0, 0.0))


def guide(scene):
    moved = body(scene)
    scene.add(pi.Prismatic(EAST, moved, friction=0.3, name="rubs"))
    scene.add(pi.PrescribedPosition(moved, MOVE, None, name="drive"))
    return 0.3 * 2.0 * G * 0.16


def floor(scene):
    moved = body(scene)
    scene.add(pi.Contact(moved, EAST, friction=0.3, name="rubs"))
    scene.add(pi.AngleMotor(EAST, moved, 0.0, name="level"))
    scene.add(pi.PrescribedPosition(moved, MOVE, None, name="drive"))
    return 0.3 * 2.0 * G * 0.16


def pin(scene):
    """Of a body on another one that moves."""
    cart, moved = body(scene, 1.0, "cart"), body(scene)
    scene.add(pi.Prismatic(EAST, cart, name="rail"))
    scene.add(pi.Revolute(cart, moved, friction=0.3, pin_radius=0.5, name="rubs"))
    scene.add(pi.AngleMotor(cart, moved, MOVE, name="drive"))
    return 0.3 * 0.5 * 2.0 * G * 0.16


@ALL
@pytest.mark.parametrize("place", [guide, floor, pin], ids=lambda x: x.__name__)
def test_loss_of_friction_that_a_drive_moves(place, integrator):
    scene = pi.Scene(gravity=(0.0, -G))
    lost = place(scene)
    run = pi.solve(scene.build(), 0.35, integrator)
    assert run.success, run.message
    assert run.energy.dissipated["rubs"][-1] == pytest.approx(lost, rel=1e-3)
    assert run.energy.work["drive"][-1] == pytest.approx(lost, rel=3e-2)
    dwells = (np.abs(run.t - 0.175) < 0.015) | (run.t > 0.31)
    assert np.abs(run.reaction("drive")[dwells]).max() < 1e-6


@pytest.mark.parametrize("integrator", [pi.IDA(rtol=1e-8), pi.RadauIIA(h=1e-2)], ids=lambda x: type(x).__name__)
def test_a_drive_without_derivatives_may_dwell(integrator):
    """Its second derivative is round-off in the dwell, from which no slip begins."""
    scene = pi.Scene(gravity=(0.0, -G))
    moved = body(scene)
    scene.add(pi.Prismatic(EAST, moved, friction=0.3, name="rubs"))
    scene.add(pi.PrescribedPosition(moved, pi.profile.from_function(lambda t: float(FORWARD(t))), None, name="drive"))
    run = pi.solve(scene.build(), 0.2, integrator)
    assert run.success, run.message
    assert run.energy.dissipated["rubs"][-1] == pytest.approx(0.3 * 2.0 * G * 0.1, rel=1e-6)
    assert np.abs(run.reaction("drive")[run.t > 0.165]).max() < 1e-6  # the step before it may hold the end of the motion


@pytest.mark.parametrize("integrator", [pi.NonsmoothAlpha(h=5e-4), pi.MoreauJean(h=5e-4)], ids=lambda x: type(x).__name__)
@pytest.mark.parametrize("restitution", [0.0, 0.5])
def test_energy_that_a_guide_loses_in_the_impact_of_a_contact(integrator, restitution):
    """A block slides down a guide onto a floor: all energy that is gone is dissipated."""
    down, scene = np.array([1.0, -1.0]) / np.sqrt(2.0), pi.Scene(gravity=(0.0, -G))
    block = scene.add(pi.RigidBody(mass=1.0, inertia=0.01, points={"c": (0.0, 0.0)}, origin=(0.0, 0.05), name="block"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.05), direction=down), block.at("c", direction=down), friction=0.3, name="guide"))
    scene.add(pi.Contact(block.at("c"), EAST, restitution=restitution, name="floor"))
    run = pi.solve(scene.build(), 0.22, integrator)
    assert run.success and {one.name for one in run.events} >= {"floor", "guide"}, run.message
    lost = run.energy.total[0] - run.energy.total[-1]
    assert lost > 0.3 and sum(values[-1] for values in run.energy.dissipated.values()) == pytest.approx(lost, rel=2e-2)
