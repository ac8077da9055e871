"""Inputs of a model, loads, motors and paths, that change too fast for one step between two kinks, found by samples.

A cell is the longest step, sampled at nine points or more. An input is too fast for one step if it deviates from its chord by CURVED of its
range in the next few cells, or if a motor turns by more than TURN: phi cannot distinguish angles that differ by a full turn, and Newton's
method fails beyond half a turn. Such a cell is divided into eight, and so on, down to 8^-DEPTH. Sampling finds what lasts as long as the
distance of the samples; profiles of the package declare their shortest duration and need no sampling.

`between_kinks` takes the inputs to sample and the cells that are too fast from `_fast_intervals`, which divides them by `_divided`.
"""

from typing import NamedTuple

import numpy as np

from polyida.errors import StepFailure
from polyida.profile import Profile

PARTS = 8  # parts of a cell that is too fast, and least number of its samples
DEPTH = 4  # divisions of a cell, at most
CURVED = 0.3  # of an input's range: deviation from its chord beyond which a cell is too fast
NOISE = 1e-6  # of an input's largest value: a smaller range is round-off
TURN = 1.5  # rad in a step
CONTINUOUS = 1e-6  # relative to the angle and 1 rad: a smaller jump at a kink is round-off
AHEAD = 5  # cells over which the range is taken that a deviation is compared with
CHUNK = 256  # cells that are sampled together


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


def all_inputs(model):
    """The Inputs of the model: all its profiles."""
    units = {k: "m" for k in model.path_profiles} | {k: "rad" for k in model.motor_profiles}
    return [Input(name, profile, units.get(k, "")) for k, (name, profile) in enumerate(model.named_profiles)]


def between_kinks(model, begin, end, h, samples, now=-np.inf):
    """Yield (begin, end, largest step) of the time between two kinks. Raises StepFailure at a jump that is not over by `now`."""
    inputs = [x for x in all_inputs(model) if x.unit or (not x.profile.formula and (x.profile.shortest or 0.0) < 4 * h)]
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
    """True for each cell of values (cells, samples) whose input x leaves its chord, or turns if it is an angle, by too much for one step."""
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
