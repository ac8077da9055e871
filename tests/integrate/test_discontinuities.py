"""Loads and motors that are not smooth: every integrator takes the near side up to a kink and the far side from it on."""

from dataclasses import replace

import numpy as np
import pytest

import polyida as pi

KINK, END = 0.05, 0.08
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
    "ida": pi.IDA(rtol=1e-5, atol=1e-7),
    "radau": pi.RadauIIA(rtol=1e-6),
    "radau, fixed steps": pi.RadauIIA(h=5e-3),
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


@every
def test_a_motor_s_speed_jumps_once(scenes, integrator):
    require_one_jump(scenes, integrator, LINEAR)


@pytest.mark.parametrize("name", ["index3", "ida", "radau"])
def test_a_motor_s_speed_jumps_once_by_differences(scenes, name):
    require_one_jump(scenes, INTEGRATORS[name], SAME)


def require_one_jump(scenes, integrator, angle):
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


MOVERS = {
    "alpha": pi.GeneralizedAlpha(h=2e-2),
    "stabilised": pi.GeneralizedAlpha(h=2e-2, form="stabilised"),
    "whole matrix": pi.GeneralizedAlpha(h=2e-2, linear="kkt"),
    "adaptive": pi.GeneralizedAlpha(h=2e-2, rtol=1e-4),
    "adaptive, whole matrix": pi.GeneralizedAlpha(h=2e-2, rtol=1e-4, linear="kkt"),
    "Richardson": pi.GeneralizedAlpha(h=2e-2, extrapolate=True),
    "energy-momentum": pi.EnergyMomentum(h=2e-2),
    "ida": pi.IDA(rtol=1e-5, linear="kkt"),
    "radau": pi.RadauIIA(rtol=1e-5),
    "radau, fixed steps": pi.RadauIIA(h=2e-2),
}
movers = pytest.mark.parametrize("integrator", MOVERS.values(), ids=MOVERS)
PULSES = {  # value, its integral in s
    "5 ms": (lambda t: np.sin(np.pi * (t - 0.031) / 5e-3) ** 2 if 0.031 < t < 0.036 else 0.0, 2.5e-3),
    "half a step": (lambda t: np.sin(np.pi * (t - 0.0277) / 1e-2) ** 2 if 0.0277 < t < 0.0377 else 0.0, 5e-3),
    "an eighth of a step": (lambda t: np.sin(np.pi * (t - 0.0317) / 2.6e-3) ** 2 if 0.0317 < t < 0.0343 else 0.0, 1.3e-3),
    "a step up and down": (lambda t: float(0.0312 < t < 0.0412), 1e-2),
}


@pytest.mark.parametrize(
    "integrator, name",
    [(integrator, "5 ms") for integrator in MOVERS.values()] + [(MOVERS[k], name) for k in ("alpha", "radau") for name in [*PULSES][1:]],
)
def test_a_pulse_that_nobody_declares_is_felt(scenes, integrator, name):
    pulse, integral = PULSES[name]
    scene, plate = scenes.single(gravity=(0.0, 0.0))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, 40.0), pulse, name="blow"))
    run = pi.solve(scene.build(), 0.06, integrator)
    assert run.success, run.message
    gained = (run.model.mass() @ run.v[-1]).reshape(-1, 2).sum(axis=0)
    assert gained == pytest.approx([0.0, 40.0 * integral], rel=5e-3, abs=1e-3 * 40.0 * integral)


@movers
@pytest.mark.parametrize("jump, kinks", [(0.3, ()), (2 * np.pi, (0.0312,))])
def test_a_motor_that_jumps_stops_the_run_and_is_named(scenes, integrator, jump, kinks):
    """A full turn leaves phi as it is: nothing but the profile knows of it."""
    angle = pi.profile.from_function(lambda t: jump * (t > 0.0312), kinks=kinks)
    run = pi.solve(motor(scenes, angle), 0.06, integrator)
    assert run.status == "jump" and "motor 'drive' jumps" in run.message and "t = 0.0312" in run.message
    assert len(run) >= 1 and run.t[-1] <= 0.0312 and np.isfinite(run.q).all()


TURNS = {
    "ready": pi.profile.quintic(0.0, 2 * np.pi, duration=1.5, begin=2.3),
    "own": lambda t: float(pi.profile.quintic(0.0, 2 * np.pi, duration=1.5, begin=2.3)(t)),
    "straight": pi.profile.linear(0.0, 2 * np.pi, duration=6.0),
}


@pytest.mark.parametrize("integrator", [replace(MOVERS[name], h=2.0) for name in ("alpha", "energy-momentum")])
@pytest.mark.parametrize("name", TURNS)
def test_a_motor_s_full_turn_within_a_step_is_made(scenes, integrator, name):
    """Each step turns by less than a half-turn; that the plate is whipped by so few of them is not the point."""
    scene, plate = scenes.hinged(gravity=(0.0, 0.0), cells=4)
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=TURNS[name], name="drive"))
    scene.add(pi.PointMass(plate.section("right"), 0.01, name="tip"))
    run = pi.solve(scene.build(), 6.0, integrator)
    x, y = run.position("tip")[run.t <= (6.0 if name == "straight" else 3.9)].T
    turned = np.unwrap(np.arctan2(y, x))
    assert np.abs(np.diff(turned)).max() < np.pi and turned[-1] == pytest.approx(2 * np.pi, abs=0.5), run.message


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=1e-2), pi.EnergyMomentum(h=1e-2)])
def test_steps_too_long_for_a_sine_are_said(scenes, integrator):
    for frequency, said in ((80.0, True), (5.0, False)):
        scene, plate = scenes.hinged()
        scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), pi.profile.sine(1.0, frequency), name="hum"))
        run = pi.solve(scene.build(), 0.02, integrator)
        assert run.success and ("'hum' moves within 0.00625 s" in run.message) is said
