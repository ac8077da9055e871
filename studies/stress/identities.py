"""Cases of the stress study without a reference run: checks by balances and symmetries.

Whole turns: angle, work and shape. Long steps: balance of forces and moments, and energy. Reversal: the reversed motion returns to the
start.
"""

import numpy as np

from conditioning.systems import freed
from polyida import profile
from polyida.run.solve import solve
from stress import scenes
from stress.outcome import COLLAPSED, Check, Stop, balance, drift_check, extent, integrator, tip

SETTLED = 1e-9  # of the scene's size: drift of phi
SPREAD = float(np.sqrt(scenes.STIFF.E / scenes.STIFF.rho / 12) * 0.1)  # m2/s, sqrt(EI / rho A) of a plate 0.1 m high
TURN_BACK = 0.05  # s, when the motor of `reversal` turns back
RETURNS = 1e-2  # of what was travelled, how near a reversed motion must come to its start


def turned(run):
    """Continuous angle of the line from the hub to the tip, (frames,), rad."""
    x, y = tip(run).T
    return np.unwrap(np.arctan2(y, x))


def many_turns(turns, name):
    """A motor turns a plate `turns` times, in 0.1 s a turn and at least 1 s. At every frame the angle is theta(t), up to three times the
    bending by the acceleration, and the length agrees with the centrifugal stretch. The largest kinetic energy is that of the turning
    plate, all nodes return to their places, and the work of the motor equals the gained energy. Errors add up over the turns, so rtol
    falls with their number, except for IDA, which uses rtol^(3/2) for q of flexible bodies. Radau IIA takes steps of at most 5 ms,
    because the work is summed over frames.
    """
    t_end = max(1.0, 0.1 * turns)
    angle = profile.quintic(0.0, 2 * np.pi * turns, duration=t_end)
    model = scenes.driven(angle)
    most = {"max_step": 5e-3} if name == "radau" else {}
    rtol = 1e-5 if name in ("ggl2", "ggl1") else min(1e-5, 1e-4 / turns)
    run = solve(model, t_end, integrator(name, rtol=rtol, **most))
    theta, rate, pull = np.array([angle.at(t) for t in run.t]).T
    lag = 3 * 11 / 120 * np.abs(pull).max() / SPREAD**2 + 1e-3
    stretch = rate**2 * _stretch_of_a_turn()
    length = np.linalg.norm(tip(run), axis=1) - 1 - stretch
    fastest = 0.5 * np.abs(rate).max() ** 2 * _inertia(model)
    checks = [
        Check("turned angle, rad", np.abs(turned(run) - theta).max(), lag),
        Check("length, m", np.abs(length).max(), 0.1 * stretch.max() + lag**2),
        Check("kinetic energy at the fastest", abs(run.energy.kinetic.max() / fastest - 1), 0.01 + lag),
        Check("nodes after whole turns, m", np.abs(run.q[-1]).max(), 5e-3),
    ]
    return run, [*checks, drift_check(run, SETTLED), *balance(run, 0.01, 0.01)]


def _stretch_of_a_turn():
    """Elongation of the plate of `driven` at 1 rad/s, m: rho L^3 / 3E by its own mass, m L^2 / EA by the mass at the tip."""
    return scenes.STIFF.rho / (3 * scenes.STIFF.E) + scenes.TIP / (scenes.STIFF.E * 0.1 * 0.01)


def _inertia(model):
    """Moment of inertia about the origin, kg m2."""
    swing = np.stack([-model.reference[:, 1], model.reference[:, 0]], axis=1).ravel()
    return float(swing @ (model.mass() @ swing))


def large_steps(h, name):
    """Swinging plates with steps too long for accuracy: phi stays accurate, and energy grows by at most 2 % (not at all with the
    energy-momentum method). The loss of energy is at most the difference to the rest position. Except for the energy-momentum method, all
    forces and moments balance at every frame to 1e-3 of the weight.
    """
    model = scenes.swing()
    run = solve(model, max(0.5, 20 * h), integrator(name, h))
    if name == "energy":
        return run, [drift_check(run, SETTLED), *balance(run, 1e-7, 1e-7)]
    gained = balance(run, 0.02, 1.0)[0]
    below, forces = Check("energy below rest", _below_rest(run), 0.02), unbalanced_forces(run)
    return run, [drift_check(run, SETTLED), gained, below, Check("balance of all forces", forces, 1e-3)]


