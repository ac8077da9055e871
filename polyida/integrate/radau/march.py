"""Ways through the smooth pieces of a run: equal steps, or steps that follow the local error."""

import numpy as np

from polyida.integrate.kinks import PULSE, enough_steps
from polyida.integrate.radau.control import CUT, Ladder
from polyida.integrate.state import State, StepFailure
from polyida.integrate.stepping.grid import Grid, grid_of
from polyida.integrate.stepping.rest import held

FAILURES = 20  # in a row
SHORT = 16  # times that a step is apart, at least


def march(engine, settings, model, state, begin, end, most, counts):
    """Yield the states at the ends of equal steps; one that fails is taken in 2, 4, ... parts. Raises StepFailure."""
    grid = _grid(model, state, begin, end, most)
    for state in held(model, state, grid, counts):
        grid = grid._replace(done=grid.done + 1)
        state.memory.update(radau_grid=grid.after(grid.done), sizes=engine.sizes)
        counts.steps += 1
        yield state
    if "rest" in state.memory:  # what is known of steps before is not in it
        engine.begin(state)
    engine.expect(grid)
    while grid.done < grid.count:
        t = grid.time(grid.done + 1)
        try:
            state, _ = engine.step(state, grid.h, t)
        except StepFailure as failure:
            counts.rejected += 1
            state = _in_parts(engine, settings, state, grid, failure, counts)
        counts.steps += 1
        grid = grid._replace(done=grid.done + 1)
        state.memory.update(radau_grid=grid.after(grid.done), sizes=engine.sizes)
        yield state


def _grid(model, state, begin, end, most):
    """The Grid that the state is on, where it is one for steps of `most`; a new one otherwise."""
    stored = State(state.t, state.q, state.v, state.a, state.lam, {"grid": state.memory.get("radau_grid")})
    known = grid_of(stored, begin, end, 0)
    if known.count and known.h <= most * (1 + 1e-9) and (known.h > 0.5 * most or known.count <= PULSE):
        return known
    return Grid(begin, end, enough_steps(model, state, begin, end, most))


def _in_parts(engine, settings, state, grid, first, counts):
    """The state after the next step of the grid, in parts."""
    last = first
    for level in range(1, settings.max_halvings + 1):
        parts, found = Grid(grid.time(grid.done), grid.time(grid.done + 1), 2**level), state
        try:
            for k in range(parts.count):
                found, _ = engine.step(found, parts.h, parts.time(k + 1))
            return found
        except StepFailure as failure:
            counts.rejected += 1
            last = failure
    parts = f"; the step in 2 to {2**settings.max_halvings} parts fails too, at last: {last.reason}" if settings.max_halvings else ""
    raise StepFailure(first.status, first.reason + parts, first.t, **last.seen)


def adapt(engine, settings, model, state, begin, end, most, counts, ladder, most_steps):
    """Yield states from begin to end, the step as the local error allows and not above `most`. Raises StepFailure."""
    most, t, failures = _most(model, state, begin, end, most), begin, []
    while t < end:
        ladder.below(most)
        h, goes_to = _next(t, end, ladder.h, float(state.memory.get("step", ladder.h)))
        _require_progress(t, h, settings, counts, most_steps, failures)
        allowed = settings.allowed(state.q, engine.shares, engine.sizes)
        try:
            found, error = engine.step(state, h, goes_to, allowed)
        except StepFailure as failure:
            failures.append(failure)
            counts.rejected += 1
            ladder.below(h)
            ladder.rung -= CUT
            continue
        if found is None or h >= ladder.h * (1 - 1e-9):
            ladder.below(h)
            ladder.follow(error / allowed, settings.stages + 1)
        if found is None:
            counts.rejected += 1
            failures.append(StepFailure("step size", "the local error stays above rtol and atol", t))
            continue
        failures, t = [], goes_to
        state = found
        state.memory.update(ladder=np.array([ladder.first, ladder.rung]), radau_piece=np.array([end, most]), sizes=engine.sizes)
        counts.steps += 1
        yield state


def _most(model, state, begin, end, most):
    """The largest step of the piece, by which loads are seen behind a kink too; of one that is gone on with as it was."""
    piece = state.memory.get("radau_piece")
    if piece is not None and piece[0] == end and "stages_e" in state.memory and piece[1] <= most * (1 + 1e-9):
        return float(piece[1])
    return (end - begin) / enough_steps(model, state, begin, end, min(most, end - begin))


def _next(t, end, h, last):
    """(step, where it ends): the last two before the end are equal, and equal to one that there are factors for up to round-off of t."""
    rest = end - t
    for known in (h, min(h, last)):
        if abs(rest - known) <= 1e-9 * known:
            return known, end
    if rest < h:
        return rest, end
    return (0.5 * rest, t + 0.5 * rest) if rest < 2 * h * (1 - 1e-9) else (h, t + h)


def _require_progress(t, h, settings, counts, most_steps, failures):
    if failures and (h < SHORT * np.spacing(abs(t)) or len(failures) >= FAILURES):
        first, last = failures[0], failures[-1]
        reason = first.reason if last is first else f"{first.reason}; down to steps of {h:.3g} s, at last: {last.reason}"
        raise StepFailure(first.status, reason, first.t, **last.seen)
    if counts.steps + counts.rejected >= most_steps:
        raise StepFailure("too many steps", f"more than {settings.max_num_steps} steps (max_num_steps)", t, step=h)


def ladder_of(state, first):
    """The Ladder that the state was on, or one that begins with `first`, s."""
    stored = state.memory.get("ladder")
    return Ladder(first) if stored is None else Ladder(float(stored[0]), int(stored[1]))
