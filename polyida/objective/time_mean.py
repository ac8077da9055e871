"""Objectives that are means over the time of a run.

With the values s_n >= 0 of frames n (of any sign if p = 1), `J = (sum w_n s_n^p / T)^(1/p)`, T = t_N - t_0, w_n the trapezoidal rule's.
Then

    dJ/ds_n = w_n / T (s_n / J)^(p - 1)
    dJ/dt_k = (sum_n dw_n/dt_k s_n (s_n / J)^(p - 1) - J dT/dt_k) / (p T)        at fixed s

These forms do not overflow for large p and s. A run of one frame, an equilibrium, has w = T.

The trapezoidal rule is as accurate as generalized-alpha, and far less accurate than Radau IIA. For that each interval of h is integrated by
Hermite's cubic: the rule gets `h^2/12 (f'_n - f'_{n+1})`, f = s^p. f' is the derivative along `q_n + tau v_n`, by a difference of values of
f at these q: the slopes in q and v of J are those at such moved frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.integrate.discontinuities import inner_side
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.io.layout import frames_at_once
from polyida.joint.attachment import Attachment
from polyida.model.differences import along, around, beside, near_points, step_integrals
from polyida.model.guarded import guard
from polyida.objective.objective import Objective, Slopes, call_user, run_of
from polyida.validation import complex_of_pairs, floats, is_number, is_one_of, named_keywords

NOTHING = 1e-30  # of the largest slope of J in a value: less is set to zero, it is too small for single precision
MOVED = np.array([0.0, 1e-3, 2e-3, -1e-3, -2e-3])  # of the interval behind or before a frame: moves of q and t for f'
ZOOMS, BEND = 4, 1e-2  # looks at a function of time, each 32 times as close; jump of its rate, relative to its largest rate
INWARD = np.array([-3.0, 4.0, -1.0]) / (
    12.0 * 2.0 * MOVED[1]
)  # h INWARD . f of a frame and of two moved ones: h^2/12 times the derivative inward
SAME_TIME = 1e-9  # of the run's time
FRAMES_WIDE = 10.0  # typical time of variation over the time between frames: rates are differences over a hundredth of it


def chosen(part, model, place, known):
    """The chosen bodies of `known`, {name: placed body}: by name or part, or all for None. Raises InputError in the name of `part`."""
    if not model.is_scene:
        raise InputError(f"{part}: {model.name} is no scene's model; write it as a pi.objective.UserObjective")
    if place is None and known:
        return list(known.values())
    name = named(model, place)
    if not is_one_of(name, known):
        called = f"called {place!r:.100}" if place is not None else "there"
        raise InputError(f"{part}: no body that deforms is {called}; known: {', '.join(map(repr, known)) or 'none'}")
    return [known[name]]


def named(model, place):
    """The name of a part of the model; anything else as it is."""
    return next((name for name, part in model.parts.items() if part is place), place)


def deforming(model):
    """{name: placed body} of a scene's bodies that deform."""
    return {body.name: body for body in (*model.bodies, *(placed for placed in model.reduced_bodies if placed.deforms))}


class Frames:
    """The frames of a slice of a run, each array read on first use. moves (count,): times by which they are moved along v, or None."""

    def __init__(self, run, part, moves=None):
        """Take a run, the slice of its frames, and the times (count,), s, by which they move along v, or None."""
        self.run, self.part, self.moves = run, part, moves

    @cached_property
    def t(self):
        """Times of the frames, s, (count,), with their moves."""
        t = np.asarray(self.run.t[self.part], float)
        return t if self.moves is None else t + self.moves

    @cached_property
    def q(self):
        """Coordinates of the frames, (count, n), moved along v."""
        q = np.asarray(self.run.q[self.part], float)
        return q if self.moves is None else q + self.moves[:, None] * np.asarray(self.run.v[self.part], float)

    @cached_property
    def v(self):
        """Velocities of the frames, (count, n), without moves."""
        return np.asarray(self.run.v[self.part], float)

    @cached_property
    def lam(self):
        """Multipliers of the frames, (count, m), without moves."""
        return np.asarray(self.run.lam[self.part], float)


