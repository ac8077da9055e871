"""Errors of a quantity of a run of generalized-alpha, from time steps and from Newton's method, by the multipliers of its adjoint.

The multipliers of generalized-alpha's equations (alpha.py) weigh what these equations leave. Exact states put into the steps leave nothing in r,
phi and the recursion of A, with A made by it again; only Newmark's formulas leave

    tau_v = int a dt - h ((1 - gamma) A_0 + gamma A_1),    tau_q = int (t_1 - t) a dt - h^2 ((1/2 - beta) A_0 + beta A_1)

a being cubic through the accelerations of four states, on one side of kinks. With the states that pieces begin from, and with what the
trapezoidal rule lacks in a mean over time,

    J* - J = -sum (y . tau_q + z . tau_v) + sum over beginnings P_v . (v_consistent - v_begun) + quadrature of J

The states of the run put into the equations of a step leave what Newton's method left: `J* - J = sum w . r + mu . phi`.

Modes whose phase is lost, `omega^3 h^2 T / 12 > 1`, make the first estimate useless. tau less its linear fit in time, weighted by a Gaussian of
width `(h^2 T / 12)^(1/3)`, is the part of these modes. As their phase is unknown, their share is the largest that this part has in the same sum when it
is shifted by up to half a period of the slowest of them.

A step ends just before a contact opens. The force there has two slopes: that of the closed contact would act over the whole step behind, which may
be much longer than the steps within the contact. So this state is linearised with the contact open; with `near_side` as it is, for comparison.
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
from polyida.model.differences import beside, near_points, step_integrals
from polyida.objective.objective import OneFrame, terms_of
from polyida.objective.peak_stress import PeakStress
from polyida.system import instant as ask

WIDTHS = 3.0  # of the Gaussian, on each side; half a period of a mode with omega = 1 / width has pi
LAGS = 25  # shifts of the part of the modes whose phase is lost, an odd number
FAST = 0.45  # share of modes whose phase is lost from which on an estimate is not trusted
CANCELLED = 1e-3  # of the sum of the sizes of the steps' errors: below, terms of higher order may be larger than the sum
TOGETHER = 128  # coordinates that are averaged at once
BEYOND = 1e-3  # of a step: from its end, just before a contact opens, to where that is open
AT_INSTANT = 0.2  # of the slopes in lam and a: a frame that has more makes J depend on an instant


@entry
def truncation(numbers, a, at, weights, ahead, factors, tau, shares):
    """Fill tau (2, count, n), what Newmark's formulas leave of q and v, and shares (count,) = -(f_q . tau_q + f_v . tau_v) of equal steps.

    numbers: h, beta, gamma. a (., n): accelerations; at (count,): first one of each step's polynomial; weights (count, 2, points): of
    `step_integrals`. ahead (count + 1, n): A. factors: f_q and f_v (count, n).
    """
    h, beta, gamma = numbers
    of_q, of_v = factors
    for k in range(shares.shape[0]):
        for i in range(a.shape[1]):
            by_v = -(1.0 - gamma) * ahead[k, i] - gamma * ahead[k + 1, i]
            by_q = -(0.5 - beta) * ahead[k, i] - beta * ahead[k + 1, i]
            for j in range(weights.shape[2]):
                x = a[at[k] + j, i]
                by_v += weights[k, 0, j] * x
                by_q += weights[k, 1, j] * x
            tau[0, k, i], tau[1, k, i] = h * h * by_q, h * by_v
            shares[k] -= of_q[k, i] * tau[0, k, i] + of_v[k, i] * tau[1, k, i]


@fast
def nearest(t, middle, width):
    """First and last + 1 number of the times t within WIDTHS widths of a step's, the number `middle`."""
    first, last = middle, middle + 1
    while first > 0 and t[middle] - t[first - 1] <= WIDTHS * width:
        first -= 1
    while last < t.shape[0] and t[last] - t[middle] <= WIDTHS * width:
        last += 1
    return first, last


