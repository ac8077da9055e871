"""Momentum: Newton's law, what free bodies keep, rigid bodies by hand; models of one's own tell it or not."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

import polyida as pi

ALPHA = pi.GeneralizedAlpha(h=5e-4)


@dataclass(frozen=True, eq=False)
class Bar(pi.Body):
    """A rigid bar of mass 2 kg and length 1 m: its left end and its direction."""

    origin: complex = 0j
    name: str | None = None

    def coordinates(self):
        return [self.origin, 1.0]

    def mass_matrix(self):
        return [[2.0, 1.0], [1.0, 2.0 / 3.0]]

    def attachments(self):
        return {"left": [1.0, 0.0], "right": [1.0, 1.0]}

    def x_axis(self):
        return [0.0, 1.0]

    def rows(self):
        z = self.at("left").d
        return [(pi.dot(z, z) - 1.0) * 0.5]


def hanging(gravity=(0.0, -9.81)):
    """A plate on a hinge, a rigid bar on the plate, a mass on the bar."""
    scene = pi.Scene(gravity)
    mesh = pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1)
    plate = scene.add(pi.Plate(mesh, pi.Material(50e6, 0.3, 1100.0), 0.01, name="plate"))
    bar = scene.add(Bar(1.0 + 0j, name="bar"))
    scene.add(pi.Revolute(plate.section("right"), bar.at("left")))
    scene.add(pi.PointMass(bar.at("right"), 0.5, name="tip"))
    return scene, plate


def turning(model, center, spin, drift):
    """Velocities of everything as one rigid body: pairs that move with a translation, and directions that only turn."""
    z = model.reference @ [1.0, 1j]
    moves = np.ones(model.n_nodes)
    moves[-1] = 0.0
    v = moves * complex(*drift) + 1j * spin * (z - moves * complex(*center))
    return np.stack([v.real, v.imag], axis=1).ravel()


def test_of_a_rigid_turn_it_is_that_by_hand():
    scene, plate = hanging((0.0, 0.0))
    model = scene.build()
    run = pi.solve(model, 1e-3, ALPHA, v0=turning(model, (0.2, -0.3), 3.0, (2.0, -1.0)))
    masses, places = np.array([1.1, 2.0, 0.5]), np.array([[0.5, 0.0], [1.5, 0.0], [2.0, 0.0]])
    places[:, 1] += plate.section("left").point[1] * np.array([1, 0, 0])
    inertia = 1.1 * (1 + 0.01) / 12 + 2.0 / 12
    v = np.array([2.0, -1.0]) + 3.0 * np.stack([-(places[:, 1] + 0.3), places[:, 0] - 0.2], axis=1)
    assert np.allclose(run.momentum[0], masses @ v, rtol=1e-12)
    spin = masses @ (places[:, 0] * v[:, 1] - places[:, 1] * v[:, 0]) + 3.0 * inertia
    assert run.angular_momentum[0] == pytest.approx(spin, rel=1e-12)
    assert run.momentum.shape == (len(run), 2) and run.angular_momentum.shape == (len(run),)


def test_free_bodies_keep_it():
    model = hanging((0.0, 0.0))[0].build()
    run = pi.solve(model, 0.1, pi.EnergyMomentum(h=1e-3), v0=turning(model, (0.2, -0.3), 3.0, (2.0, -1.0)))
    assert np.abs(run.momentum - run.momentum[0]).max() < 1e-10
    assert np.abs(run.angular_momentum - run.angular_momentum[0]).max() < 1e-9 * run.angular_momentum[0]


def test_forces_change_it():
    """Momentum by weight, reaction and load; angular momentum by their moments and a motor's torque."""
    scene, plate = hanging()
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hinge"))
    scene.add(pi.PointLoad(plate.section("right"), (3.0, 0.0), pi.profile.sine(1.0, 4.0), name="push"))
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), pi.profile.ramp(0.0, 0.3, 0.1), name="drive"))
    run = pi.solve(scene.build(), 0.1, pi.RadauIIA(h=5e-4))
    push = np.outer(np.sin(8 * np.pi * run.t), [3.0, 0.0])
    forces = {"hinge": run.reaction("hinge"), "push": push}
    moments = run.reaction("drive")[:, 0] + sum(_cross(run.position(name), force) for name, force in forces.items())
    weight = np.array([0.0, -9.81])
    middle = 0.5 * (run.position("tip") + run.position("push"))
    moments += _cross(middle, 2.0 * weight) + _cross(run.position("tip"), 0.5 * weight)
    x = run.model.reference[None, :-2] + run.q.reshape(len(run), -1, 2)[:, :-2]
    lumped = np.asarray(run.model.mass().sum(axis=0)).ravel()[0::2][:-2]
    moments += (x * lumped[:, None]).sum(axis=1)[:, 0] * weight[1]
    gained = cumulative_simpson(sum(forces.values()) + 3.6 * weight, x=run.t, axis=0, initial=0.0)
    spun = cumulative_simpson(moments, x=run.t, initial=0.0)
    assert np.abs(run.momentum - run.momentum[0] - gained).max() < 2e-4 * np.abs(run.momentum).max()
    assert np.abs(run.angular_momentum - run.angular_momentum[0] - spun).max() < 2e-4 * np.abs(run.angular_momentum).max()


def _cross(x, f):
    return x[..., 0] * f[..., 1] - x[..., 1] * f[..., 0]