class TimeMean(Objective):
    """Base of means of order p; a subclass writes `_evaluator`. _of_material: True if J depends on parameters that `Slopes.direct`
    lacks.
    """

    p: float = 1.0
    _of_material = False

    def _along_v(self, run: Any) -> bool:
        """True if the values depend on t and q alone, and neither they nor their rates in t jump."""
        return True

    def _evaluator(self, model: Any, span: float) -> Callable[[Frames], tuple[Callable[[], NDArray], Callable[[NDArray], Slopes]]]:
        """Return a function evaluate(Frames) -> (values, to_slopes).

        values() is s (count,) of the frames; to_slopes(dJ/ds (count,)) is the Slopes of J. span: the mean time between frames, s. Raises
        InputError if the model lacks the part.
        """
        raise NotImplementedError

    def __call__(self, run: Any) -> float:
        """Return J of a run, the mean of order p over its time."""
        run = run_of(type(self).__name__, run)
        return self._mean(run, self._of(run)).value

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """Return a function of a slice of frames that returns the Slopes; values are computed once over the whole run and again in each
        slice.
        """
        run = run_of(type(self).__name__, run)
        evaluate = self._of(run)
        mean = self._mean(run, evaluate)

        def of(part):
            """The Slopes of a slice, from the places at the frames and beside them."""
            of_model = (lambda model: elsewhere(model, part)) if self._of_material else None
            total = Slopes(t=mean.by_times[part], of_model=of_model)
            for moves, shares in zip(mean.moves, mean.shares):
                frames = Frames(run, part, None if moves is None else moves[part])
                here = evaluate(frames)[1](shares[part])
                total = total.plus(here if moves is None or here.q is None else replace(here, v=frames.moves[:, None] * here.q))
            return total

        def elsewhere(model, part):
            """The part of J of some frames with another model."""
            of_other = self.named(run.model)._evaluator(guard(model), _span(run))
            pairs = ((None if moves is None else moves[part], shares[part]) for moves, shares in zip(mean.moves, mean.shares))
            return float(sum(shares @ of_other(Frames(run, part, moves))[0]() for moves, shares in pairs))

        of.value = mean.value  # type: ignore[attr-defined]
        of.quadrature = lambda pieces: self._quadrature(run, evaluate, mean, pieces)  # type: ignore[attr-defined]
        return of

    def _mean(self, run, evaluate):
        """The _Mean of a run: by the trapezoidal rule, or of Radau IIA by cubics, unless their sum is not positive."""
        t, s, moves = np.asarray(run.t, float), self._sizes(run, evaluate), None
        if len(t) > 1 and isinstance(getattr(run, "integrator", None), RadauIIA) and self._along_v(run):
            h = np.diff(t)
            moves = MOVED[1:, None] * np.where(MOVED[1:, None] > 0.0, np.append(h, 0.0), np.append(0.0, h))
            s = np.stack([s, *(self._sizes(run, evaluate, each) for each in moves)])
            mean = _Mean(t, s, self.p, moves, _usable_rates(run, t))
            if mean.value > 0.0 or self.p == 1.0:
                return mean
            s = s[0]
        return _Mean(t, s[None], self.p)

    def _quadrature(self, run, evaluate, mean, pieces):
        """What the trapezoidal rule lacks in each interval, (frames - 1,), by cubics through the values of four frames; pieces: as of
        `Objective`.
        """
        t, s, result = np.asarray(run.t, float), mean.sizes[0], np.zeros(max(0, len(run.t) - 1))
        of_mean = mean.value / (self.p * (np.ptp(t) or 1.0)) * (relative(s, mean.value) ** self.p)
        for first, last, behind in pieces:
            values, steps = of_mean[first : last + 1].copy(), np.arange(last - first)
            if behind is not None:
                size = evaluate(Frames(behind, slice(None)))[0]()
                values[0] = mean.value / (self.p * (np.ptp(t) or 1.0)) * (relative(size, mean.value) ** self.p)[0]
            at, count = near_points(steps, 0, last - first)
            nodes, h = at[:, None] + np.arange(count), np.diff(t[first : last + 1])
            weights = step_integrals(t[first + nodes], t[first + steps], h)[:, 0]
            rule = 0.5 * (of_mean[first:last] + of_mean[first + 1 : last + 1])
            result[first:last] = h * (np.sum(weights * values[nodes], axis=1) - rule)
        return result

    def _of(self, run):
        """The function evaluate(Frames) -> (values, to_slopes) of `_evaluator`, for the model and the time steps of a run."""
        return self._evaluator(guard(run.model, type(self).__name__), _span(run))

    def _sizes(self, run, evaluate, moves=None):
        """The values s of all frames, or beside them at `moves`, (frames,)."""
        step = frames_at_once(run.q.shape[1])
        parts = [slice(k, k + step) for k in range(0, len(run.t), step)]
        return np.concatenate([evaluate(Frames(run, part, None if moves is None else moves[part]))[0]() for part in parts])


