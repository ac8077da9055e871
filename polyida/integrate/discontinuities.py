"""Times at which steps must end: kinks of loads and motors, and fast changes of them that a step would miss.

The model lists its kinks: times at which a load, or the angle or path of a motor, is not smooth. No step crosses a kink. Between two kinks the
inputs are sampled before the steps are taken, because a pulse that begins and ends within one step has no effect on it.

A cell is the longest step, sampled at nine points or more. An input is too fast for one step if it deviates from its chord by CURVED of its
range in the next few cells, or if a motor turns by more than TURN: phi cannot distinguish angles that differ by a full turn, and Newton's
method fails beyond half a turn. Such a cell is divided into eight, and so on, down to 8^-DEPTH. Sampling finds what lasts as long as the
distance of the samples; profiles of the package declare their shortest duration and need no sampling.

Order of the text: the run between kinks (`edges`, `pieces`), steps within a piece (`stop_times`, `number_of_steps`), times beside kinks, equal steps
(`Grid`), and then the sampling: `_between_kinks` takes the inputs to sample and the cells that are too fast from `_fast_intervals`, which divides
them by `_divided`.
"""

from bisect import bisect_left
from heapq import merge
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from polyida.errors import StepFailure
from polyida.model.differences import beside
from polyida.profile import Profile

SAME_TIME = 1e-12  # relative distance of times that is round-off
PULSE = 4  # least number of steps of a piece behind a kink whose inputs are not straight lines
INSIDE = (0.29, 0.5, 0.62)  # where these are sampled: a full sine is zero in the middle
CONSTANT = 1e-3  # rad, or of the scene's size: a motor or path that moves by less than STRAIGHT of it is constant
STRAIGHT = 1e-6  # relative distance from a straight line that is round-off
PARTS = 8  # parts of a cell that is too fast, and least number of its samples
DEPTH = 4  # divisions of a cell, at most
CURVED = 0.3  # of an input's range: deviation from its chord beyond which a cell is too fast
NOISE = 1e-6  # of an input's largest value: a smaller range is round-off
TURN = 1.5  # rad in a step
CONTINUOUS = 1e-6  # relative to the angle and 1 rad: a smaller jump at a kink is round-off
AHEAD = 5  # cells over which the range is taken that a deviation is compared with
CHUNK = 256  # cells that are sampled together
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
        for first, last, most in _between_kinks(model, begin, end, h, samples, now) if end > now else ():
            if last > now:
                yield max(first, now), last, most


def stop_times(model, state, begin, end, h, samples):
    """Times in a piece between two kinks, the last its end, at which an integrator that chooses its steps must stop."""
    count = number_of_steps(model, state, begin, end, end - begin)
    yield from (begin + (end - begin) * k / count for k in range(1, count))
    for first, last, most in _between_kinks(model, begin, end, h, samples) if count == 1 else ():
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
    """True if a function of t deviates from its chord by STRAIGHT of its size, which is `least` or more."""
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
        """The step, s."""
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


class Input(NamedTuple):
    """A profile that is sampled. unit: "rad" for angles in phi, "m" for displacements in phi, empty for loads."""

    name: str
    profile: Profile
    unit: str


class Interval(NamedTuple):
    """A time interval whose steps are at most `most`, s; jump: message of a motor that no step can follow, or empty."""

    begin: float
    end: float
    most: float
    jump: str = ""


def sampling(h, span):
    """(longest step, samples in a cell) for an integrator that chooses its steps up to h in a run of `span`, s."""
    h = min(h, span / PARTS)
    return h, max(PARTS, int(np.ceil(SAMPLES * (h / span))))


def unseen(model, h):
    """Message of loads that always change within less than two steps of h; empty if there are none."""
    fast = [
        f"{name!r} moves within {profile.shortest:.3g} s"
        for name, profile, _ in _all_inputs(model)
        if profile.kinks == () and (profile.shortest or np.inf) < 2 * h
    ]
    return f"steps of {h:.3g} s do not show how {' and '.join(fast)}" if fast else ""


def _all_inputs(model):
    """The Inputs of the model: all its profiles."""
    units = {k: "m" for k in model.path_profiles} | {k: "rad" for k in model.motor_profiles}
    return [Input(name, profile, units.get(k, "")) for k, (name, profile) in enumerate(model.named_profiles)]


def _between_kinks(model, begin, end, h, samples, now=-np.inf):
    """Yield (begin, end, largest step) of the time between two kinks. Raises StepFailure at a jump that is not over by `now`."""
    inputs = [x for x in _all_inputs(model) if x.unit or (not x.profile.formula and (x.profile.shortest or 0.0) < 4 * h)]
    jump = _jump_at(model, inputs, end)
    if jump:
        end = max(begin, end - h)
    if end - begin <= h:  # `number_of_steps` samples the loads of a piece as short as that
        inputs = [x for x in inputs if x.unit]
    done = begin
    for fast in _merged(_fast_intervals(inputs, begin, end, h, samples, now)) if inputs else ():
        if fast.begin > done:
            yield done, fast.begin, np.inf
        if fast.jump and fast.end > now:
            raise StepFailure("jump", fast.jump, fast.begin)
        yield float(fast.begin), float(fast.end), float(fast.most)
        done = float(fast.end)
    if done < end:
        yield done, end, np.inf
    if jump:
        raise StepFailure("jump", jump, end)


