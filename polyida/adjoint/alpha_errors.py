"""Errors of a quantity of a run of generalized-alpha, from time steps and from Newton's method, by the multipliers of its adjoint.

The multipliers of generalized-alpha's equations (alpha.py) weigh what these equations leave. Exact states put into the steps leave nothing in r,
phi and the recursion of A, with A made by it again; only Newmark's formulas leave

    tau_v = int a dt - h ((1 - gamma) A_0 + gamma A_1),    tau_q = int (t_1 - t) a dt - h^2 ((1/2 - beta) A_0 + beta A_1)

a being cubic through the accelerations of four states, on one side of kinks. With the states that pieces begin from, and with what the
trapezoidal rule lacks in a mean over time,

    J* - J = -sum (y . tau_q + z . tau_v) + sum over beginnings P_v . (v_consistent - v_begun) + quadrature of J

The states of the run put into the equations of a step leave what Newton's method left: `J* - J = sum w . r + mu . phi`.

Modes whose phase is lost, `omega^3 h^2 T / 12 > 1`, make the first estimate useless. The same sum with tau averaged over time by a Gaussian
of width `(h^2 T / 12)^(1/3)` has no part of these modes; the relative difference is their share.
"""

from dataclasses import replace

import numpy as np

from polyida.adjoint.alpha import AlphaAdjoint
from polyida.adjoint.mesh_error import MeshError
from polyida.errors import DONE, REASONS, StepFailure
from polyida.integrate.alpha.steps import table_of
from polyida.integrate.discontinuities import at_kink
from polyida.integrate.start import motor_jump, started
from polyida.jit import entry, fast
from polyida.jit.intrinsics import address, call
from polyida.model.differences import beside, near_points, step_integrals
from polyida.objective.objective import OneFrame, terms_of
from polyida.objective.peak_stress import PeakStress
from polyida.system import RATE, RESIDUAL

WIDTHS = 3.0  # of the Gaussian, on each side
FAST = 0.45  # share of modes whose phase is lost from which on an estimate is not trusted
STARTING = 10  # steps of a start, whose transient lam at an instant sees
TOGETHER = 128  # coordinates that are averaged at once
AT_INSTANT = 0.2  # of the slopes in lam and a: a frame that has more makes J depend on an instant


@entry
def truncation(numbers, a, at, weights, ahead, y, z, tau, shares):
    """Fill tau (2, count, n), what Newmark's formulas leave of q and v, and shares (count,) = -(y . tau_q + z . tau_v) of equal steps.

    numbers: h, beta, gamma. a (., n): accelerations; at (count,): first one of each step's polynomial; weights (count, 2, points): of
    `step_integrals`. ahead (count + 1, n): A.
    """
    h, beta, gamma = numbers
    for k in range(shares.shape[0]):
        for i in range(a.shape[1]):
            by_v = -(1.0 - gamma) * ahead[k, i] - gamma * ahead[k + 1, i]
            by_q = -(0.5 - beta) * ahead[k, i] - beta * ahead[k + 1, i]
            for j in range(weights.shape[2]):
                x = a[at[k] + j, i]
                by_v += weights[k, 0, j] * x
                by_q += weights[k, 1, j] * x
            tau[0, k, i], tau[1, k, i] = h * h * by_q, h * by_v
            shares[k] -= y[k, i] * tau[0, k, i] + z[k, i] * tau[1, k, i]


@fast
def averaged_part(shares, first_seen, last_seen, tau, old, factors, old_factors, first, low, high, mean):
    """`sum factors . tau` of coordinates low to high - 1 over steps from `first` on, with averaged tau; mean (2, .): workspace."""
    total, count, size = 0.0, tau.shape[1], high - low
    for k in range(shares.shape[1]):
        mean[:] = 0.0
        for j in range(first_seen[k], last_seen[k]):
            for e in range(2):
                share, out = shares[e, k, j - first_seen[k]], mean[e]
                x = tau[e, j, low:high] if j < count else old[e, j - count, low:high]
                for i in range(size):
                    out[i] += share * x[i]
        at = first + k
        for e in range(2):
            y, x = factors[e, at, low:high] if at < count else old_factors[e, at - count, low:high], mean[e]
            for i in range(size):
                total += y[i] * x[i]
    return total