def _usable_rates(run, t):
    """1.0 if v of the frame at the begin of each interval, and of that at its end, is the interval's, (2, intervals); 0.0 where v jumps."""
    model, near, usable = guard(run.model), SAME_TIME * np.ptp(t), np.ones((2, len(t)))
    for kink in model.kinks(float(t[0]) - near, float(t[-1])):
        k = int(np.abs(t - kink).argmin())
        if abs(t[k] - kink) <= near and model.m:
            q, speed = np.asarray(run.q[k], float), np.abs(run.v[max(0, k - 1) : k + 2]).max()
            after, before = (model.phi_t(beside(float(kink), side), q) for side in (1, -1))
            usable[0, k] = np.abs(after - before).max() <= SAME_TIME * speed
    usable[:, [event.frame for event in run.events if event.frame is not None]] = 0.0
    return np.stack([usable[0, :-1], usable[1, 1:]])


def _span(run):
    """The mean time between frames, s."""
    return float(np.ptp(run.t)) / max(1, len(run.t) - 1)


def rates(model: Any, function: Callable[[float], NDArray], t: NDArray, span: float) -> NDArray:
    """The derivative of a function of time at times t, (count, ...), by differences that end at the model's kinks.

    At a kink it is the mean of the derivatives on both sides. span: the mean time between frames, s.
    """
    wide = FRAMES_WIDE * (span or 1.0)

    def rate(at):
        """The derivative at one time, by differences; at a kink the mean of both sides."""
        kinks = model.kinks(at - wide, at + wide)
        sides = (beside(at, -1), beside(at, 1)) if at in kinks else (at,)
        return np.mean([along(lambda s, side=side: function(float(side + s)), wide, around(kinks, side)) for side in sides], axis=0)

    return np.array([rate(at) for at in t.tolist()])


def bends(function: Callable[[float], NDArray], begin: float, end: float) -> bool:
    """True if the rate of a function of time jumps: it then still changes between neighbours where it changes most, seen more and more
    closely.
    """
    size = 0.0
    for _ in range(ZOOMS):
        t = np.linspace(begin, end, 65)
        rates_here = np.diff([function(at) for at in t.tolist()], axis=0) / (t[1] - t[0])
        jumps = np.abs(np.diff(rates_here, axis=0)).max(axis=1)
        size, k = size or np.abs(rates_here).max(), int(jumps.argmax())
        begin, end = float(t[k]), float(t[k + 2])
    return bool(jumps.max() > BEND * size)


