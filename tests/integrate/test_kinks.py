"""Loads and motors that are not smooth: every integrator takes the near side up to a kink and the far side from it on."""

import numpy as np
import pytest

import polyida as pi

KINK, END = 0.05, 0.1
FIXED = {
    "index3": dict(),
    "stabilised": dict(form="stabilised"),
    "whole matrix": dict(linear="kkt"),
    "whole matrix, stabilised": dict(linear="kkt", form="stabilised"),
    "phi from positions": dict(incremental_phi=False),
}
INTEGRATORS = {name: pi.GeneralizedAlpha(h=1e-3, **choice) for name, choice in FIXED.items()} | {
    "adaptive": pi.GeneralizedAlpha(h=1e-2, rtol=1e-5),
    "adaptive, whole matrix": pi.GeneralizedAlpha(h=1e-2, rtol=1e-5, linear="kkt"),
    "energy-momentum": pi.EnergyMomentum(h=1e-3),
    "ida": pi.IDA(rtol=1e-6, atol=1e-8),
}
every = pytest.mark.parametrize("integrator", INTEGRATORS.values(), ids=INTEGRATORS)
SIDES = {"from": lambda t: float(t >= KINK), "after": lambda t: float(t > KINK)}


def step_load(scenes, side, kinks=(KINK,)):
    """A hinged plate that is pushed from KINK on; at KINK itself the load is either side's."""
    scene, plate = scenes.hinged()
    push = pi.profile.from_function(SIDES[side], kinks=kinks)
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 30.0), push, name="push"))
    return scene.build()


@every
def test_a_load_s_value_at_its_kink_does_not_matter(scenes, integrator):
    one, other = (pi.solve(step_load(scenes, side), END, integrator) for side in SIDES)
    assert one.success and np.abs(one.t - KINK).min() < 1e-15
    assert np.abs(one.q[-1] - other.q[-1]).max() < 1e-9


@pytest.mark.parametrize("number", [10, 40, 1000])
def test_a_load_step_on_a_rigid_body_is_exact(number):
    """Constant acceleration from 0.3 s on is no error of the method, whatever the step."""
    run = pi.solve(Pushed(), 1.0, pi.GeneralizedAlpha(h=1 / number, tolerance=1e-8), q0=[0.0, 0.0])
    assert run.q[-1] == pytest.approx([0.245, 0.245], abs=1e-10) and run.v[-1] == pytest.approx([0.7, 0.7], abs=1e-10)


class Pushed(pi.Model):
    """1 kg on the line x = y, pushed by 1 N sqrt(2) from 0.3 s on: x = (t - 0.3)^2 / 2."""

    n, m = 2, 1

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.full(2, -float(t >= 0.3))

    def phi(self, t, q):
        return np.array([q[0] - q[1]])

    def phi_q(self, t, q):
        return np.array([[1.0, -1.0]])

    def kinks(self, t0, t1):
        return [0.3] if t0 < 0.3 < t1 else []


def motor(scenes, angle):
    scene, plate = scenes.hinged()
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=angle, name="drive"))
    return scene.build()


LINEAR = pi.profile.linear(0.0, 0.15, duration=KINK, begin=0.02)
SAME = pi.profile.from_function(lambda t: 3.0 * max(0.0, min(t - 0.02, KINK)), kinks=(0.02, 0.02 + KINK))


@pytest.mark.parametrize("angle", [LINEAR, SAME], ids=["given derivatives", "differences"])
@every
def test_a_motor_s_speed_jumps_once(scenes, integrator, angle):
    run = pi.solve(motor(scenes, angle), END, integrator)
    assert run.success, run.message
    assert run.drift.max() < 1e-9
    away = np.abs(run.t[:, None] - (0.02, 0.07)).min(axis=1) > 1e-9
    assert run.velocity_drift[away].max() < 2e-4
    assert np.abs(run.q[-1] - _reference(scenes).q[-1]).max() < 2e-3


_made = []


def _reference(scenes):
    if not _made:
        _made.append(pi.solve(motor(scenes, LINEAR), END, pi.GeneralizedAlpha(h=1e-4), every=10**9))
    return _made[0]