@entry
def averaged(t, h, widths, tau, old, factors, old_factors, first, last):
    """`-sum factors . tau` over steps first to last - 1, with tau over h^4 and h^3 averaged over time.

    t, h, widths (count,): middle of each step, its length, and width of the Gaussian; tau, factors (2, ., n): of the first steps, old, old_factors:
    of those behind them.
    """
    steps, total = max(0, last - first), 0.0
    first_seen, last_seen = np.zeros(steps, np.int64), np.zeros(steps, np.int64)
    for k in range(steps):
        while abs(t[first_seen[k]] - t[first + k]) > WIDTHS * widths[first + k]:
            first_seen[k] += 1
        last_seen[k] = first + k
        while last_seen[k] < t.shape[0] and abs(t[last_seen[k]] - t[first + k]) <= WIDTHS * widths[first + k]:
            last_seen[k] += 1
    shares = np.zeros((2, steps, np.max(last_seen - first_seen) if steps else 0))
    for k in range(steps):
        at, weight = first + k, 0.0
        for j in range(first_seen[k], last_seen[k]):
            s = (t[j] - t[at]) / widths[at]
            g = np.exp(-0.5 * s * s) * h[j]
            weight += g
            shares[0, k, j - first_seen[k]], shares[1, k, j - first_seen[k]] = g * (h[at] / h[j]) ** 4, g * (h[at] / h[j]) ** 3
        shares[:, k] /= weight
    n, mean = tau.shape[2], np.empty((2, TOGETHER))
    for low in range(0, n, TOGETHER):  # as many coordinates as stay in the processor's cache
        total -= averaged_part(shares, first_seen, last_seen, tau, old, factors, old_factors, first, low, min(low + TOGETHER, n), mean)
    return total


@entry
def left_over(f, workspace, q, v, a, lam, w, mu, kappa, r, phi):
    """(`sum w . r + mu . phi + kappa . rate`, status) of the states (count, .) of prepared steps; kappa (0, m): no rates. r (n,), phi (m,): scratch.

    f: addresses of the table's functions; workspace: address of the model's.
    """
    total = 0.0
    for k in range(q.shape[0]):
        at = address(q[k]), address(v[k])
        ended = call(f[RESIDUAL], workspace, k, at[0], at[1], address(a[k]), address(lam[k]), address(r), address(phi))
        if ended != DONE:
            return total, ended
        for i in range(r.shape[0]):
            total += w[k, i] * r[i]
        for i in range(phi.shape[0]):
            total += mu[k, i] * phi[i]
        if kappa.shape[0]:
            ended = call(f[RATE], workspace, k, at[0], at[1], address(phi), 0, 0, 0)
            if ended != DONE:
                return total, ended
            for i in range(phi.shape[0]):
                total += kappa[k, i] * phi[i]
    return total, DONE


