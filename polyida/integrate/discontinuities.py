"""Times at which steps must end: kinks of loads and motors, and fast changes of them that a step would miss.

The model lists its kinks: times at which a load, or the angle or path of a motor, is not smooth. No step crosses a kink. Between two kinks the
inputs are sampled before the steps are taken, because a pulse that begins and ends within one step has no effect on it.

Inputs that change too fast between two kinks are found in fast_inputs.py, by samples.

Order of the text: the run between kinks (`edges`, `pieces`), steps within a piece (`stop_times`, `number_of_steps`), times beside kinks, equal steps
(`Grid`), and the sampling of runs whose steps vary.
"""

from bisect import bisect_left
from heapq import merge
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from polyida.integrate.fast_inputs import PARTS, all_inputs, between_kinks
from polyida.model.differences import beside

SAME_TIME = 1e-12  # relative distance of times that is round-off
PULSE = 4  # least number of steps of a piece behind a kink whose inputs are not straight lines
INSIDE = (0.29, 0.5, 0.62)  # where these are sampled: a full sine is zero in the middle
CONSTANT = 1e-3  # rad, or of the scene's size: a motor or path that moves by less than STRAIGHT of it is constant
STRAIGHT = 1e-6  # relative distance from a straight line that is round-off
SAMPLES = 4096  # least number in a run whose integrator chooses its steps, of cells an eighth of the run


def round_off(t0, t_end):
    """Distance of times in a run from t0 to t_end that counts as round-off, s."""
    return SAME_TIME * max(abs(t0), abs(t_end), t_end - t0)


def edges(model, t0, t_end):
    """Yield t0, the model's kinks and samples, t_end, without those that are within round-off of an end, or samples of a kink or each other."""
    near, kinks = round_off(t0, t_end), model.kinks(t0, t_end)
    last = t0
    yield t0
    for t, is_sample in merge(((t, False) for t in kinks), ((t, True) for t in model.samples(t0, t_end))):
        if is_sample:
            kink = bisect_left(kinks, t - near)
            is_near = t - last <= near or (kink < len(kinks) and kinks[kink] <= t + near)
        if t0 + near < t < t_end - near and not (is_sample and is_near):
            yield t
            last = t
    yield t_end


def run_interval(state, t_end):
    """[begin, t_end], s, of the run that the state belongs to, from its memory; of a new run if that has another end.

    What is chosen once in a run, such as its `pieces`, stays the same when a stopped run is resumed.
    """
    begin, end = state.memory.get("run", (state.t, t_end))
    return np.array([begin if end == t_end and begin <= state.t else state.t, t_end], float)


def pieces(model, t0, t_end, h, samples=PARTS, now=-np.inf):
    """Yield (begin, end, largest step) from t0 to t_end, divided at kinks and where inputs change too fast for steps of h.

    samples: in a cell. now: pieces that end before this time are left out. Raises StepFailure at a jump of a motor.
    """
    for begin, end in pairwise(edges(model, t0, t_end)):
        for first, last, most in between_kinks(model, begin, end, h, samples, now) if end > now else ():
            if last > now:
                yield max(first, now), last, most


def stop_times(model, state, begin, end, h, samples):
    """Times in a piece between two kinks, the last its end, at which an integrator that chooses its steps must stop."""
    count = number_of_steps(model, state, begin, end, end - begin)
    yield from (begin + (end - begin) * k / count for k in range(1, count))
    for first, last, most in between_kinks(model, begin, end, h, samples) if count == 1 else ():
        parts = max(1, int(np.ceil((last - first) / most * (1 - 1e-9))))
        yield from (first + (last - first) * k / parts for k in range(1, parts))
        if last < end:
            yield last
    yield end