class _Mean:
    """The mean of order p of sizes s (1, frames) over times t, its slopes in s, `shares`, and in t at fixed s, `by_times`.

    moves (4, frames): of the frames whose sizes s (5, frames) has behind those of the frames; usable: of `_usable_rates`. An interval with
    one usable f' is integrated by a parabola, one without by the trapezoidal rule.
    """

    def __init__(self, t, s, p, moves=(), usable=None):
        """Compute the weights of the frames, the mean and its slopes."""
        steps = np.diff(t)
        length = float(t[-1] - t[0]) or 1.0
        weights = np.zeros(s.shape)
        weights[0] = np.convolve(steps, [0.5, 0.5]) if len(steps) else 1.0
        begin, end = slice(None, -1), slice(1, None)
        ends = [] if usable is None else [(1, begin, usable[0] * (2.0 - usable[1])), (3, end, usable[1] * (2.0 - usable[0]))]
        tilt = 0.0 if usable is None else (usable[1] - usable[0]) / 6.0
        for k, frames, share in ends:
            weights[[0, k, k + 1], frames] += INWARD[:, None] * steps * share
        weights[0, begin] -= tilt * steps
        weights[0, end] += tilt * steps
        self.sizes = s
        self.moves = [None, *moves]
        self.value = power_mean((weights / length).ravel(), s.ravel(), p)
        steep = relative(s, self.value) ** (p - 1.0)
        steep[np.abs(steep) < NOTHING * np.abs(steep).max()] = 0.0
        self.shares = weights / length * steep
        by_weights = s * steep
        each = (0.5 - tilt) * by_weights[0, begin] + (0.5 + tilt) * by_weights[0, end]  # dJ/dh of the intervals
        for k, frames, share in ends:  # h^2/12 f'
            each += 2.0 * share * (INWARD @ by_weights[[0, k, k + 1], frames])
        self.by_times = (np.append(0.0, each) - np.append(each, 0.0)) / (p * length)
        if len(steps):
            self.by_times[[0, -1]] += np.array([self.value, -self.value]) / (p * length)


def power_mean(weights: NDArray, s: NDArray, p: float) -> float:
    """`(sum weights s^p)^(1/p)`, weights of sum 1."""
    largest = float(np.abs(s).max())
    total = float(weights @ (s / largest) ** p) if largest else 0.0
    return largest * (total if p == 1.0 else max(total, 0.0) ** (1.0 / p))


def relative(s: NDArray, mean: float) -> NDArray:
    """s / mean, 0 where both are."""
    return s / mean if mean else np.zeros_like(s)


def power(part, p):
    """The order p of a mean as a float. Raises InputError, with the name `part` in its message, unless p is a number of 1 or more."""
    if not (is_number(p) and p >= 1):
        raise InputError(f"{part}: p = {p!r:.100} must be a number of 1 or more, such as 8")
    return float(p)


@named_keywords
@dataclass(frozen=True, eq=False)
class Compliance(TimeMean):
    """Time mean of `f . q`, J, the work of the loads on the displacements; f = -g(t, 0, 0): gravity, loads, and all other forces at q = 0.

    Of an equilibrium for small displacements, `pi.static(model, linear=True)`, it is twice the strain energy, the compliance of topology
    optimisation, unless constraints move or springs are strained at q = 0. For a load that jumps in a frame the value before the jump is
    taken.
    """

    def _along_v(self, run):
        """False: loads may jump in time, and the values with them."""
        return False  # loads may jump

    def _evaluator(self, model, span):
        """The function of Frames that gives the works f . q and the way back to Slopes."""
        still = np.zeros(model.n)

        def load(t):
            """The load f = -g(t, 0, 0), (n,), at a time."""
            return -model.force(t, still, still)

        def evaluate(frames):
            """Works of the loads in the frames, and the function to Slopes."""
            at = _sides(model, frames)
            f = np.array([load(t) for t in at.tolist()])

            def to_slopes(factor):
                """The Slopes of J from dJ/d(f . q) of the frames."""
                by_time = lambda: factor * np.sum(rates(model, load, at, span) * frames.q, axis=1)  # noqa: E731
                rest, none = np.zeros_like(frames.q), np.zeros_like(frames.lam)
                work = at, rest, rest, rest, none, -factor[:, None] * frames.q, none
                return Slopes(q=factor[:, None] * f, t=by_time, work=work)

            return lambda: np.sum(f * frames.q, axis=1), to_slopes

        return evaluate


