"""Errors of a quantity of a run of generalized-alpha, from time steps and from Newton's method, by the multipliers of its adjoint.

The multipliers of generalized-alpha's equations (alpha_sweep.py) weigh what these equations leave. Exact states put into the steps leave nothing
in r, phi and the recursion of A, with A made by it again; only Newmark's formulas leave

    tau_v = int a dt - h ((1 - gamma) A_0 + gamma A_1),    tau_q = int (t_1 - t) a dt - h^2 ((1/2 - beta) A_0 + beta A_1)

a being cubic through the accelerations of four states, on one side of kinks. With the states that pieces begin from, and with what the
trapezoidal rule lacks in a mean over time,

    J* - J = -sum (y . tau_q + z . tau_v) + sum over beginnings P_v . (v_consistent - v_begun) + quadrature of J

The states of the run put into the equations of a step leave what Newton's method left: `J* - J = sum w . r + mu . phi`.

Vibrations whose phase is lost make the first estimate useless: lost_phases.py says how much they may change it.

A step ends just before a contact opens. The force there has two slopes: that of the closed contact would act over the whole step after it,
which may be much longer than the steps within the contact. So this state is linearised with the contact open; with `near_side` as it is,
for comparison.
"""

from dataclasses import replace

import numpy as np

from polyida.adjoint.alpha import AlphaAdjoint
from polyida.adjoint.lost_phases import LAGS, WIDTHS, add_shifted
from polyida.adjoint.mesh_error import MeshError
from polyida.errors import DONE, REASONS, StepFailure
from polyida.integrate.alpha.start import motor_jump, started
from polyida.integrate.alpha.steps import table_of
from polyida.integrate.discontinuities import at_kink
from polyida.jit import entry
from polyida.model.differences import beside, near_points, step_integrals
from polyida.objective.objective import OneFrame, terms_of
from polyida.objective.peak_stress import PeakStress
from polyida.system import instant as ask

FAST = 0.45  # share of modes whose phase is lost from which on an estimate is not trusted
CANCELLED = 1e-3  # of the sum of the sizes of the steps' errors: below, terms of higher order may be larger than the sum
BEYOND = 1e-3  # of a step: from its end, just before a contact opens, to where that is open
AT_INSTANT = 0.2  # of the slopes in lam and a: a frame that has more makes J depend on an instant


def truncation(h, coefficients, accelerations, at, weights, ahead):
    """What Newmark's formulas leave of equal steps of h: tau (2, count, n), tau[0] of q (its unit), tau[1] of v (its unit).

    accelerations (., n); at (count,): number of the first one of each step's polynomial. weights (count, 2, points): of `step_integrals`, in
    int a dt / h and int (t_1 - t) a dt / h^2; `[:, ::-1]` brings them into the order of tau. ahead (count + 1, n): A at the ends of the steps.
    """
    beta, gamma = coefficients.beta, coefficients.gamma
    tau = np.stack([-(0.5 - beta) * ahead[:-1] - beta * ahead[1:], -(1.0 - gamma) * ahead[:-1] - gamma * ahead[1:]])
    for k in range(weights.shape[2]):
        tau += weights[:, ::-1, k].T[..., None] * accelerations[at + k]
    return tau * np.array([h * h, h])[:, None, None]


@entry
def left_over(functions, workspace, states, multipliers, residual, phi):
    """(`sum w . r + mu . phi + kappa . rate`, status) of prepared steps.

    functions, workspace: of the model's table (system/instant.py). states: q, v, a, lam (count, .); multipliers: w, mu, kappa (count, .), kappa
    (0, m) without rates. residual (n,), phi (m,): scratch.
    """
    model, total = (functions, workspace), 0.0
    q, v, a, lam = states
    w, mu, kappa = multipliers
    for k in range(q.shape[0]):
        status = ask.residual(model, k, q[k], v[k], a[k], lam[k], residual, phi)
        if status != DONE:
            return total, status
        for i in range(residual.shape[0]):
            total += w[k, i] * residual[i]
        for i in range(phi.shape[0]):
            total += mu[k, i] * phi[i]
        if kappa.shape[0]:
            status = ask.rate(model, k, q[k], v[k], phi, 0)
            if status != DONE:
                return total, status
            for i in range(phi.shape[0]):
                total += kappa[k, i] * phi[i]
    return total, DONE