def _below_rest(run):
    """Energy below that of the hanging plates at rest, over the energy from the start to that position."""
    model = run.model
    weight = 9.81 * (model.mass() @ np.tile([0.0, 1.0], model.n_nodes)).reshape(-1, 2)[:, 1]
    free = float(weight @ np.abs(model.reference[:, 0]))
    total = run.energy.total
    return max(float(total[0] - total.min()) / free - 1, 0.0)


def unbalanced_forces(run):
    """Largest sum of the nodal forces M a + g + B^T lam, and of their moments about the origin, over the weight (times the size of the
    scene) or, if larger, the inertia forces. Inner forces of the plates cancel.
    """
    model, worst = run.model, 0.0
    for t, q, v, a, lam in zip(run.t, run.q, run.v, run.a, run.lam):
        x, force = model.reference + q.reshape(-1, 2), model.residual(t, q, v, a, lam).reshape(-1, 2)
        inertia = (model.mass() @ a).reshape(-1, 2)
        scale = max(9.81 * 2 * scenes.PLATE_MASS, float(np.abs(inertia).sum()))
        sums = np.abs(force.sum(axis=0)).max(), abs(np.sum(x[:, 0] * force[:, 1] - x[:, 1] * force[:, 0])) / extent(model)
        worst = max(worst, *(float(s) / scale for s in sums))
    return worst


def cannot_be_predicted(h, name):
    """In a step longer than sqrt(2 m / g) a plate falls by more than its length; Newton's method starts far from the solution."""
    stop = Stop(("newton", "inverted", "objection"), ("Newton does not converge", *COLLAPSED), only=False)
    return stop if 9.81 * h * h / 2 > 1.0 else None


def reversal(rate, name):
    """A motor with `rate` rad/s reverses within one step of 1 ms: the energy of the plate is at most that of an elastic rebound with
    twice the speed. With reversed velocities and motor all nodes return to the start, up to 1 % of the path of the tip.
    """
    angle, t_end = scenes.zigzag(rate, 1e-3), TURN_BACK + 0.01
    model = scenes.driven(angle)
    run = solve(model, t_end, integrator(name))
    if not run.success:
        return run, []
    back_model = scenes.driven(scenes.backwards(angle, t_end))
    back = solve(back_model, t_end, integrator(name), state=freed(back_model, 0.0, run.q[-1], -run.v[-1]))
    if not back.success:
        return back, []
    inner, most = (run.energy.kinetic + run.energy.strain).max(), 0.5 * rate**2 * _inertia(model)
    away = np.abs(back.q[-1] - run.q[0]).max() / extent(model)
    travelled = rate * TURN_BACK
    return run, [
        Check("energy over that of a rebound", inner / most, 9.0),
        Check("back at the start, of what was travelled", away / travelled, RETURNS),
        drift_check(run, SETTLED),
        drift_check(back, SETTLED),
    ]


def half_turn(jump, name):
    """A motor jumps by `jump` rad within one step: the section has the angle of the motor, on the correct half-turn. The run stops if the
    bending exceeds what the material can carry.
    """
    model = scenes.driven(profile.quintic(0.0, jump, duration=1e-3, begin=0.01))
    run = solve(model, 0.012, integrator(name))
    objections = [model.rejection_reason(t, q) for t, q in zip(run.t, run.q)]
    return run, [Check("frames on the wrong half-turn or inside out", sum(map(bool, objections)), 0.5), drift_check(run, SETTLED)]


def bends_too_far(jump, name):
    """An Euler beam whose end turns by theta(t) has there a curvature of `sqrt(2 / sqrt(EI / rho A))` times the half derivative of theta,
    at most 1.285 jump / sqrt T for a quintic profile of duration T. St. Venant-Kirchhoff collapses at a compressive strain of 1 - 1/sqrt
    3. Beyond 1.5 times that strain the run must stop.
    """
    strain = 0.05 * np.sqrt(2 / SPREAD) * 1.285 * jump / np.sqrt(1e-3)
    share = strain / (1 - 1 / np.sqrt(3))
    return Stop(("inverted", "objection", "half-turn"), (*COLLAPSED, "wrong half-turn"), share > 1.5) if share > 1 else None
