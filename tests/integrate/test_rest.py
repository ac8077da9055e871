"""A scene at rest costs one residual a step and no factor, and is not taken for one that only seems to rest."""

import numpy as np
import pytest

import polyida as pi
from polyida import profile
from polyida.problems import plates
from polyida.problems.equations import Pendulum

STEPS, H = 40, 5e-3
METHODS = {
    "alpha": pi.GeneralizedAlpha(h=H),
    "alpha, stabilised": pi.GeneralizedAlpha(h=H, form="stabilised"),
    "alpha, adaptive": pi.GeneralizedAlpha(h=H, rtol=1e-4),
    "alpha, plain": pi.GeneralizedAlpha(h=H, linear="kkt"),
    "energy": pi.EnergyMomentum(h=H),
    "radau": pi.RadauIIA(h=H),
    "radau, index 3": pi.RadauIIA(h=H, form="index3"),
}


def cantilever(load=None, gravity=-9.81, motor=None, cells=12):
    scene = pi.Scene(gravity=(0.0, gravity))
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=cells, seed=1), plates.RUBBER, thickness=0.01, name="plate"))
    if motor is None:
        scene.add(pi.Clamp(pi.ground, plate.section("left"), name="clamp"))
    else:
        scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hinge"))
        scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=motor, name="motor"))
    if load is not None:
        scene.add(pi.PointLoad(plate.section("right"), (0.0, 1.0), profile=load, name="load"))
    return scene.build()


def work(run):
    return {name: getattr(run.counts, name) for name in ("steps", "residuals", "solves", "factorizations", "newton_iterations")}


@pytest.mark.parametrize("name", METHODS)
def test_an_equilibrium_costs_one_residual_a_step(name):
    model = cantilever()
    still = pi.static(model)
    run = pi.solve(model, STEPS * H, METHODS[name], state=still)
    assert work(run) == {"steps": STEPS, "residuals": STEPS, "solves": 0, "factorizations": 0, "newton_iterations": 0}
    assert np.array_equal(run.q, np.tile(still.q, (STEPS + 1, 1))) and not run.v.any() and not run.a.any()
    assert np.array_equal(run.lam, np.tile(still.lam, (STEPS + 1, 1)))
    assert run.t == pytest.approx(H * np.arange(STEPS + 1), rel=1e-12)


@pytest.mark.parametrize("off", [1e-6, 1e-9])
def test_a_pendulum_a_touch_away_from_rest_swings(off):
    """Less than what a step of it moves is no rest: the whole time counts."""
    run = pi.solve(Pendulum(), 1.0, pi.GeneralizedAlpha(h=1e-3), q0=[np.sin(off), -np.cos(off)])
    assert run.q[-1, 0] == pytest.approx(off * np.cos(np.sqrt(9.81)), abs=1e-3 * off)


@pytest.mark.parametrize("name", METHODS)
def test_a_load_ends_the_rest(name):
    """Before the load's kink nothing is solved, and behind it all is as in a run that begins there."""
    begin = 8 * H
    load = profile.ramp(0.0, 0.5, duration=4 * H, begin=begin)
    model = cantilever(load)
    still = pi.static(model)
    run = pi.solve(model, 16 * H, METHODS[name], state=still)
    late = pi.solve(model, 16 * H, METHODS[name], q0=still.q, t0=begin)
    assert np.array_equal(run.q[run.t <= begin * (1 + 1e-9)], np.tile(still.q, (9, 1)))
    moved = np.abs(late.q[-1] - still.q).max()
    assert moved > 1e-6 and np.abs(run.q[-1] - late.q[-1]).max() < 1e-6 * moved


@pytest.mark.parametrize("name", METHODS)
def test_a_motor_ends_the_rest(name):
    """A motor that stands still lets its plate rest; phi holds as it does without."""
    turn = profile.quintic(0.0, 0.3, duration=8 * H, begin=8 * H)
    model = cantilever(gravity=0.0, motor=turn)
    run = pi.solve(model, 16 * H, METHODS[name])
    assert run.success and not run.q[run.t <= 8 * H * (1 - 1e-9)].any()
    assert run.drift.max() < (1e-8 if name == "alpha, plain" else 1e-12)  # its B is as old as its matrix
    assert np.abs(run.q[-1]).max() > 0.05
