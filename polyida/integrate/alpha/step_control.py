"""Error-controlled steps: h is piecewise constant, on a ladder, so that factors are kept and restarts are few."""

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.alpha.control import ORDER
from polyida.integrate.alpha.start import started
from polyida.integrate.kinks import Grid, enough_steps
from polyida.integrate.rest import held
from polyida.integrate.state import Stretch

RUNGS = 4  # a factor of two
SAFETY = 0.85
CUT = 2 * RUNGS  # rungs down where Newton fails
LOWEST = 30 * RUNGS


class Ladder:
    """The rung of the step: 0 is the largest, each one down a factor 2^(1/4). It begins at h, or near `most` below it.

    order: of the error in h.
    """

    def __init__(self, largest, h=None, most=np.inf, order=ORDER):
        self.largest, self.order, first = largest, order, min(h or np.inf, most, largest)
        self.rung = int(np.clip(round(RUNGS * np.log2(largest / first)), 0, LOWEST))

    @property
    def h(self):
        """The step, s."""
        return self.largest * 2.0 ** (-self.rung / RUNGS)

    def down(self, error):
        """To where the error is expected to be allowed; at least one rung."""
        self.rung += max(1, int(np.ceil(-self._rungs(error))) if np.isfinite(error) else CUT)

    def up(self, error):
        """To where the error is expected to be allowed, at most twice the step. False where that is no change."""
        before = self.rung
        self.rung = max(0, self.rung - min(RUNGS, int(np.floor(self._rungs(error)))))
        return self.rung < before

    def _rungs(self, error):
        return RUNGS * np.log2(SAFETY * max(error, 1e-12) ** (-1 / self.order))


def calm_error(h, largest, rungs=2, order=ORDER):
    """The error below which the step h may grow by so many rungs; 0 where it is the largest."""
    return (SAFETY / 2.0 ** (rungs / RUNGS)) ** order if h < 0.99 * largest else 0.0


def adapt(engine, settings, model, state, begin, end, largest, counts, most_steps):
    """Yield stretches of states from begin to end, h as the local error allows, but no step above `largest`.

    Raises StepFailure below the lowest rung, where h is round-off of t, and where the steps counted, with those
    rejected, would be more than most_steps.
    """
    most = (end - begin) / enough_steps(model, state, begin, end, largest)
    control, t, failures = engine.control, begin, []
    ladder = Ladder(control.largest, float(state.memory.get("h", control.first)), most, control.order)
    lowest = 0 if largest == control.largest else int(np.ceil(RUNGS * np.log2(control.largest / largest) - 1e-9))
    for state in held(model, state, Grid(t, end, max(1, int(np.ceil((end - t) / most * (1 - 1e-12))))), counts):
        _require_progress(t, state.t - t, settings, counts, most_steps)
        t = state.t
        counts.steps += 1
        state.memory.update(control.memory)
        yield Stretch.of(state)
    while t < end:
        grid, moved = _piece(t, end, ladder.h), False
        _require_progress(t, grid.h, settings, counts, most_steps)
        try:
            engine.begin(started(settings, model, state, grid.h), grid.h)
            for stretch in engine.run(grid):
                stretch = stretch.part(0, most_steps - counts.steps - counts.rejected)
                t, moved = stretch.last.t, True
                counts.steps += len(stretch)
                yield stretch
                if counts.steps + counts.rejected >= most_steps:
                    break
            failures = []
        except StepFailure as failure:
            failures.append(failure)
            _require_room(ladder, CUT, failures)
            ladder.rung += CUT
        if failures or engine.verdict == "far":
            counts.rejected += 1
        if engine.verdict == "far":
            ladder.down(engine.error)
            _require_room(ladder, 0, [StepFailure("step size", "the local error stays above rtol and atol", t)])
        elif engine.verdict == "near":
            ladder.up(engine.error)
            ladder.rung = max(ladder.rung, lowest)
        state = engine.state(t) if moved else state  # not what the method started from: that is behind a kink already


def _piece(t, end, h):
    """Steps of h up to near the end, or the last few, of equal size, which end there."""
    rest = (end - t) / h
    if rest <= 3:
        return Grid(t, end, max(1, int(np.ceil(rest - 1e-9))))
    count = int(rest) - 1
    return Grid(t, t + count * h, count)


def _require_progress(t, h, settings, counts, most_steps):
    if counts.steps + counts.rejected >= most_steps:
        raise StepFailure("too many steps", f"more than {settings.max_num_steps} steps (max_num_steps)", t, step=h)
    if h < 16 * np.spacing(abs(t)):
        raise StepFailure("step too small", "the step has shrunk to the round-off of t", t, step=h)


def _require_room(ladder, down, failures):
    if ladder.rung + down > LOWEST:
        first, last = failures[0], failures[-1]
        reason = f"{first.reason}; down to steps of {ladder.h:.3g} s, at last: {last.reason}"
        raise StepFailure(first.status, reason, first.t, **last.seen)