@entry
def shifted(steps, tau, factors, first, last, ends, sums):
    """sums (LAGS,) -= `sum factors . fast` over steps first to last - 1, fast = tau less its linear fit in time, of the steps at each lag.

    steps: middle of each step, its length, and width of the Gaussian, (count,) each; tau, factors (2, ., n): over h^4 and h^3 a fit is made.
    The lags are from -WIDTHS to WIDTHS widths; one that leaves the steps adds nothing. If the run `ends` with the steps, fast is continued there by its
    odd image, without a jump or kink: the factors of an objective at the end are large there and cancel only in the sum with a smooth fast.
    """
    t, h, widths = steps
    n, at, beyond = tau.shape[2], np.empty((last - first, LAGS), np.int64), t.shape[0] - 1  # at: the step at each lag, -1 for none
    low, high, longest, image = first, last, 0, np.zeros((last - first, LAGS), np.bool_)
    for k in range(first, last):
        for lag in range(LAGS):
            time = t[k] + WIDTHS * widths[k] * (2.0 * lag / (LAGS - 1) - 1.0)
            if ends and time > t[beyond]:
                image[k - first, lag], time, high = True, 2.0 * t[beyond] - time, beyond + 1
            j = min(np.searchsorted(t, time), beyond)
            j -= j > 0 and time - t[j - 1] < t[j] - time
            at[k - first, lag] = j if abs(time - t[j]) <= h[j] else -1
            low, high = min(low, j), max(high, j + 1)
    seen = np.empty((high - low, 2), np.int64)
    for k in range(low, high):
        seen[k - low, 0], seen[k - low, 1] = nearest(t, k, widths[k])
        longest = max(longest, seen[k - low, 1] - seen[k - low, 0])
    shares, fast_part = np.empty((2, high - low, longest)), np.empty((2, high - low, TOGETHER))
    for k in range(low, high):
        begin, end, sum_0, sum_1, sum_2 = seen[k - low, 0], seen[k - low, 1], 0.0, 0.0, 0.0
        for j in range(begin, end):
            s = (t[j] - t[k]) / widths[k]
            g = np.exp(-0.5 * s * s) * h[j]
            sum_0, sum_1, sum_2 = sum_0 + g, sum_1 + g * s, sum_2 + g * s * s
        weight = sum_0 * sum_2 - sum_1 * sum_1
        for j in range(begin, end):
            s = (t[j] - t[k]) / widths[k]
            g = np.exp(-0.5 * s * s) * h[j] * ((sum_2 - sum_1 * s) / weight if end - begin > 1 else 1.0 / sum_0)
            shares[0, k - low, j - begin], shares[1, k - low, j - begin] = g * (h[k] / h[j]) ** 4, g * (h[k] / h[j]) ** 3
    for begin in range(0, n, TOGETHER):  # as many coordinates as stay in the processor's cache
        size = min(TOGETHER, n - begin)
        for k in range(low, high):
            for e in range(2):
                out = fast_part[e, k - low]
                for i in range(size):
                    out[i] = tau[e, k, begin + i]
                for j in range(seen[k - low, 0], seen[k - low, 1]):
                    share = shares[e, k - low, j - seen[k - low, 0]]
                    for i in range(size):
                        out[i] -= share * tau[e, j, begin + i]
        for k in range(first, last):
            for lag in range(LAGS):
                j = at[k - first, lag]
                if j < 0:
                    continue
                for e in range(2):
                    total, scale, way = 0.0, (h[k] / h[j]) ** (4 - e), -1.0 if image[k - first, lag] else 1.0
                    for i in range(size):
                        total += factors[e, k, begin + i] * fast_part[e, j - low, i]
                    sums[lag] -= way * scale * total
                    if image[k - first, lag]:
                        total, scale = 0.0, (h[k] / h[beyond]) ** (4 - e)
                        for i in range(size):
                            total += factors[e, k, begin + i] * fast_part[e, beyond - low, i]
                        sums[lag] -= 2.0 * scale * total


@entry
def left_over(functions, workspace, states, multipliers, r, phi):
    """(`sum w . r + mu . phi + kappa . rate`, status) of prepared steps.

    functions, workspace: of the model's table (system/instant.py). states: q, v, a, lam (count, .); multipliers: w, mu, kappa (count, .), kappa
    (0, m) without rates. r (n,), phi (m,): scratch.
    """
    model, total = (functions, workspace), 0.0
    q, v, a, lam = states
    w, mu, kappa = multipliers
    for k in range(q.shape[0]):
        status = ask.residual(model, k, q[k], v[k], a[k], lam[k], r, phi)
        if status != DONE:
            return total, status
        for i in range(r.shape[0]):
            total += w[k, i] * r[i]
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
    """Backward sweep over a run that sums the parts of its error.

    pieces: (first, last) number of the states of the smooth parts of the run. steps (steps,): shares of steps in the error of time, without the
    quadrature. far: {number of a state where a contact opens: time along v to its far side}. lost (LAGS,): for each shift, the sum of the part of the
    vibrations whose phase is lost. window: steps whose part is not added yet, or that are near to such steps.
    """

    observes = True

    def __init__(self, run, objective, memory_limit, near_side=False):
        super().__init__(run, objective, [], memory_limit)
        self.run, self.objective, model = run, objective, self.model
        self.plain, self.table, self.system = replace(self.settings, start="plain"), table_of(self.settings, model, False), None
        segments, count = self.history.segments, len(self.history.frames) - 1
        self.times = np.concatenate([np.asarray(self.history.states(k, k + 1)[0]) for k in (0, count)])
        breaks, self.far = [], {}
        for one in segments:
            on = one.kind == "on" and one.first > 0
            before, after = self._open_gaps(one) if on else np.zeros((2, 0), bool)
            if not on or at_kink(model, float(self.ready[one.first][0].t)) or (before != after).any():
                breaks.append(one.first)
            if (after & ~before).any() and not near_side:
                self.far[one.first] = BEYOND * min(one.before, one.h)
        self.pieces = list(zip(breaks, [*breaks[1:], count]))
        self.steps, self.t, self.h = np.zeros(count), np.zeros(count), np.zeros(count)
        self.lost, self.newton = np.zeros(LAGS), 0.0
        self.at_instants, self.of_forces = 0.0, 0.0
        self.window, self.open = None, 0
        self.meshes = {body.name: MeshError(body) for body in model.bodies} if not self.reasons_of_mesh() else {}

    def _open_gaps(self, segment):
        """Which gaps are open just before and behind the start of a segment; steps that are shortened within a contact leave the motion smooth."""
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
        truncation(numbers_of_method, np.ascontiguousarray(a), at - low, weights, motion[3], tuple(keep), tau, self.steps[first:end])
        self.t[first:end], self.h[first:end] = begin + h, h
        self._shift(begin + 0.5 * h, h, tau, np.asarray(keep), first == piece[0], piece == self.pieces[-1])
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

    def _shift(self, t, h, tau, factors, closed, ends):
        """Add to `lost` the steps whose neighbours within the shift and the fit are known; closed: True if a piece begins with the first one here;
        ends: True if the run ends with this piece.
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
            shifted((t, h, widths), tau, factors, first, self.open, ends, self.lost)
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
        """(share of modes whose phase is lost, reasons why an estimate of the error of time is not trusted), of the results of `of_time`."""
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