def number_of_steps(model, state, begin, end, h):
    """Number of equal steps, none above h, from begin, where the run is in `state`, to end.

    A single step evaluates inputs at its ends only and misses a pulse between two kinks that is zero at both. So a piece behind a kink has
    PULSE steps at least, unless its inputs are straight lines.
    """
    number = max(1, int(np.ceil((end - begin) / h * (1 - 1e-12))))
    if number >= PULSE or not at_kink(model, begin):
        return number
    curved = _is_curved(lambda t: model.force(t, state.q, state.v), begin, end)
    for profiles, least in (model.motor_profiles, CONSTANT), (model.path_profiles, CONSTANT * (model.extent or 1.0)):
        curved = curved or (len(profiles) and _is_curved(lambda t, at=profiles: model.drives(t)[at, 0], begin, end, least))
    return PULSE if curved else number


def _is_curved(function, begin, end, least=0.0):
    """True if a function of t deviates between begin and end from the chord through its ends by more than STRAIGHT of its size.

    Its values are arrays. It is sampled at the places INSIDE. The size is the largest entry of the values at the ends and of the sample, at
    least `least`.
    """
    near = 1e-9 * (end - begin)
    first, last = function(begin + near), function(end - near)
    for s in INSIDE:
        value = function(begin + s * (end - begin))
        size = max(np.abs(x).max(initial=least) for x in (first, value, last))
        if np.abs(value - (1 - s) * first - s * last).max(initial=0.0) > STRAIGHT * size:
            return True
    return False


def at_kink(model, t):
    """True if a load or motor has a kink at t."""
    near = 1e-12 * max(abs(t), 1e-300)
    return bool(model.kinks(t - near, t + near))


def inner_side(model, t, h):
    """t, or at a kink the time next to it: before it for a step of h > 0 that ends there, behind it for h < 0."""
    return beside(t, -h) if at_kink(model, t) else t


def time_limits(model, begin, end):
    """Bounds of the model's times in a piece: times inside it, beside its ends, at those that are kinks; infinite at others."""
    return beside(begin, 1) if at_kink(model, begin) else -np.inf, beside(end, -1) if at_kink(model, end) else np.inf


class Grid(NamedTuple):
    """`count` equal steps from begin to end, of which `done` are taken."""

    begin: float
    end: float
    count: int  # type: ignore[assignment]  # a tuple has a method of this name, which nobody uses here
    done: int = 0

    @property
    def h(self):
        """Length of each step, s: that of the grid over `count`."""
        return (self.end - self.begin) / self.count

    def time(self, k):
        """The time after k steps; exactly `end` after the last."""
        return self.begin + k * self.h if k < self.count else self.end

    def times(self, first, last):
        """Times of the grid after k steps, k = first .. last, (last - first + 1,); after `count` steps exactly `end`."""
        times = self.begin + np.arange(first, last + 1) * self.h
        times[self.count - first :] = self.end
        return times

    def after(self, done):
        """The grid after `done` steps, as the memory of a State has it."""
        return np.array([self.begin, self.end, self.count, done], float)


def grid_of(state, begin, end, count, name="grid"):
    """The grid in the state's memory, under a name, if the state is within it and it ends at `end`; a new one otherwise."""
    stored = state.memory.get(name)
    if stored is not None and np.shape(stored) == (4,):
        grid = Grid(float(stored[0]), float(stored[1]), int(stored[2]), int(stored[3]))
        if grid.end == end and 0 < grid.done < grid.count and grid.time(grid.done) == begin == state.t:
            return grid
    return Grid(begin, end, count)


def sampling(h, span):
    """(longest step, samples in a cell) for an integrator that chooses its steps up to h in a run of `span`, s."""
    h = min(h, span / PARTS)
    return h, max(PARTS, int(np.ceil(SAMPLES * (h / span))))


def unseen(model, h):
    """Message of loads that always change within less than two steps of h; empty if there are none."""
    fast = [
        f"{name!r} moves within {profile.shortest:.3g} s"
        for name, profile, _ in all_inputs(model)
        if profile.kinks == () and (profile.shortest or np.inf) < 2 * h
    ]
    return f"steps of {h:.3g} s do not show how {' and '.join(fast)}" if fast else ""