class AlphaErrors(AlphaAdjoint):
    """Backward sweep over a run that sums the parts of its error.

    pieces: (first, last) number of the states of the smooth parts of the run. steps (steps,): shares of steps in the error of time, without the
    quadrature; lost: their
    part of vibrations whose phase is lost. window: steps whose tau is not averaged yet, or that are near to such steps.
    """

    observes = True

    def __init__(self, run, objective, memory_limit):
        super().__init__(run, objective, [], memory_limit)
        self.run, self.objective, model = run, objective, self.model
        self.plain, self.table, self.system = replace(self.settings, start="plain"), table_of(self.settings, model, False), None
        segments, count = self.history.segments, len(self.history.frames) - 1
        self.times = np.concatenate([np.asarray(self.history.states(k, k + 1)[0]) for k in (0, count)])
        breaks = [
            one.first
            for one in segments
            if one.kind != "on" or not one.first or at_kink(model, float(self.ready[one.first][0].t)) or self._switches(one)
        ]
        self.pieces = list(zip(breaks, [*breaks[1:], count]))
        self.steps, self.t, self.h = np.zeros(count), np.zeros(count), np.zeros(count)
        self.lost = self.newton = 0.0
        self.at_instants, self.of_forces = 0.0, 0.0
        self.window, self.open = None, 0
        self.meshes = {body.name: MeshError(body) for body in model.bodies} if not self.reasons_of_mesh() else {}

    def _switches(self, segment):
        """True if a gap opens or closes where a segment begins; other steps that are shortened for a contact leave the motion smooth."""
        state, gaps = self.ready[segment.first][0], self.model.gaps
        before, after = (gaps(state.t + s, state.q + s * state.v) < 0.0 for s in (-0.5 * segment.before, 0.5 * segment.h))
        return bool((before != after).any())

    def reasons_of_mesh(self):
        """Reasons why there is no estimate of the error of the meshes."""
        if not (self.model.is_scene and self.model.bodies):
            return ("the scene has no full plates",)
        result = []
        for body in self.model.bodies:
            if body.plate.element != "wachspress":
                result.append(f"{body.name!r} has virtual elements, whose projection has an error of its own")
            if body.prony:
                result.append(f"{body.name!r} is viscoelastic: the relaxed strains of its cells are not estimated")
            if np.ptp(body.factors[0]) > 0.0:
                result.append(f"{body.name!r} has cells of different stiffness, across which strains jump")
        if any(isinstance(part, PeakStress) for _, part in terms_of(self.objective)):
            result.append("PeakStress reads the stress of cells, whose own error is not estimated")
        return tuple(result)

    def observe(self, segment, first, t, motion, slopes, result):
        """Add the shares of some steps."""
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
        tau = np.empty((2, count, self.model.n))
        numbers_of_method = np.array([segment.h, c.beta, c.gamma])
        truncation(numbers_of_method, np.ascontiguousarray(a), at - low, weights, motion[3], *keep, tau, self.steps[first:end])
        self.t[first:end], self.h[first:end] = begin + h, h
        self.lost += self.steps[first:end].sum()
        self._average(begin + 0.5 * h, h, tau, keep, first == piece[0])
        _, q, v, a, lam = self.history.states(first + 1, end + 1)
        self.newton += self._left_over(segment.h, begin[0], t, q, v, a, lam, result)
        for name, mesh in self.meshes.items():
            mesh.add(*(x.reshape(count, -1, 2) for x in (q, v, result.w)), slopes.energies.get(name, np.zeros(count)))
        for one in (slopes.lam, slopes.a):
            if one is not None and one.size:
                sizes = np.abs(one).sum(axis=1)
                self.of_forces, self.at_instants = self.of_forces + sizes.sum(), max(self.at_instants, sizes.max())

    def _left_over(self, h, begin, t, q, v, a, lam, result):
        """What Newton's method left of the equations of some steps, times their multipliers."""
        n, m, table = self.model.n, self.model.m, self.table
        arrays = [np.ascontiguousarray(x, float) for x in (q, v, a, lam, result.w, result.mu)]
        kappa = result.kappa if self.model.velocity_rows.size else np.zeros((0, m))
        table.prepare(np.append(begin, t), (begin, t[-1]), h)
        if self.system is None:  # a table works with a factor, though no residual needs it
            self.system = table.system(self.settings)
            table.factor(self.system, t[0], *(x[0].copy() for x in arrays[:4]), *self.settings.coefficients.rates(h))
        with table.at_work(self.system) as at:
            total, ended = left_over(*at, *arrays, kappa, np.empty(n), np.empty(m))
        table.raise_error()
        if ended != DONE:
            raise StepFailure(*REASONS[ended], t[0])
        return total

    def observe_start(self, segment, bars):
        """Add what the velocities deviate from consistent ones where a piece begins."""
        (state, begun), model = self.ready[segment.first], self.model
        if segment.kind != "on":
            v = started(self.plain, model, state, segment.h).v
        elif at_kink(model, state.t):
            v = motor_jump(model, state, segment.before)
        else:
            return
        self.steps[segment.first] += float(bars.v @ (v - begun.v))

    def _average(self, t, h, tau, factors, closed):
        """Subtract from `lost` the averaged steps whose neighbours within WIDTHS are all known; closed: True if the piece begins with the first one here."""
        before_t, before_h, old, old_factors = self.window or (t[:0], h[:0], tau[:, :0].copy(), factors[:, :0].copy())
        t, h, self.open = np.append(t, before_t), np.append(h, before_h), len(t) + self.open
        widths = np.cbrt(h * h * np.ptp(self.times) / 12.0)
        known = t - WIDTHS * widths >= t[0]
        first = 0 if closed else min(self.open, int(np.argmax(known)) if known.any() else len(t))
        self.lost -= averaged(t, h, widths, tau, old, factors, old_factors, first, self.open)
        last = int(np.searchsorted(t, t[min(first, len(t) - 1)] + WIDTHS * widths.max(), side="right"))
        kept = t[:last], h[:last], _first_steps(tau, old, last), _first_steps(factors, old_factors, first)
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

    def reasons(self, time):
        """(share of modes whose phase is lost, reasons why an estimate of the error of time is not trusted)."""
        share = float(abs(self.lost / time)) if time else 0.0
        result, begin = [], [first for first, _ in self.pieces]
        if share > FAST:
            result.append(
                f"{100 * share:.0f} % of it come from vibrations whose phase is lost with steps of this size (omega^3 h^2 T > 12)"
            )
        if self.of_forces and self.at_instants > AT_INSTANT * self.of_forces:
            text = "the objective is of lam or a at an instant, and "
            if any(one.first not in begin for one in self.history.segments):
                result.append(f"{text}the step size changes")
            starts = sum(abs(self.steps[first : min(first + STARTING, last - STARTING)].sum()) for first, last in self.pieces)
            if starts > FAST * abs(time):
                result.append(f"{text}sees the first steps behind a start")
        return share, tuple(result)


def _first_steps(new, old, count):
    """The first `count` steps of those in new (2, ., n) and behind them in old, as a copy."""
    return np.concatenate([new[:, :count], old[:, : max(0, count - new.shape[1])]], axis=1)
