"""The steps of a piece of a run: equal ones, those that are held to a local error, and equal ones extrapolated.

Equal steps that fail are cut in two, four, ... parts. Under error control h is piecewise constant, on a ladder, so that factors are kept and
restarts are few; the local error of each is as it was given, or its share of what a whole run may have.
"""

from dataclasses import dataclass, replace

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.alpha.start import started
from polyida.integrate.kinks import Grid, enough_steps, goes_on, grid_of
from polyida.integrate.moves import PARTS
from polyida.integrate.rest import held
from polyida.integrate.sizes import extent, sizes_of_run
from polyida.integrate.state import State, States, Stretch

ORDER = 3  # the local error is of that order in h
CAREFUL = 0.3  # of the first step that the motion's size and speed suggest
AIM = 5e-5  # rtol of a run where nothing was given: for an error of twice that
RUNGS = 4  # a factor of two
SAFETY = 0.85
CUT = 2 * RUNGS  # rungs down where Newton fails
LOWEST = 30 * RUNGS
PARTED = 0.03  # distance of the runs with h and h/2 over the extent of the model, beyond which they tell of different motions


def march(engine, settings, model, state, begin, end, count, counts):
    """Yield stretches of the states at the ends of `count` equal steps. Raises StepFailure where the smallest parts fail."""
    grid = grid_of(state, begin, end, count)
    for state in held(model, state, grid, counts):
        grid = grid._replace(done=grid.done + 1)
        state.memory["grid"] = grid.after(grid.done)
        counts.steps += 1
        yield Stretch.of(state)
    level, done = min(int(state.memory.get("cut", 0)), settings.max_halvings), grid.done
    while done < grid.count:
        failed = []
        if level == 0:
            try:
                engine.begin(started(settings, model, state, grid.h), grid.h)
                if goes_on(model, state, grid, "factored_at"):
                    engine.recall(state.memory)
                while done < grid.count:
                    stretch = engine.stretch(grid, done)
                    state, done = stretch.last, done + len(stretch)
                    counts.steps += len(stretch)
                    yield stretch
                return
            except StepFailure as failure:
                failed.append(failure)
                counts.rejected += 1
        state, level = _in_parts(engine, settings, model, state, grid._replace(done=done), max(1, level), failed, counts)
        done, level = done + 1, level - 1
        counts.steps += 1
        state = _cut(state, level, grid.after(done))
        yield Stretch.of(state)


def _in_parts(engine, settings, model, state, grid, level, seen, counts):
    """(state after the next step, level): taken in 2^level parts, or more where these fail.

    seen: failures so far.
    """
    t0, t1 = grid.time(grid.done), grid.time(grid.done + 1)
    for level in range(level, settings.max_halvings + 1):
        parts = Grid(t0, t1, 2**level)
        try:
            engine.begin(started(settings, model, _cut(state, level), parts.h), parts.h)
            return engine.aside(parts), level
        except StepFailure as failure:
            seen.append(failure)
            counts.rejected += 1
    raise _with_history(seen, settings.max_halvings)


def _cut(state, level, place=None):
    """A state from which the method starts with a_alg = q''."""
    memory = {"cut": float(level), "h": 0.0} if place is None else {"cut": float(level), "h": 0.0, "grid": place}
    return State(state.t, state.q, state.v, state.a, state.lam, memory)


def _with_history(seen, halvings):
    """The first failure, and what came of the step in parts."""
    first, last = seen[0], seen[-1]
    if last is first:
        return first
    parts = ", ".join(str(2**k) for k in range(1, halvings + 1))
    reason = f"{first.reason}; the step in {parts} parts fails too, at last: {last.reason}"
    return StepFailure(first.status, reason, first.t, **last.seen)


@dataclass(frozen=True)
class Control:
    """No step above `largest`, s; local errors of q below `atol + rtol |q|`, or below h/span of that.

    span: of the run, s, None where each step may have it all. first: the step to begin with, s. sizes: those of a run without h
    (integrate/sizes.py), from which it took these.
    """

    largest: float
    rtol: float
    atol: float
    first: float = np.inf
    span: float | None = None
    sizes: tuple = ()

    @property
    def order(self) -> int:
        """In h, of the local error over what is allowed."""
        return ORDER if self.span is None else ORDER - 1

    def allowed(self, h: float) -> tuple[float, float]:
        """(rtol, atol) of a step of h."""
        share = 1.0 if self.span is None else h / self.span
        return share * self.rtol, share * self.atol

    @property
    def before(self) -> float:
        """The weight of the step before in the change of q'' that the error is told from, beside 1 of the step itself.

        Modes far too fast for h change sign in every step, by -rho_inf: half the change over two steps sees next to nothing of them,
        and of a motion that is resolved the same as the change in one.
        """
        return 0.0 if self.span is None else 1.0

    @property
    def memory(self) -> dict:
        """What a state keeps of it, so that a run goes on with the same."""
        return {} if self.span is None else {"sizes": np.array(self.sizes)}


def over_run(settings, model, state, t_end):
    """The Control of a run from the state to t_end whose local errors add up to no more than atol + rtol |q|.

    What errors come of it `studies/defaults.py` measures: about their sum, and less where a motor drives all the time. It begins below the step that a motion bears that goes the model's length L within T:
    `|C| (h/T)^3 L = h/span (atol + rtol L)`.
    """
    length, _, span, ways = sizes = tuple(map(float, sizes_of_run(model, state, t_end)))
    rtol, atol = tolerances(settings.rtol, settings.atol, length)
    time = span / ways
    first = CAREFUL * time * np.sqrt((atol / length + rtol) * time / (abs(settings.coefficients.error) * span))
    return Control(span / PARTS, rtol, atol, min(first, span / PARTS), span, sizes)


def tolerances(rtol, atol, length):
    """(rtol, atol) of a run of a model of that length where these are given, or None."""
    rtol = AIM if rtol is None and atol is None else rtol or 0.0
    return rtol, rtol * length if atol is None else atol


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
            done = 0
            while done < grid.count and counts.steps + counts.rejected < most_steps and (stretch := engine.stretch(grid, done)):
                stretch = stretch.part(0, most_steps - counts.steps - counts.rejected)
                t, moved, done = stretch.last.t, True, done + len(stretch)
                counts.steps += len(stretch)
                yield stretch
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


def extrapolated(settings, model, state, t_end, counts):
    """Yield `x = (4 x(h/2) - x(h)) / 3` at the ends of steps of h (Richardson), of order 3 to 4. Raises StepFailure, also where the runs have parted.

    Two runs side by side, with h and h/2, none of which sees the other; phi = 0 and energy hold to the order of the result
    only. A kink that is hit exactly does no harm; ringing mesh modes, which no step resolves, gain nothing. Once the two runs
    have parted, on a motion that is sensitive to everything, there is nothing to extrapolate: the run stops there.
    """
    plain = replace(settings, extrapolate=False)
    coarse, fine = (States(plain.in_pieces(model, state, t_end, counts, split), counts) for split in (1, 2))
    for one in coarse:
        next(fine)
        two = next(fine)
        counts.steps -= 2
        apart = float(np.abs(two.q - one.q).max())
        if apart > PARTED * extent(model, two.q):
            reason = f"the runs with h and h/2 are {apart:.3g} apart in q; there is nothing to extrapolate: take a shorter h"
            raise StepFailure("extrapolation", reason, one.t, **{"|q(h) - q(h/2)|": apart})
        x = [(4 * b - a) / 3 for a, b in ((one.q, two.q), (one.v, two.v), (one.a, two.a), (one.lam, two.lam))]
        yield State(one.t, *x, restart=False)
