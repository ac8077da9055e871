"""State-space matrices and frequency responses: closed forms, each other, and the whole motion where it is small."""

import numpy as np
import pytest
from scipy.signal import lsim

import polyida as pi

M, K, DAMPER = 2.0, 300.0, 4.0


class Wheel(pi.Model):
    """A mass on a spring and a damper, `2 x'' + 4 x' + 300 x = u`, beside one that is held."""

    n, m = 2, 1

    def mass(self, q):
        return np.diag([M, 1.0])

    def force(self, t, q, v):
        return np.array([K * q[0] + DAMPER * v[0], 5.0 * q[1]])

    def phi(self, t, q):
        return q[1:].copy()

    def phi_q(self, t, q):
        return np.array([[0.0, 1.0]])


PUSH = np.array([1.0, 0.0])


def held(scenes, viscosity=1e-3, gravity=(0.0, -9.81), angle=0.0, push=0.0):
    """(model, state) of a plate on a hinge and a motor, with a tip mass and a load on its upper edge."""
    scene, plate = scenes.hinged(gravity, material={"viscosity": viscosity})
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle, name="drive"))
    scene.add(pi.PointMass(plate.section("right"), 0.2, name="tip"))
    scene.add(pi.PointLoad(plate.section("right"), (0.3, 1.0), push, name="push"))
    model = scene.build()
    return model, pi.static(model)


def test_a_mass_on_a_spring_has_its_transfer_function():
    f = np.array([0.0, 0.5, np.sqrt(K / M) / (2 * np.pi), 7.0])
    s = 2j * np.pi * f
    exact = 1 / (M * s**2 + DAMPER * s + K)
    whole = pi.frequency_response(Wheel(), None, PUSH, PUSH, f)
    assert whole.values[:, 0] == pytest.approx(exact, rel=1e-10)
    assert pi.frequency_response(Wheel(), None, PUSH, PUSH, f, modes=1).values[:, 0] == pytest.approx(exact, rel=1e-10)
    assert pi.linearise(Wheel(), None, [PUSH], [PUSH]).response(f)[:, 0, 0] == pytest.approx(exact, rel=1e-10)
    assert whole.phase[2, 0] == pytest.approx(-np.pi / 2) and whole.amplitude[2, 0] == pytest.approx(abs(exact[2]))


def test_without_damping_resonance_is_infinite():
    class Undamped(Wheel):
        def force(self, t, q, v):
            return np.array([2.0 * (2 * np.pi) ** 2 * q[0], q[1]])

        def mass(self, q):
            return np.diag([2.0, 1.0])

    found = pi.frequency_response(Undamped(), None, PUSH, PUSH, [0.5, 1.0])
    assert np.isfinite(found.values[0]).all() and np.abs(found.values[1]).min() > 1e6


def test_the_whole_and_its_modes_agree_where_all_are_taken(scenes):
    model, state = held(scenes)
    f = np.array([0.0, 1.3, 9.0, 40.0])
    looks = ["tip", ("tip", "velocity"), ("tip", "acceleration"), ("shoulder", "reaction"), ("drive", "reaction")]
    for name in ("push", "drive"):
        whole, modal = (pi.frequency_response(model, state, name, looks, f, modes=k).values for k in (None, model.n - model.m))
        assert np.abs(whole - modal).max(axis=0) == pytest.approx(0.0, abs=1e-7 * np.abs(whole).max())
        linear = pi.linearise(model, state, name, looks).response(f[1:])[:, :, 0]
        by_value = linear * (-((2 * np.pi * f[1:, None]) ** 2) if name == "drive" else 1.0)
        assert np.allclose(by_value, whole[1:], rtol=1e-7, atol=1e-7 * np.abs(whole[1:]).min())


def test_eigenvalues_are_the_roots_of_the_modes(scenes):
    model, state = held(scenes)
    system = pi.linearise(model, state, inputs=["push"])
    found, roots = np.linalg.eigvals(system.A), pi.modes(model, state, count=8, damped=True).roots
    assert np.abs(found[:, None] - roots).min(axis=0) == pytest.approx(np.zeros(8), abs=1e-6 * np.abs(roots).max())
    assert len(found) == 2 * (model.n - model.m) and system.motors == ()
    driven = pi.linearise(model, state)
    assert len(driven.A) == len(found) + 2 and driven.inputs == ("drive", "push") and driven.motors == ("drive",)


