"""Forces that jump with the velocity are noticed after few rejected steps; steep smooth ones are not taken for them."""

import numpy as np
import pytest

import polyida as pi

INTEGRATORS = {"radau": pi.RadauIIA(), "ida": pi.IDA(), "alpha": pi.GeneralizedAlpha()}


def sliding(force):
    """A block on a rail and a spring, and a force of its velocity."""
    scene = pi.Scene()
    block = scene.add(pi.RigidBody(1.0, 1.0, {"c": (0.0, 0.0)}, velocity=(1.0, 0.0), name="block"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), (1.0, 0.0)), block.at("c"), name="rail"))
    scene.add(pi.Force(block.at("c"), force, name="dry"))
    scene.add(pi.SpringDamper(pi.ground.at((-1.0, 0.0)), block.at("c"), 10.0, 0.0, name="spring"))
    return scene.build()


def free(force):
    """The same block without a spring: nothing pushes it once it stands."""
    scene = pi.Scene()
    block = scene.add(pi.RigidBody(1.0, 0.1, {"c": (0.0, 0.0)}, velocity=(1.0, 0.0), name="block"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), (1.0, 0.0)), block.at("c"), name="rail"))
    scene.add(pi.Force(block.at("c"), force, name="dry"))
    return scene.build()


def dry(t, x, v):
    return -3.0 * np.sign(v[0]), 0.0


def steep(t, x, v):
    return -3.0 * np.tanh(v[0] / 1e-3), 0.0


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_sign_of_the_velocity_is_noticed_and_friction_named(name):
    run = pi.solve(sliding(dry), 2.0, INTEGRATORS[name])
    assert run.status == "jump in v" and run.counts.rejected <= 100
    assert run.t[-1] == pytest.approx(0.25778, abs=2e-3)  # where the block stops
    assert "the force of 'dry' jumps by 6 with the velocity" in run.message and "friction=" in run.message


def test_steps_of_ida_that_stay_tiny_without_rejections_are_noticed():
    run = pi.solve(free(dry), 1.0, pi.IDA())
    assert run.status == "jump in v" and run.counts.steps < 3000
    assert "the force of 'dry' jumps by 6 with the velocity" in run.message and "friction=" in run.message


@pytest.mark.parametrize("name", ["radau", "ida"])
def test_a_steep_force_is_no_jump(name):
    run = pi.solve(sliding(steep), 0.5, INTEGRATORS[name])
    assert run.success, run.message


@pytest.mark.parametrize("name", ["radau", "ida"])
def test_a_run_that_passes_jumps_goes_on(name):
    """The spring is stronger than the friction at the first four reversals."""
    run = pi.solve(sliding(lambda t, x, v: (-0.1 * np.sign(v[0]), 0.0)), 4.0, INTEGRATORS[name])
    assert run.success, run.message
    assert np.abs(np.diff(np.sign(run.v[:, 0]))).sum() >= 6


class Own(pi.Model):
    n, m = 1, 0

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return np.sign(v) + q


def test_a_model_of_ones_own():
    run = pi.solve(Own(), 5.0, pi.RadauIIA(), q0=[0.0], v0=[1.0])
    assert run.status == "jump in v" and run.counts.rejected <= 100 and "a force jumps by 2 with the velocity" in run.message
