"""Objectives that are means over the time of a run.

With the values s_n >= 0 of frames n (of any sign if p = 1), `J = (sum w_n s_n^p / T)^(1/p)`, T = t_N - t_0, w_n the trapezoidal rule's. Then

    dJ/ds_n = w_n / T (s_n / J)^(p - 1)
    dJ/dt_k = (sum_n dw_n/dt_k s_n (s_n / J)^(p - 1) - J dT/dt_k) / (p T)        at fixed s

These forms do not overflow for large p and s. A run of one frame, an equilibrium, has w = T.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.integrate.discontinuities import inner_side
from polyida.io.layout import frames_at_once
from polyida.joint.attachment import Attachment
from polyida.model.differences import along, around, beside, near_points, step_integrals
from polyida.model.guarded import guard, unguarded
from polyida.objective.objective import Objective, Slopes, call_user, run_of
from polyida.validation import complex_of_pairs, floats, is_number, is_one_of, named_keywords

NOTHING = 1e-30  # of the largest slope of J in a value: less is set to zero, it is too small for single precision
FRAMES_WIDE = 10.0  # typical time of variation over the time between frames: rates are differences over a hundredth of it


def chosen(part, model, place, known):
    """The chosen bodies of `known`, {name: placed body}: by name or part, or all for None. Raises InputError in the name of `part`."""
    if not model.is_scene:
        raise InputError(f"{part}: {type(unguarded(model)).__name__} is no scene's model; write it as a pi.objective.UserObjective")
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
    return {body.name: body for body in (*model.bodies, *(placed for placed in model.few if placed.deforms))}


class Frames:
    """The frames of a slice of a run, each array read on first use."""

    def __init__(self, run, part):
        self.run, self.part = run, part

    @cached_property
    def t(self):
        """Times, (count,)."""
        return np.asarray(self.run.t[self.part], float)

    @cached_property
    def q(self):
        """(count, n)."""
        return np.asarray(self.run.q[self.part], float)

    @cached_property
    def lam(self):
        """(count, m)."""
        return np.asarray(self.run.lam[self.part], float)


class TimeMean(Objective):
    """A mean of order p over time. _of_material: True if it depends on the model beyond the parameters that `Slopes.direct` names."""

    p: float = 1.0
    _of_material = False

    def _evaluator(self, model: Any, span: float) -> Callable[[Frames], tuple[Callable[[], NDArray], Callable[[NDArray], Slopes]]]:
        """Return a function evaluate(Frames) -> (values, to_slopes).

        values() is s (count,) of the frames; to_slopes(dJ/ds (count,)) is the Slopes of J. span: the mean time between frames, s. Raises
        InputError if the model lacks the part.
        """
        raise NotImplementedError

    def __call__(self, run: Any) -> float:
        run = run_of(type(self).__name__, run)
        return _Mean(run.t, self._sizes(run, self._of(run)), self.p).value

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """Return a function of a slice of frames that returns the Slopes; values are computed once over the whole run and again in each slice."""
        run = run_of(type(self).__name__, run)
        evaluate = self._of(run)
        mean = _Mean(run.t, self._sizes(run, evaluate), self.p)

        def of(part):
            result = evaluate(Frames(run, part))[1](mean.shares[part])
            of_model = (lambda model: float(mean.shares[part] @ elsewhere(model, part))) if self._of_material else None
            return result.plus(Slopes(t=mean.by_times[part], of_model=of_model))

        def elsewhere(model, part):
            """The values of the frames with another model."""
            return self.named(run.model)._evaluator(guard(model), _span(run))(Frames(run, part))[0]()

        of.value = mean.value  # type: ignore[attr-defined]
        return of

    def quadrature(self, run: Any, pieces: Any) -> NDArray:
        """Return what the trapezoidal rule lacks in each interval, (frames - 1,), by cubics through the values of four frames."""
        run = run_of(type(self).__name__, run)
        evaluate = self._of(run)
        t, s, result = np.asarray(run.t, float), self._sizes(run, evaluate), np.zeros(max(0, len(run.t) - 1))
        mean = _Mean(t, s, self.p)
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
        return self._evaluator(guard(run.model, type(self).__name__), _span(run))

    def _sizes(self, run, evaluate):
        step = frames_at_once(run.q.shape[1])
        return np.concatenate([evaluate(Frames(run, slice(k, k + step)))[0]() for k in range(0, len(run.t), step)])


def _span(run):
    return float(np.ptp(run.t)) / max(1, len(run.t) - 1)


def rates(model: Any, function: Callable[[float], NDArray], t: NDArray, span: float) -> NDArray:
    """The derivative of a function of time at times t, (count, ...), by differences that end at the model's kinks; span: as in `_evaluator`.

    At a kink it is the mean of the derivatives on both sides.
    """
    wide = FRAMES_WIDE * (span or 1.0)

    def rate(at):
        kinks = model.kinks(at - wide, at + wide)
        sides = (beside(at, -1), beside(at, 1)) if at in kinks else (at,)
        return np.mean([along(lambda s, side=side: function(float(side + s)), wide, around(kinks, side)) for side in sides], axis=0)

    return np.array([rate(at) for at in t.tolist()])


class _Mean:
    """The mean of order p of sizes s (frames,) over times t, its slopes in s, `shares`, and in t at fixed s, `by_times`."""

    def __init__(self, t, s, p):
        t = np.asarray(t, float)
        steps = np.diff(t)
        length = float(t[-1] - t[0]) or 1.0
        weights = np.convolve(steps, [0.5, 0.5]) if len(steps) else np.ones(1)
        self.value = power_mean(weights / length, s, p)
        steep = relative(s, self.value) ** (p - 1.0)
        steep[np.abs(steep) < NOTHING * np.abs(steep).max()] = 0.0
        self.shares = weights / length * steep
        by_weights = s * steep
        turned = np.convolve(by_weights[:-1] + by_weights[1:], [-0.5, 0.5]) if len(steps) else np.zeros(1)
        if len(steps):
            turned[[0, -1]] += self.value, -self.value
        self.by_times = turned / (p * length)


def power_mean(weights: NDArray, s: NDArray, p: float) -> float:
    """`(sum weights s^p)^(1/p)`, weights of sum 1."""
    largest = float(np.abs(s).max())
    return largest * float(weights @ (s / largest) ** p) ** (1.0 / p) if largest else 0.0


def relative(s: NDArray, mean: float) -> NDArray:
    """s / mean, 0 where both are."""
    return s / mean if mean else np.zeros_like(s)


def power(part, p):
    """The order of a mean as a float. Raises InputError, in the name of `part`, unless it is a number of 1 or more."""
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

    def _evaluator(self, model, span):
        still = np.zeros(model.n)

        def load(t):
            return -model.force(t, still, still)

        def evaluate(frames):
            at = _sides(model, frames)
            f = np.array([load(t) for t in at.tolist()])

            def to_slopes(factor):
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
        if not callable(self.path):
            self._place(self.path)

    def named(self, model: Any) -> Deviation:
        """Return the objective with the name of its part, or of the body of its attachment."""
        body = named(model, self.point.body) if isinstance(self.point, Attachment) else None
        return replace(self, point=OnBody(body, self.point) if isinstance(body, str) else named(model, self.point))

    def _evaluator(self, model, span):
        point = self.point.on(model) if isinstance(self.point, OnBody) else self.point
        pull = _pull(model, point)

        def evaluate(frames):
            gap = model.position(point, frames.q) - [self._at(t) for t in frames.t.tolist()]

            def to_slopes(factor):
                toward = 2.0 * factor[:, None] * gap
                return Slopes(q=pull(frames.q, toward), t=lambda: -np.sum(toward * rates(model, self._at, frames.t, span), axis=1))

            return lambda: np.sum(gap**2, axis=1), to_slopes

        return evaluate

    def _at(self, t):
        advice = "; it must be a function of time"
        return self._place(call_user(f"Deviation: path({t:.6g})", self.path, t, advice=advice) if callable(self.path) else self.path)

    def _place(self, place):
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