def test_a_step_of_a_load_is_the_whole_motion_where_it_is_small(scenes):
    """Also the reaction of the hinge, the velocity of the tip, and q itself."""
    _, state = held(scenes)
    pushed, _ = held(scenes, push=1e-2)
    run = pi.solve(pushed, 0.1, pi.GeneralizedAlpha(h=5e-4, rho_inf=0.9), q0=state.q)
    model, _ = held(scenes)
    system = pi.linearise(model, state, "push", ["tip", ("tip", "velocity"), ("shoulder", "reaction")])
    t, y, x = lsim(system.to_scipy(), 1e-2 * np.ones(len(run.t)), run.t)
    tip = run.position("tip") - model.position("tip", state.q[None])
    assert np.abs(tip).max() > 5e-5 and np.abs(y[:, :2] - tip).max() < 5e-3 * np.abs(tip).max()
    assert np.abs(system.displacements(x) - (run.q - state.q)).max() < 5e-3 * np.abs(run.q - state.q).max()
    late = run.t > 0.02
    change = run.reaction("shoulder") - model.reactions("shoulder", state.q[None], state.lam[None, model.rows["shoulder"]])
    assert np.abs(y[late, 4:] - change[late]).max() < 5e-2 * np.abs(change[late]).max()


def test_a_small_move_of_a_motor_is_the_whole_motion(scenes):
    """Its input is the angle's second derivative."""
    move = pi.profile.ramp(0.0, 1e-3, 0.2)
    model, state = held(scenes, angle=move)
    run = pi.solve(model, 0.25, pi.GeneralizedAlpha(h=5e-4, rho_inf=0.9), state=state)
    system = pi.linearise(model, state, "drive", ["tip", ("tip", "velocity"), ("drive", "reaction")])
    u = np.array([move.d2(t) for t in run.t])
    _, y, x = lsim(system.to_scipy(), u, run.t)
    tip = run.position("tip") - run.position("tip")[0]
    assert np.abs(tip).max() > 9e-4 and np.abs(y[:, :2] - tip).max() < 5e-3 * np.abs(tip).max()
    assert x[-1, -2:] == pytest.approx([1e-3, 0.0], abs=1e-6)
    torque = run.reaction("drive")[:, 0] - run.reaction("drive")[0, 0]
    assert np.abs(y[:, 4] - torque).max() < 2e-2 * np.abs(torque).max()


def test_reactions_that_are_not_unique_are_of_least_norm():
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 2.0, angle=-np.pi / 2, name="bar"))
    left, right = bar.at("left"), bar.at("right")
    for name in ("one", "other"):
        scene.add(pi.Revolute(pi.ground, left, name=name))
    scene.add(pi.PointLoad(right, (0.0, -1.0), pi.profile.constant(0.0), name="pull"))
    model = scene.build(redundant="least-norm")
    system = pi.linearise(model, pi.static(model), "pull", [("one", "reaction"), ("other", "reaction")])
    assert system.response([0.0])[0, :, 0] == pytest.approx([0.0, 0.5, 0.0, 0.5], abs=1e-9)


def test_modes_are_coordinates_too(scenes):
    model, state = held(scenes)
    modes = pi.modes(model, state, count=5)
    few, same = (pi.linearise(model, state, "push", "tip", modes=given) for given in (modes, 5))
    assert few.A.shape == (10, 10) and np.allclose(few.A, same.A, atol=1e-6 * np.abs(few.A).max())
    assert few.shapes == pytest.approx(modes.shapes)


def test_force_elements_are_inputs_by_their_own_profiles_alone(scenes):
    """Not by the clock that compiled laws get."""
    scene, plate = scenes.hinged(material={"viscosity": 1e-3})
    scene.add(pi.SpringDamper(pi.ground.at((1.0, 0.5)), plate.section("right"), 500.0, 2.0, name="spring"))
    scene.add(pi.Torque(plate.section("left"), pi.profile.constant(0.0), name="torque"))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), 0.0, name="push"))
    model = scene.build()
    assert pi.linearise(model, pi.static(model)).inputs == ("push", "torque")