class AlphaErrors(AlphaAdjoint):
    """Backward sweep over a run that sums the parts of its error."""

    observes = True

    def __init__(self, run, objective, memory_limit, near_side=False):
        """Find the smooth pieces of the run and the states where contacts open.

        near_side: True to linearise these with the contact closed.
        """
        super().__init__(run, objective, [], memory_limit)
        self.run, self.objective = run, objective
        self.plain = replace(self.settings, start="plain")  # settings that give consistent velocities at the start of a piece
        # what evaluates residuals, and its factor once it is needed
        self.table, self.system = table_of(self.settings, self.model, False), None
        count = len(self.history.frames) - 1
        self.times = np.concatenate([np.asarray(self.history.states(k, k + 1)[0]) for k in (0, count)])  # first and last of the run
        breaks, self.far = self._breaks(near_side)  # far: {number of a state: time along v to the far side of the contact that opens}
        self.pieces = list(zip(breaks, [*breaks[1:], count]))  # (first, last) number of the states of the smooth parts of the run
        self.steps = np.zeros(count)  # shares of steps in the error of time, without the quadrature
        self.t = np.zeros(count)  # ends of the steps
        self.lost = np.zeros(LAGS)  # for each shift, the sum of the part of the vibrations whose phase is lost
        self.window, self.open = None, 0  # steps whose part is not added yet, with those near to them; the number of the former
        self.newton = 0.0  # error from Newton's method
        self.of_forces, self.at_instants = 0.0, 0.0  # sum, and largest of a frame, of the objective's slopes in lam and a
        self.meshes = {body.name: MeshError(body) for body in self.model.bodies} if not self.reasons_of_mesh() else {}

    def _breaks(self, near_side):
        """Where the motion is not smooth.

        Returns (numbers of the states at which a smooth part begins, {number of a state where a contact opens: time along v to its far side}).
        """
        breaks, far = [], {}
        for one in self.history.segments:
            on = one.kind == "on" and one.first > 0
            before, after = self._open_gaps(one) if on else np.zeros((2, 0), bool)
            if not on or at_kink(self.model, float(self.ready[one.first][0].t)) or (before != after).any():
                breaks.append(one.first)
            if (after & ~before).any() and not near_side:
                far[one.first] = BEYOND * min(one.before, one.h)
        return breaks, far

    def _open_gaps(self, segment):
        """Which gaps are open just before and just after the start of a segment, (gaps,) each.

        Steps that are shortened within a contact leave the motion smooth.
        """
        state, gaps = self.ready[segment.first][0], self.model.gaps
        return [gaps(state.t + s, state.q + s * state.v) >= 0.0 for s in (-0.5 * segment.before, 0.5 * segment.h)]

    def linearised(self, number, q, v):
        """Places on the far side of contacts that open."""
        at = np.array([one for one in self.far if 0 <= one - number < len(q)], int) - number
        q = q.copy()
        q[at] += np.array([self.far[k + number] for k in at.tolist()])[:, None] * v[at] if len(at) else 0.0
        return q

    def reasons_of_mesh(self):
        """Reasons why there is no estimate of the error of the meshes."""
        if not (self.model.is_scene and self.model.bodies):
            return ("the scene has no full plates",)
        result = []
        for body in self.model.bodies:
            if body.plate.order == 2:
                result.append(f"{body.name!r} has quadratic cells, whose error is not estimated")
            elif body.plate.element != "wachspress":
                result.append(f"{body.name!r} has virtual elements, whose projection has an error of its own")
            if body.prony:
                result.append(f"{body.name!r} is viscoelastic: the relaxed strains of its cells are not estimated")
            if np.ptp(body.factors[0]) > 0.0:
                result.append(f"{body.name!r} has cells of different stiffness, across which strains jump")
        if any(isinstance(part, PeakStress) for _, part in terms_of(self.objective)):
            result.append("PeakStress reads the stress of cells, whose own error is not estimated")
        return tuple(result)

    def observe(self, segment, first, t, motion, slopes, result):
        """Add the shares of some steps, of equal length: of time, of Newton's method, of the meshes, and how much J is of an instant.

        first: number of the state before them; t (count,): their ends; motion[3]: A, (count + 1, n). result: their multipliers w, mu, kappa, and
        `keep` (2, count, n), those of the formulas of q and v.
        """
        # the error of time
        count, end, keep = len(t), first + len(t), result.keep
        piece = next(one for one in self.pieces if one[0] <= first < one[1])
        numbers = np.arange(first, end)
        at, points = near_points(numbers, *piece)
        low = int(at[0])
        times, _, _, a, _ = self.history.states(low, int(at[-1]) + points)
        if low == piece[0]:
            a = np.concatenate([self.ready[low][1].a[None], a[1:]])
        begin, h, c = times[numbers - low], np.full(count, segment.h), self.settings.coefficients
        weights = step_integrals(times[at[:, None] - low + np.arange(points)], begin, h)
        tau = truncation(segment.h, c, a, at - low, weights, motion[3])
        self.steps[first:end] -= np.sum(keep * tau, axis=(0, 2))
        self.t[first:end] = begin + h
        self._shift(begin + 0.5 * h, h, tau, np.asarray(keep), first == piece[0], piece == self.pieces[-1])
        # the errors of Newton's method and of the meshes
        _, q, v, a, lam = self.history.states(first + 1, end + 1)
        self.newton += self._left_over(segment.h, begin[0], t, q, v, a, lam, result)
        for name, mesh in self.meshes.items():
            mesh.add(*(x.reshape(count, -1, 2) for x in (q, v, result.w)), slopes.energies.get(name, np.zeros(count)))
        # whether J depends on an instant of lam or a
        for one in (slopes.lam, slopes.a):
            if one is not None and one.size:
                sizes = np.abs(one).sum(axis=1)
                self.of_forces = self.of_forces + sizes.sum()
                self.at_instants = max(self.at_instants, sizes.max())

    def _left_over(self, h, begin, t, q, v, a, lam, result):
        """What Newton's method left of the equations of some steps, times their multipliers."""
        n, m, table = self.model.n, self.model.m, self.table
        states = tuple(np.ascontiguousarray(x, float) for x in (q, v, a, lam))
        kappa = result.kappa if self.model.velocity_rows.size else np.zeros((0, m))
        multipliers = tuple(np.ascontiguousarray(x, float) for x in (result.w, result.mu, kappa))
        table.prepare(np.append(begin, t), (begin, t[-1]), h)
        if self.system is None:  # a table works with a factor, though no residual needs it
            self.system = table.system(self.settings)
            table.factor(self.system, t[0], *(x[0].copy() for x in states), *self.settings.coefficients.rates(h))
        with table.at_work(self.system) as at:
            total, ended = left_over(*at, states, multipliers, np.empty(n), np.empty(m))
        table.raise_error()
        if ended != DONE:
            raise StepFailure(*REASONS[ended], t[0])
        return total

    def observe_start(self, segment, adjoints):
        """Add what the velocities deviate from consistent ones where a piece begins."""
        (state, begun), model = self.ready[segment.first], self.model
        if segment.kind != "on":
            v = started(self.plain, model, state, segment.h).v
        elif at_kink(model, state.t):
            v = motor_jump(model, state, segment.before)
        else:
            return
        self.steps[segment.first] += float(adjoints.v @ (v - begun.v))

    def _shift(self, t, h, tau, factors, closed, ends):
        """Add to `lost` the steps whose neighbours within the shift and the fit are known, and keep the others for the next call.

        The sweep goes backward: these steps are before those of `window`. t, h (steps,): their middles and lengths; tau, factors (2, steps, n).
        closed: True if a piece begins with the first one here; ends: True if the run ends with this piece.
        """
        self.open += len(t)
        if self.window:
            t, h, tau, factors = (
                np.concatenate([x, old], axis=1 if x.ndim > 1 else 0) for x, old in zip((t, h, tau, factors), self.window)
            )
        widths = np.cbrt(h * h * np.ptp(self.times) / 12.0)
        known = t - 2.0 * WIDTHS * widths >= t[0]
        first = 0 if closed else min(self.open, int(np.argmax(known)) if known.any() else len(t))
        if first < self.open:
            add_shifted((t, h, widths), tau, factors, first, self.open, ends, self.lost)
        last = int(np.searchsorted(t, t[min(first, len(t) - 1)] + 2.0 * WIDTHS * widths.max(), side="right"))
        kept = t[:last], h[:last], tau[:, :last].copy(), factors[:, :last].copy()
        self.window, self.open = (None, 0) if closed else (kept, first)

    def of_time(self):
        """(error of time, its shares (steps,))."""
        frames, pieces = self.history.frames, []
        states = np.flatnonzero(frames >= 0)
        for first, last in self.pieces:
            inside = states[(states >= first) & (states <= last)]
            if len(inside) > 1:
                behind = self._behind(first) if inside[0] == first else None
                pieces.append((int(frames[inside[0]]), int(frames[inside[-1]]), behind))
        shares = self.steps.copy()
        if quadrature := getattr(self.objective_slopes.slopes, "quadrature", None):
            shares[states[1:] - 1] += quadrature(pieces)
        return float(shares.sum()), shares

    def _behind(self, first):
        """The state from which the piece that begins with a number starts, as a run of one frame."""
        state = self.ready[first][1]
        t = beside(state.t, 1) if at_kink(self.model, state.t) else state.t
        return OneFrame(self.run.model, *(np.asarray(x, float)[None] for x in (t, state.q, state.v, state.a, state.lam)))

    def reasons(self, time, steps):
        """(share of modes whose phase is lost, reasons why an estimate of the error of time is not trusted).

        time, steps: results of `of_time`.
        """
        share = float(np.abs(self.lost).max() / abs(time)) if time else 0.0
        result, begin = [], [first for first, _ in self.pieces]
        instant = self.of_forces and self.at_instants > AT_INSTANT * self.of_forces
        if share > FAST:
            start = ", or errors that the start of the method leaves in lam and a," if instant else ""
            result.append(
                f"vibrations whose phase is lost with steps of this size (omega^3 h^2 T > 12){start} change it by up to {100 * share:.0f} %"
            )
        if not instant and abs(time) < CANCELLED * np.abs(steps).sum():  # at an instant of lam or a they cancel in any case
            result.append(f"the errors of the steps cancel to less than {CANCELLED:g} of their sizes: terms of higher order may be larger")
        if instant and any(one.first not in begin for one in self.history.segments):
            result.append("the objective is of lam or a at an instant, and the step size changes")
        return share, tuple(result)
