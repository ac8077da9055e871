"""The compiled loop of generalized-alpha: whole stretches of steps of any model, through its table (system/table.py).

The stabilised form has positions on phi = 0 and velocities on `phi_q v + phi_t = 0` at once:
`q_1 = q_0 + h v_0 + h^2 ((1/2 - beta) a_0 + beta a_1) - M^-1 phi_q^T eta`. eta takes up the local error of q along the constraints, so that v,
with Newmark's formula in a, need not (Gear, Gupta, Leimkuhler 1985; Arnold, Cardona, Bruels 2015). In one Newton step, with dq = x + y, x
what v and a follow and `y = -M^-1 phi_q^T eta`: `S x + phi_q^T dlam = -r`, `phi_q x = -rate/gamma'`, `phi_q y = -(phi - rate/gamma')`. All
that eta has added in a step, SLIP, is made anew along the rows of each iteration, so that at last it is along those of the step's end.
"""

import numpy as np

from polyida.integrate.alpha import step
from polyida.integrate.alpha.step import BIAS, DD, DLAM, DQ, DV, LAM, PHI, RATE, SLIP, A, Q, R, V
from polyida.integrate.kinks import inner_side
from polyida.jit import entry, part
from polyida.system import table
from polyida.system.python import table_of
from polyida.system.table import DONE, NOT_FINITE, REFACTOR, TOO_FAR, address, call


@part
def close(f, w, k, p, y, x):
    """(how it ended, the largest |phi| at the trial state); phi and rate there."""
    now, rows = x.now, x.rows
    for i in range(now.shape[1]):
        a1 = (now[DD, i] / (p.h * p.h) - (0.5 - p.beta) * y.past[step.A_ALG, i]) / p.beta
        now[DV, i] = p.h * ((1.0 - p.gamma) * y.past[step.A_ALG, i] + p.gamma * a1)
    for i in range(rows.shape[1]):
        rows[PHI, i], rows[RATE, i] = y.closed[PHI, i], y.closed[RATE, i]
    places = address(now[Q]), address(now[DD]), address(now[DV]), address(rows[PHI]), address(rows[RATE])
    ended = call(f[table.CLOSE], w, k, places[0], places[1], places[2], places[3], places[4], 0)
    worst = 0.0
    for i in range(rows.shape[1]):
        worst = max(worst, abs(rows[PHI, i]))
    return ended, worst


@part
def part_constraints(f, w, k, p, x):
    """rows[PHI] becomes rate/gamma', for the solve of x; rows[BIAS] what is left for y, phi - rate/gamma'."""
    rows = x.rows
    ended = call(f[table.RATE], w, k, address(x.now[Q]), address(x.now[V]), address(rows[BIAS]), 0, 0, 0)
    for i in range(rows.shape[1]):
        share = rows[BIAS, i] / p.to_v
        rows[BIAS, i] = rows[PHI, i] - share
        rows[PHI, i] = share
    return ended


@part
def slip(f, w, k, p, y, x):
    """Make SLIP anew, and q with it."""
    now, past = x.now, y.past
    for i in range(now.shape[1]):
        now[DD, i] -= now[SLIP, i]
    ended = call(f[table.PROJECT], w, k, address(x.rows[BIAS]), address(now[SLIP]), 1, 0, 0, 0)
    for i in range(now.shape[1]):
        now[DD, i] += now[SLIP, i]
        now[Q, i] = past[Q, i] + (p.h * past[V, i] + now[DD, i])
    return ended


@part
def settle(f, w, k, x, tied):
    """Ask the model for the state; in the stabilised form take what is left of the velocity constraint out of v."""
    now, rows = x.now, x.rows
    ended = call(f[table.ACCEPT], w, k, address(now[Q]), 0, 0, 0, 0, 0)
    if ended != DONE or not tied:
        return ended
    ended = call(f[table.RATE], w, k, address(now[Q]), address(now[V]), address(rows[RATE]), 0, 0, 0)
    if ended != DONE:
        return ended
    ended = call(f[table.PROJECT], w, k, address(rows[RATE]), address(now[V]), 0, 0, 0, 0)
    for i in range(rows.shape[1]):
        rows[RATE, i] = 0.0
    return ended