def _jump_at(model, inputs, t):
    """Message of the first motor or path that jumps at a kink at t, or empty."""
    near = 4 * np.spacing(abs(t))
    if inputs and model.kinks(t - near, t + near):
        for x in inputs:
            sides = x.profile.over(np.array([t - near, t + near])) if x.unit else np.zeros(2)
            if abs(sides[1] - sides[0]) > CONTINUOUS * (1 + abs(sides[1])):
                return _jump_message(x, sides, t)
    return ""


def _fast_intervals(inputs, begin, end, h, samples, now):
    """Yield in order the Intervals of cells that are too fast for one step; cells end at multiples of h. Chunks that end before `now` are left out."""
    first, last = int(np.floor(begin / h + 1e-6)), int(np.ceil(end / h - 1e-6))
    passed = int(max(0.0, np.floor(now / h) - first - 1)) // CHUNK
    for k in range(first + passed * CHUNK, last, CHUNK):
        stop = min(k + CHUNK, last)
        ends = h * np.arange(k, min(stop + AHEAD, last) + 1)
        ends[0] = max(ends[0], begin) if k > first else begin
        ends[-1] = min(ends[-1], end) if stop < last else end
        near = max(1e-9 * h, 4 * np.spacing(max(abs(begin), abs(end))))
        inside = begin + near, end - near
        values = [x.profile.over(_sample_times(ends, samples, inside)) for x in inputs]
        ranges = [_range_ahead(each) for each in values]
        fast = np.any([_too_fast(*each) for each in zip(inputs, values, ranges)], axis=0)
        for i in np.flatnonzero(fast[: stop - k]):
            intervals = list(_divided(inputs, [each[i] for each in ranges], ends[i], ends[i + 1], samples, inside, DEPTH))
            jumps = [one.jump for one in intervals if one.jump]
            yield from [Interval(ends[i], ends[i + 1], np.inf, jumps[0])] if jumps else intervals


def _sample_times(ends, samples, inside):
    """The times (cells, samples + 1) at which cells are sampled, moved off the kinks at the ends."""
    return np.clip(ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(samples + 1) / samples), *inside)


def _range_ahead(values):
    """For each cell the range of values in it and the next few cells, or in the last few."""
    low, high = values.min(axis=1), values.max(axis=1)
    at = np.minimum(np.arange(len(values)), max(0, len(values) - AHEAD))
    window = np.minimum(at[:, None] + np.arange(AHEAD), len(values) - 1)
    return np.maximum(high[window].max(axis=1) - low[window].min(axis=1), NOISE * np.abs(values).max(initial=0.0))


def _too_fast(x, values, value_range):
    """True for each cell, values (cells, samples), that is too fast for one step."""
    at = np.linspace(0.0, 1.0, values.shape[1])
    chord = values[:, :1] + (values[:, -1:] - values[:, :1]) * at
    curved = np.abs(values - chord).max(axis=1) > CURVED * value_range
    return curved | (np.abs(np.diff(values)).sum(axis=1) > TURN) if x.unit == "rad" else curved


def _divided(inputs, ranges, begin, end, samples, inside, depth):
    """Yield the Intervals of a cell that is too fast for one step, each slow enough or of the least size."""
    ends, samples = np.linspace(begin, end, PARTS + 1), max(PARTS, samples // PARTS)
    values = [x.profile.over(_sample_times(ends, samples, inside)) for x in inputs]
    fast = [_too_fast(*each) for each in zip(inputs, values, ranges)]
    for i in range(PARTS):
        too_fast = [k for k in range(len(inputs)) if fast[k][i]]
        if too_fast and depth > 1:
            yield from _divided(inputs, ranges, ends[i], ends[i + 1], samples, inside, depth - 1)
        else:
            jumps = [_jump_message(inputs[k], values[k][i], ends[i + 1]) for k in too_fast if inputs[k].unit]
            yield Interval(ends[i], ends[i + 1], ends[i + 1] - ends[i], "; ".join(jumps))


def _jump_message(x, values, t):
    """Message of a motor or path with these values about the time t."""
    what, advice = "angle of motor" if x.unit == "rad" else "way of", "give it a move that takes time, like profile.quintic"
    return f"the {what} {x.name!r} jumps by {np.ptp(values):.3g} {x.unit} at t = {t:.6g} s: {advice}; the run stops"


def _merged(intervals):
    """Yield the intervals, neighbours of the same step as one."""
    last = None
    for one in intervals:
        if last and last.end == one.begin and not (last.jump or one.jump) and np.isclose(last.most, one.most, rtol=1e-6):
            last = last._replace(end=one.end)
            continue
        if last:
            yield last
        last = one
    if last:
        yield last
