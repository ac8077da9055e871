"""The times of steps: pieces of a run between the kinks of its loads and motors, which no step crosses, and equal steps within a piece."""

from typing import NamedTuple

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate import moves
from polyida.model.differences import beside

PULSE = 4  # steps in which a piece is taken at least where its loads are no straight lines
INSIDE = (0.29, 0.5, 0.62)  # where they are looked at, and not only in the middle, where a whole sine is zero too
STANDS = 1e-3  # rad, or of the scene's size: a motor or path that moves by less than STRAIGHT of it stands
STRAIGHT = 1e-6  # distance from a straight line, over the forces' size, that is none


def edges(model, t0, t_end):
    """[t0, the model's kinks, t_end]; kinks within round-off of an end are left out."""
    near = 1e-12 * max(abs(t0), abs(t_end), t_end - t0)
    return [t0, *(t for t in model.kinks(t0, t_end) if t0 + near < t < t_end - near), t_end]


def segments(model, t0, t_end):
    """[(begin, end)] from t0 to t_end, parted at its `edges`."""
    parts = edges(model, t0, t_end)
    return list(zip(parts[:-1], parts[1:]))


def run_of(state, t_end):
    """(begin, t_end) of the run that goes to t_end and goes on from the state, (2,), s: that in its memory, or a run that begins here.

    What is chosen once in a run, such as its `stretches`, is the same in a run that was stopped and goes on.
    """
    begin, end = state.memory.get("run", (state.t, t_end))
    return np.array([begin if end == t_end and begin <= state.t else state.t, t_end], float)


def stretches(model, t0, t_end, h, fine=moves.PARTS, now=-np.inf):
    """Yield (begin, end, largest step) from t0 to t_end: the segments, parted where loads and motors move too fast for h.

    now: the time that the run has come to: what is before it is left out. Raises StepFailure where a motor jumps.
    """
    for begin, end in segments(model, t0, t_end):
        if end > now:
            yield from _parts(model, begin, end, h, fine, now)


def stops(model, state, begin, end, h, fine):
    """Times of a segment, the last its end, at which to stop so that a move too fast for steps of h is seen."""
    parted = enough_steps(model, state, begin, end, end - begin)
    yield from (begin + (end - begin) * k / parted for k in range(1, parted))
    for first, last, most in _parts(model, begin, end, h, fine) if parted == 1 else ():
        count = max(1, int(np.ceil((last - first) / most * (1 - 1e-9))))
        yield from (first + (last - first) * k / count for k in range(1, count))
        if last < end:
            yield last
    yield end


def _parts(model, begin, end, h, fine, now=-np.inf):
    for part in moves.parts(model, begin, end, h, fine, now):
        if part.end <= now:
            continue
        if part.jump:
            raise StepFailure("jump", part.jump, part.begin)
        yield max(float(part.begin), now), float(part.end), float(part.most)


def enough_steps(model, state, begin, end, h):
    """Equal steps, none above h, for the piece from begin to end, at which the run is in `state`.

    A single step sees loads and motors at its ends only: a pulse between two kinks that begins and ends at zero would not
    be there. So behind a kink there are some more, unless loads and angles are straight lines.
    """
    number = max(1, int(np.ceil((end - begin) / h * (1 - 1e-12))))
    enough = number >= PULSE or not at_kink(model, begin) or not _bent(model, state, begin, end)
    return number if enough else PULSE


def at_kink(model, t):
    """Whether a load or motor has a kink at t."""
    near = 1e-12 * max(abs(t), 1e-300)
    return bool(model.kinks(t - near, t + near))


def inner_side(model, t, h):
    """t, or next to it where there is a kink: before it where a step of h > 0 ends there."""
    return beside(t, -h) if at_kink(model, t) else t


def _bent(model, state, begin, end):
    if _curved(lambda t: model.force(t, state.q, state.v), begin, end):
        return True
    driving = (model.motor_profiles, STANDS), (model.path_profiles, STANDS * (model.extent or 1.0))
    return any(len(k) and _curved(lambda t, k=k: model.drives(t)[k, 0], begin, end, least) for k, least in driving)


def _curved(function, begin, end, least=0.0):
    """Whether it bends away from its chord by STRAIGHT of its size, which is `least` at least."""
    near = 1e-9 * (end - begin)
    first, last = function(begin + near), function(end - near)
    for s in INSIDE:
        value = function(begin + s * (end - begin))
        size = max(np.abs(x).max(initial=least) for x in (first, value, last))
        if np.abs(value - (1 - s) * first - s * last).max(initial=0.0) > STRAIGHT * size:
            return True
    return False


class Grid(NamedTuple):
    """`count` equal steps from begin to end, of which `done` are taken."""

    begin: float
    end: float
    count: int  # type: ignore[assignment]  # a tuple has a method of this name, of no use here
    done: int = 0

    @property
    def h(self):
        """The step, s."""
        return (self.end - self.begin) / self.count

    def time(self, k):
        """The time after k steps; exactly `end` after the last."""
        return self.begin + k * self.h if k < self.count else self.end

    def times(self, first, last):
        """The times after `first` to `last` steps, (last - first + 1,)."""
        times = self.begin + np.arange(first, last + 1) * self.h
        times[self.count - first :] = self.end
        return times

    def after(self, done):
        """What a State's memory holds of the grid after `done` steps."""
        return np.array([self.begin, self.end, self.count, done], float)


def grid_of(state, begin, end, count):
    """The grid that the state's memory says it is on, in the middle of the way to the same end; a new one otherwise."""
    stored = state.memory.get("grid")
    if stored is not None and np.shape(stored) == (4,):
        grid = Grid(float(stored[0]), float(stored[1]), int(stored[2]), int(stored[3]))
        if grid.end == end and 0 < grid.done < grid.count and grid.time(grid.done) == begin == state.t:
            return grid
    return Grid(begin, end, count)


def goes_on(model, state, grid, key):
    """Whether Newton's memory in the state (it has `key`) is of use: the same h, and no kink here to start anew at."""
    near = 1e-12 * max(abs(state.t), abs(grid.end))
    same = key in state.memory and np.isclose(state.memory["h"], grid.h, rtol=1e-9, atol=0.0)
    return same and not model.kinks(state.t - near, state.t + near)