@part
def newton(f, w, k, p, tied, y, x, counts):
    """Newton's iteration from the predicted state, or on from where it was. Returns how it ended and the last |dq|."""
    last, now, rows = step.begin(p, y, x), x.now, x.rows
    call(f[table.HOLD], w, k, address(y.past[Q]), address(y.past[V]), 0, 0, 0, 0)
    if tied and last == 0.0:
        for i in range(now.shape[1]):
            now[SLIP, i] = 0.0
    state = address(now[Q]), address(now[V]), address(now[A]), address(rows[LAM])
    r, phi, dq, dlam = address(now[R]), address(rows[PHI]), address(now[DQ]), address(rows[DLAM])
    for iteration in range(p.max_iterations):
        ended = call(f[table.RESIDUAL], w, k, state[0], state[1], state[2], state[3], r, phi)
        counts[0] += 1
        if ended == DONE and p.incremental:
            ended, _ = close(f, w, k, p, y, x)
        if ended == DONE and tied:
            ended = part_constraints(f, w, k, p, x)
        if ended != DONE:
            return ended, last
        ended = call(f[table.SOLVE], w, k, state[0], state[3], r, phi, dq, dlam)
        counts[1] += 1
        moved, settled, hopeless, allowed = step.correct(p, y, x, iteration == 1, last)
        if ended == DONE and tied:
            ended = slip(f, w, k, p, y, x)
        if ended != DONE:
            return ended, last
        if settled:
            ended, worst = close(f, w, k, p, y, x)
            if ended != DONE:
                return ended, last
            if worst <= allowed:
                return settle(f, w, k, x, tied), moved
        if hopeless:
            return REFACTOR, moved
        last = moved
    return REFACTOR, last


@part
def factor(f, w, k, c, x):
    """Make the step matrix at the trial state."""
    now, rows = x.now, x.rows
    return call(f[table.FACTOR], w, k, address(now[Q]), address(now[V]), address(now[A]), address(rows[LAM]), address(c), 0)


@entry
def stretch(f, w, first, p, c, tied, y, x, counts, qs, vs, accelerations, lams):
    """Steps until the frames, the factor's use or that of h end: (steps, how it ended, last |dq|).

    f, w: addresses of the table's functions and of the model's workspace; first: number of the instant at the first step's end; c (2,):
    p.to_a and p.to_v; counts (3,): of residuals, solves and matrices made. Frames go to
    qs, vs, accelerations (steps, n), lams (steps, m).
    """
    moved = 0.0
    for k in range(lams.shape[0]):
        end, moved = newton(f, w, first + k, p, tied, y, x, counts)
        if f[table.FACTOR] and (end in (REFACTOR, NOT_FINITE)):
            y.marks[step.MOVED] = y.marks[step.AHEAD] = y.marks[step.BEHIND] = 0.0
            step.predict(p, y, x)
            end = factor(f, w, first + k, c, x)
            counts[2] += 1
            y.marks[step.CONTRACTION], y.marks[step.AGE] = 1.0, step.FRESHEN
            if end == DONE:
                end, moved = newton(f, w, first + k, p, tied, y, x, counts)
        if end != DONE:
            return k, end, moved
        end = step.finish(p, y, x, qs[k], vs[k], accelerations[k], lams[k])
        if end != DONE:
            return (k if end == TOO_FAR else k + 1), end, moved
    return lams.shape[0], DONE, moved


class Loop:
    """Stretches of compiled steps of a model."""

    def __init__(self, settings, model, counts, memory, trial):
        self.settings, self.model, self.counts, self.memory, self.trial = settings, model, counts, memory, trial
        self.tied = settings.form == "stabilised" and model.m > 0
        self.table = table_of(model, settings.linear, self.tied, settings.incremental_phi and model.carries)

    def system(self):
        """What factors the step matrix, not factored yet."""
        return self.table.system(self.settings)

    def prepare(self, times, method):
        """Get ready for steps between the times."""
        ends = inner_side(self.model, times[0], -method.h), inner_side(self.model, times[-1], method.h)
        self.table.prepare(times, ends, method.h)

    def factor(self, system, p, t):
        """Factor the system at the trial state. Raises SingularSystem."""
        q, v, a = self.trial.now[:3].copy()
        self.counts.residuals += self.table.factor(system, t, q, v, a, self.trial.rows[LAM].copy(), p.to_a, p.to_v)

    def steps(self, p, system, first, last, *frames):
        """Take the steps from `first` to `last` with a factored system: (steps, how it ended, last |dq|)."""
        counts, c = np.zeros(3, np.int64), np.array([p.to_a, p.to_v])
        with self.table.at_work(system) as (functions, workspace):
            result = stretch(functions, workspace, first, p, c, self.tied, self.memory, self.trial, counts, *frames)
        residuals, solves, made = map(int, counts)
        self.counts.residuals += residuals
        self.counts.solves += solves
        self.counts.newton_iterations += solves
        if made:
            system.read()
            self.counts.tangents += made
            self.counts.factorizations += made
        return result
