"""Slopes in parameters that move the kinks of loads and motors, and with them the steps of a run: each piece between kinks is stretched.

A state's time moves by dt/dp, evenly between the kinks, and steps of a piece by `dh/dp = (dt_end/dp - dt_begin/dp) / count`. To the slope
at fixed times come `sum dt/dp d/dt (w . r + mu . phi + J)`, what h does in Newmark's formulas,
`-dh/dp sum y . (2 (q_1 - q_0)/h - v_0) + z . (v_1 - v_0)/h`, and what it does in what each piece begins with, by differences of that.
"""

import numpy as np

from polyida.adjoint.parameters import in_time
from polyida.integrate.alpha.start import started
from polyida.integrate.kinks import edges

SMALL = 1e-4  # of h, by which it is changed in differences


class Moving:
    """The sums of a run; speeds: {name: dt/dp at the ends of its segments}, empty where no parameter moves a kink."""

    def __init__(self, model, settings, run, parameters):
        begin, end = float(run.t[0]), float(run.t[-1])
        self.model, self.settings = model, settings
        moving = {name: parameter.kinks(begin, end) for name, parameter in parameters.items()}
        self.edges = np.array(edges(model, begin, end))
        self.speeds = {name: self._speeds(kinks) for name, kinks in moving.items() if kinks}
        self.times, self.slopes, self.stretched = [], [], []

    def _speeds(self, kinks):
        speeds, times = np.zeros(len(self.edges)), np.array(list(kinks))
        for k in range(1, len(self.edges) - 1):
            near = np.abs(times - self.edges[k]) <= 1e-12 * max(1.0, abs(self.edges[k]))
            speeds[k] = sum(np.array(list(kinks.values()))[near])
        return speeds

    def works(self, t, work, own=None):
        """Entries at states whose times t are (k,), of a Work whose times are those or just beside; own: of J's own slope in these."""
        self.at(t, in_time(self.model, work) if own is None else in_time(self.model, work) + own)

    def at(self, t, slopes):
        """Slopes in times t, (k,) each."""
        self.times.append(t)
        self.slopes.append(slopes)

    def steps(self, piece, q, v, ends, y, z):
        """Steps of a piece from q, v to ends = (q, v), (k, n) each, slips of q left out, with their multipliers y and z."""
        slope = -(np.sum(y * (2.0 * (ends[0] - q) / piece.h - v)) + np.sum(z * (ends[1] - v)) / piece.h)
        self.stretch(piece, slope)

    def begun(self, piece, state, sent):
        """A piece's beginning; sent: bars of what its first step began with."""
        self.stretch(piece, self._by_h(state, sent, piece.h), self._by_before(state, sent, piece))

    def stretch(self, piece, slope, before=0.0):
        """Slopes in h of a piece, and of the piece before."""
        self.stretched.append((piece, slope, before))

    def _by_h(self, state, sent, h):
        values = [_dot(sent, started(self.settings, self.model, state, h * (1.0 + s))) for s in (SMALL, -SMALL)]
        return (values[0] - values[1]) / (2.0 * SMALL * h)

    def _by_before(self, state, sent, piece):
        if piece.kind != "on":
            return 0.0
        values = [_dot(sent, started(self.settings, self.model, _after(state, piece.before * (1.0 + s)), piece.h)) for s in (SMALL, -SMALL)]
        return (values[0] - values[1]) / (2.0 * SMALL * piece.before)

    def add_to(self, sums, course):
        """Add it all to the sums of the parameters that move kinks."""
        t, slopes = (np.concatenate(parts) if parts else np.zeros(0) for parts in (self.times, self.slopes))
        for name, speeds in self.speeds.items():
            moved = {piece.first: self._change(piece, course, speeds) for piece in course.pieces}
            before = dict(zip([piece.first for piece in course.pieces[1:]], moved.values()))
            total = slopes @ np.interp(t, self.edges, speeds)
            total += sum(by_h * moved[piece.first] + by_before * before.get(piece.first, 0.0) for piece, by_h, by_before in self.stretched)
            sums[name] = sums[name] + total

    def _change(self, piece, course, speeds):
        """dh/dp."""
        ends = [float(course.states(k, k + 1)[0][0]) for k in (piece.first, piece.first + piece.count)]
        return float(np.diff(np.interp(ends, self.edges, speeds))[0]) / piece.count


def _dot(sent, ready):
    return sum(float(bar @ x) for bar, x in zip(sent, (ready.q, ready.v, ready.a, ready.memory["a_alg"])))


def _after(state, h):
    """The state behind steps of another h."""
    return type(state)(state.t, state.q, state.v, state.a, state.lam, state.memory | {"h": h})
