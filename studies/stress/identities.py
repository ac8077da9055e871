"""Cases of the stress study that no refined run can judge: identities tell right from wrong there.

Whole turns: the turned angle, the work, the shape. Steps that are too long: balance of forces and moments, energy.
Reversal: going back returns to the start.
"""

import numpy as np

from conditioning.systems import freed
from polyida import profile
from polyida.run.solve import solve
from stress import scenes
from stress.outcome import COLLAPSED, Check, Stop, balance, extent, held, integrator, tip

SETTLED = 1e-9  # of the scene's size: drift of phi
SPREAD = float(np.sqrt(scenes.STIFF.E / scenes.STIFF.rho / 12) * 0.1)  # m2/s, sqrt(EI / rho A) of a plate 0.1 m high
TURN_BACK = 0.05  # s, when the motor of `reversal` turns back
RETURNS = 1e-2  # of what was travelled, how near a reversed motion must come to its start


def turned(run):
    """Angle of the line from the hub to the tip, followed from frame to frame, (frames,), rad."""
    x, y = tip(run).T
    return np.unwrap(np.arctan2(y, x))


def many_turns(turns, name):
    """A motor turns a plate `turns` times, 0.1 s a turn, 1 s at least: at every frame it has turned by theta(t), but for three
    times what the acceleration bends it, and is as long as the centrifugal force makes it; at the fastest its kinetic energy is
    that of the turning plate; at the end every node stands where it began; the work of the motor is the energy gained. What a step
    may lose adds up over the turns, and so rtol goes down with them, but of IDA, which tests q of flexible bodies to rtol^(3/2); Radau IIA
    takes no step above 5 ms, as the work is summed up from frame to frame."""
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
    return run, [*checks, held(run, SETTLED), *balance(run, 0.01, 0.01)]


def _stretch_of_a_turn():
    """Elongation of the plate of `driven` at 1 rad/s, m: rho L^3 / 3E of itself, m L^2 / EA of its tip mass."""
    return scenes.STIFF.rho / (3 * scenes.STIFF.E) + scenes.TIP / (scenes.STIFF.E * 0.1 * 0.01)


def _inertia(model):
    """Moment of inertia about the origin, kg m2."""
    swing = np.stack([-model.reference[:, 1], model.reference[:, 0]], axis=1).ravel()
    return float(swing @ (model.mass() @ swing))


def large_steps(h, name):
    """The swinging plates with steps too long to be accurate: phi holds; no more energy comes in than 2 % of what is turned over
    (none by the energy-momentum method), no more goes than the fall to rest sets free; at every frame but the
    energy-momentum method's the forces and moments of everything together balance to 1e-3 of the weight."""
    model = scenes.swing()
    run = solve(model, max(0.5, 20 * h), integrator(name, h))
    if name == "energy":
        return run, [held(run, SETTLED), *balance(run, 1e-7, 1e-7)]
    gained = balance(run, 0.02, 1.0)[0]
    below, forces = Check("energy below rest", _below_rest(run), 0.02), unbalanced_forces(run)
    return run, [held(run, SETTLED), gained, below, Check("balance of all forces", forces, 1e-3)]


def _below_rest(run):
    """How far the energy falls below that of the plates hanging at rest, over what the fall to there sets free."""
    model = run.model
    weight = 9.81 * (model.mass() @ np.tile([0.0, 1.0], model.n_nodes)).reshape(-1, 2)[:, 1]
    free = float(weight @ np.abs(model.reference[:, 0]))
    total = run.energy.total
    return max(float(total[0] - total.min()) / free - 1, 0.0)


def unbalanced_forces(run):
    """Largest sum of all nodes' forces M a + g + B^T lam, and of their moments about the origin, over the weight (times the
    scene's size) or the inertia where that is more: what acts within the plates drops out of both.
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
    """Beyond sqrt(2 m / g) a step falls farther than a plate is long: Newton's iteration starts from where nothing is."""
    stop = Stop(("newton", "inverted", "objection"), ("Newton does not converge", *COLLAPSED), only=False)
    return stop if 9.81 * h * h / 2 > 1.0 else None


def reversal(rate, name):
    """A motor at `rate` rad/s turns back within one step of 1 ms: the plate holds no more energy than an elastic rebound at twice
    the speed would leave in it; and with all velocities turned round and the motor running backwards every node comes back to
    where it began, to 1 % of what the tip has travelled."""
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
        held(run, SETTLED),
        held(back, SETTLED),
    ]


def half_turn(jump, name):
    """A motor jumps by `jump` rad within one step: the section stands at its angle, on the right half-turn. Where the jump
    bends the plate beyond what its material bears, the run stops."""
    model = scenes.driven(profile.quintic(0.0, jump, duration=1e-3, begin=0.01))
    run = solve(model, 0.012, integrator(name))
    objections = [model.rejection_reason(t, q) for t, q in zip(run.t, run.q)]
    return run, [Check("frames on the wrong half-turn or inside out", sum(map(bool, objections)), 0.5), held(run, SETTLED)]


def bends_too_far(jump, name):
    """Euler's beam, its end turned by theta(t), has the curvature `sqrt(2 / sqrt(EI / rho A))` times the half derivative of theta
    there, at most 1.285 jump / sqrt T for a quintic within T. St. Venant-Kirchhoff bears a strain of 1 - 1/sqrt 3 in compression;
    at half as much again nothing but a stop is right.
    """
    strain = 0.05 * np.sqrt(2 / SPREAD) * 1.285 * jump / np.sqrt(1e-3)
    share = strain / (1 - 1 / np.sqrt(3))
    return Stop(("inverted", "objection", "half-turn"), (*COLLAPSED, "wrong half-turn"), share > 1.5) if share > 1 else None
