"""A run of generalized-alpha backwards: the steps of each piece by a sweep, its beginning on a tape."""

from dataclasses import replace

import numpy as np

from polyida.adjoint.alpha.forward import Forward, beginning, begun
from polyida.adjoint.alpha.moving import Moving
from polyida.adjoint.alpha.plain import PlainSweep, Sent
from polyida.adjoint.parameters.parameter import Work, stacked
from polyida.adjoint.steps.course import course_of
from polyida.adjoint.totals import OwnSlopes, Totals
from polyida.integrate.kinks import inner_side
from polyida.integrate.state import Counts
from polyida.linear.lu import Kept
from polyida.model.guarded import guard

CHUNK = 4_000_000  # bytes of multipliers that are held at once
LONGEST = 256  # steps


class Backward:
    """A run backwards: its course, what the sweeps take, the slopes so far."""

    def __init__(self, run, objective, names, memory_limit):
        self.model, self.settings = guard(run.model), run.integrator
        self.course = course_of(run, self.model, memory_limit)
        self.totals = Totals(run.model, names, run.plan.get("began") != "state")
        self.own = OwnSlopes(objective, run, self.course.frames, self.totals)
        self.counts, self.sweeps = Counts(), Kept()
        self.moving = Moving(self.model, self.settings, run, self.totals.parameters)
        self.tied = self.settings.form == "stabilised" and self.model.m > 0
        again = self.tied or self.moving.speeds
        self.forward = Forward(self.model, self.settings, self.course) if again else None

    def through(self, progress):
        """(Sent to the run's first state, the bar of its lam), all slopes of its frame with them."""
        sent, lam = Sent(*np.zeros((4, self.model.n))), np.zeros(self.model.m)
        for piece in reversed(self.course.pieces):
            sent = self._steps(piece, sent, lam, progress)
            if self.moving.speeds:
                self.moving.begun(piece, self.forward.ready[piece.first].state, sent)
            before = begun(self.settings, self.model, beginning(self.course, piece, None), piece, sent)
            self._entries(piece, before.entries)
            sent, lam = before.sent, before.lam
        if self.moving.speeds:
            self.moving.add_to(self.totals.sums, self.course)
        own = self.own.of(0, 1)
        bars = [bar + slope[0] if slope is not None else bar for bar, slope in zip(sent, (own.q, own.v, own.a))]
        return Sent(*bars, sent.ahead), lam if own.lam is None else lam + own.lam[0]

    def _steps(self, piece, sent, lam, progress):
        """Sent to what a piece began with; lam: what is sent to the multipliers of its last state."""
        sweep, end = self._sweep(piece.h), piece.first + piece.count
        slips = self.forward.slips(piece) if self.tied else None
        longest = int(max(1, min(LONGEST, CHUNK // (8 * self.model.n))))
        for last in range(end, piece.first, -longest):
            first = max(piece.first, last - longest)
            t, q, v, a, rows = self.course.states(first + 1, last + 1)
            own, inner = self.own.of(first + 1, last + 1), t
            if last == end:
                inner, own = np.append(t[:-1], inner_side(self.model, t[-1], piece.h)), _with_last(own, lam, rows.shape)
            more = {"slips": slips[first - piece.first : last - piece.first]} if self.tied else {}
            keep = tuple(np.empty((2, *q.shape))) if self.moving.speeds else None
            swept = sweep.back(inner, q, v, a, rows, own, sent, keep, **more)
            works = _works(inner, q, v, a, rows, swept)
            for work in works:
                self.totals.work(work)
            if keep:
                self._move(piece, first, last, works, own.by_time(), keep, *more.values())
            sent = swept.sent
            progress(float(t[0]))
        return sent

    def _move(self, piece, first, last, works, own, keep, slip=0.0):
        """Add what steps say of times that move."""
        t, q, v, _, _ = self.course.states(first, last + 1)
        if first == piece.first:
            v = np.concatenate([self.forward.ready[first].v[None], v[1:]])
        self.moving.works(t[1:], works[0], own)
        for work in works[1:]:
            self.moving.works(t[1:], work)
        self.moving.steps(piece, q[:-1], v[:-1], (q[1:] - slip, v[1:]), *keep)

    def _entries(self, piece, entries):
        """Add what a piece's beginning says of parameters, and of the time it is at."""
        if work := stacked(entries):
            self.totals.work(work)
            if self.moving.speeds:
                t = self.course.states(piece.first, piece.first + 1)[0]
                self.moving.works(np.repeat(t, len(work.t)), work)

    def _sweep(self, h):
        """The sweep of steps of this size, with the factor that it has where it is one of the last."""
        key = f"{h:.9e}"
        found = self.sweeps.take(key) or _sweep_of(self.model, self.settings)(self.model, self.settings, h, self.counts)
        self.sweeps.keep(key, found)
        return found


def _works(t, q, v, a, lam, swept):
    """The Works of steps: of their equations, and of the stabilised form's slip of q."""
    works = [Work(t, q, v, a, lam, swept.w, swept.mu, swept.kappa)]
    if swept.slips:
        (ahead, slip, eta), still = swept.slips, np.zeros_like(q)
        works += [Work(t, q, still, slip, eta, ahead), Work(t, q, still, still, np.zeros_like(eta), -ahead)]
    return works


def _sweep_of(model, settings):
    """The compiled sweep of a scene, or the plain one."""
    if model.compiled and settings.form == "index3" and settings.linear != "kkt":
        from polyida.adjoint.scene.sweep import SceneSweep

        return SceneSweep
    return PlainSweep


def _with_last(own, bar, shape):
    """Slopes with more of the multipliers of the last state."""
    if not bar.any():
        return own
    lam = np.zeros(shape) if own.lam is None else np.array(own.lam)
    lam[-1] += bar
    return replace(own, lam=lam)