@pytest.mark.parametrize("integrator", [integrator for name, integrator in INTEGRATORS.items() if name != "ida"] + [
    pi.GeneralizedAlpha(h=2e-2), pi.GeneralizedAlpha(h=2e-2, rtol=1e-4), pi.GeneralizedAlpha(h=2e-2, linear="kkt"),
    pi.EnergyMomentum(h=2e-2)])
def test_a_pulse_between_two_steps_is_felt(scenes, integrator):
    """sin^2 over 5 ms, zero at both of its kinks: momentum of a free plate is its integral."""
    scene, plate = scenes.single(gravity=(0.0, 0.0))
    pulse = pi.profile.from_function(lambda t: np.sin(np.pi * (t - 0.03) / 5e-3) ** 2 if 0.03 < t < 0.035 else 0.0,
                                     kinks=(0.03, 0.035))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 40.0), pulse, name="blow"))
    run = pi.solve(scene.build(), 0.06, integrator)
    assert run.success, run.message
    gained = (run.model.mass() @ run.v[-1]).reshape(-1, 2).sum(axis=0)
    assert gained == pytest.approx([0.0, 40.0 * 2.5e-3], rel=5e-3, abs=1e-6)


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=2e-2), pi.EnergyMomentum(h=2e-2)])
def test_a_pulse_that_is_zero_in_its_middle_too_is_felt(scenes, integrator):
    """One period of a sine leaves a free mass moved by 1/(2 pi) of force times time squared over mass."""
    scene, plate = scenes.single(gravity=(0.0, 0.0))
    pulse = pi.profile.from_function(lambda t: np.sin(2 * np.pi * (t - 0.03) / 0.01) if 0.03 < t < 0.04 else 0.0,
                                     kinks=(0.03, 0.04))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 40.0), pulse, name="shake"))
    run = pi.solve(scene.build(), 0.04, integrator)
    moved = (run.model.mass() @ run.q[-1]).reshape(-1, 2).sum(axis=0)[1]
    assert moved == pytest.approx(40.0 * 0.01**2 / (2 * np.pi), rel=0.3)


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=1e-2, rtol=1e-3), pi.EnergyMomentum(h=1e-2)])
def test_a_restart_near_the_end_takes_the_same_steps(scenes, integrator):
    scene, plate = scenes.hinged()
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), pi.profile.sine(1.0, 2.0), name="sway"))
    model = scene.build()
    whole = pi.solve(model, 0.1, integrator)
    part = pi.solve(model, float(whole.t[-3]), integrator)
    rest = pi.solve(model, 0.1, integrator, state=part.state)
    assert len(rest) <= 4 and np.abs(rest.q[-1] - whole.q[-1]).max() < 1e-3 * np.abs(whole.q[-1]).max()


def test_straight_pieces_take_no_more_steps_than_asked(scenes):
    """A load that is given by points: one step from each to the next."""
    times, values = np.linspace(0.0, 0.05, 51), np.sin(np.arange(51.0))
    load = pi.profile.from_function(lambda t: np.interp(t, times, values), kinks=times[1:-1])
    scene, plate = scenes.hinged()
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), load, name="record"))
    assert pi.solve(scene.build(), 0.05, pi.GeneralizedAlpha(h=2e-3)).counts.steps == 50


class Driven(pi.Model):
    """A mass whose x is held to a path with corners, and which falls; all derivatives in time by differences."""

    n, m = 2, 1

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, 9.81])

    def phi(self, t, q):
        return np.array([q[0] - LINEAR(t)])

    def phi_q(self, t, q):
        return np.array([[1.0, 0.0]])

    def kinks(self, t0, t1):
        return [t for t in LINEAR.kinks if t0 < t < t1]


@pytest.mark.parametrize("name", ["whole matrix", "whole matrix, stabilised", "adaptive, whole matrix", "ida"])
def test_a_model_of_one_s_own_is_not_differentiated_across_its_kinks(name):
    run = pi.solve(Driven(), END, INTEGRATORS[name])
    assert run.q[-1] == pytest.approx([0.15, -9.81 * END**2 / 2], abs=1e-5)
    assert run.v[-1] == pytest.approx([0.0, -9.81 * END], abs=1e-5)
    assert np.abs(run.lam).max() < 1e-2