def _sides(model, frames):
    """Times of the frames; of one at a kink a time just before it, just behind it for the first frame."""
    begin = frames.run.t[0]
    if len(frames.run.t) == 1:
        return frames.t
    return np.array([inner_side(model, t, 1.0 if t > begin else -1.0) for t in frames.t.tolist()])


@named_keywords
@dataclass(frozen=True, eq=False)
class Deviation(TimeMean):
    """Time mean of `|x(t) - path(t)|^2`, m2, of a point x.

    Parameters
    ----------
    point : str, part or attachment
        As for `run.position`.
    path : function f(t) -> (2,) float, m, or (2,) float, m
        The desired place. If the path bends at a kink of the model, J has two slopes in the time of that kink; gradients have their mean.

    Raises
    ------
    InputError
        For another path; of a run if the point is not in its model.
    """

    point: Any
    path: Callable[[float], ArrayLike] | ArrayLike
    _of_material = True

    def __post_init__(self):
        """Check a path that is a fixed place. Raises InputError for a wrong one."""
        if not callable(self.path):
            self._place(self.path)

    def named(self, model: Any) -> Deviation:
        """Return the objective with the name of its part, or of the body of its attachment, instead of the part itself."""
        body = named(model, self.point.body) if isinstance(self.point, Attachment) else None
        return replace(self, point=OnBody(body, self.point) if isinstance(body, str) else named(model, self.point))

    def _along_v(self, run):
        """True if the path is a fixed place, or has no bend within the run."""
        return not callable(self.path) or not bends(self._at, float(run.t[0]), float(run.t[-1]))

    def _evaluator(self, model, span):
        """The function of Frames that gives the squares of the distances and the way back to Slopes."""
        point = self.point.on(model) if isinstance(self.point, OnBody) else self.point
        pull, at = _pull(model, point), cache(self._at)

        def evaluate(frames):
            """Squares of the distances in the frames, and the function to Slopes."""
            gap = model.position(point, frames.q) - ([at(t) for t in frames.t.tolist()] if callable(self.path) else at(0.0))

            def to_slopes(factor):
                """The Slopes of J, from dJ/d(squared distance) of the frames, (count,)."""
                toward = 2.0 * factor[:, None] * gap
                return Slopes(q=pull(frames.q, toward), t=lambda: -np.sum(toward * rates(model, self._at, frames.t, span), axis=1))

            return lambda: np.sum(gap**2, axis=1), to_slopes

        return evaluate

    def _at(self, t):
        """The place of the path at t, (2,)."""
        advice = "; it must be a function of time"
        return self._place(call_user(f"Deviation: path({t:.6g})", self.path, t, advice=advice) if callable(self.path) else self.path)

    def _place(self, place):
        """The place as an array (2,). Raises InputError for anything else."""
        pair = floats(place)
        if pair is None or pair.shape != (2,):
            raise InputError(
                f"Deviation: path = {place!r:.100} must be two finite numbers (x, y), m, or a function of time that gives them"
            )
        return pair


class OnBody(NamedTuple):
    """An attachment, and the name of its body."""

    body: str
    side: Attachment

    def on(self, model):
        """The attachment on the body of that name."""
        return self.side.on(model.parts[self.body])


def _pull(model, point):
    """A function (q (frames, n), forces (frames, 2) on the point) that returns the generalised forces, (frames, n)."""
    if model.is_scene:
        return lambda q, forces: model.pulled((model.side(point), "point"), complex_of_pairs(forces))
    return lambda q, forces: np.einsum("fxk,fx->fk", _slopes(model, point, q), forces)


def _slopes(model, point, q):
    """d position/dq of a user's model, (frames, 2, n), by differences."""
    sizes = np.maximum(1.0, np.abs(q).max(axis=0, initial=0.0))
    ways = sizes[:, None] * np.eye(model.n)
    slopes = [along(lambda s, way=way: model.position(point, q + s * way)) / size for size, way in zip(sizes, ways)]
    return np.stack(slopes, axis=2)
