"""Ways through the smooth pieces of a run: equal steps, or steps that follow the local error."""

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.kinks import PULSE, Grid, enough_steps, grid_of
from polyida.integrate.radau.control import cut
from polyida.integrate.radau.loop import FAILED, RUNG, STEP, Control
from polyida.integrate.radau.steps import at
from polyida.integrate.rest import held
from polyida.integrate.state import State


def march(engine, settings, model, state, begin, end, most, counts):
    """Yield the states at the ends of equal steps; one that fails is taken in 2, 4, ... parts. Raises StepFailure."""
    grid = _grid(model, state, begin, end, most)
    for state in held(model, state, grid, counts):
        grid = grid._replace(done=grid.done + 1)
        state.memory.update(radau_grid=grid.after(grid.done), **engine.of_run)
        counts.steps += 1
        yield state
    if "rest" in state.memory:  # what is known of steps before is not in it
        engine.begin(state)
    while grid.done < grid.count:
        done = grid.done
        try:
            for state in engine.equal(state, grid):
                done += 1
                yield state
            return
        except StepFailure as failure:
            counts.rejected, grid = counts.rejected + 1, grid._replace(done=done)
            state = _in_parts(engine, settings, state, grid, failure, counts)
            counts.steps += 1
            grid = grid._replace(done=grid.done + 1)
            state.memory.update(radau_grid=grid.after(grid.done))
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
                found = engine.step(found, parts.h, parts.time(k + 1))
            return found
        except StepFailure as failure:
            counts.rejected += 1
            last = failure
    parts = f"; the step in 2 to {2**settings.max_halvings} parts fails too, at last: {last.reason}" if settings.max_halvings else ""
    raise StepFailure(first.status, first.reason + parts, first.t, **last.seen)


def adapt(engine, settings, model, state, begin, end, most, counts, ladder, most_steps):
    """Yield states from begin to end, the step as the local error allows and not above `most`. Raises StepFailure.

    ladder: [first step, rung].
    """
    first, most, failures = float(ladder[0]), _most(model, state, begin, end, most), []
    control = Control(True, 0.0, first, most, end, float(most_steps), at(begin, ladder[1]))
    now = control.now
    place = lambda taken, k, rung: {"ladder": np.array([first, rung]), "radau_piece": np.array([end, most])}  # noqa: E731
    while state.t < end:
        try:
            for state in engine.adaptive(state, control, place):
                failures, ladder[1] = [], now[RUNG]
                yield state
        except StepFailure as failure:
            rejected = int(now[FAILED]) - len(failures)
            failures += [StepFailure("step size", "the local error stays above rtol and atol", state.t)] * rejected
            if failure.status == "stuck":
                raise _with_history(failures, now[STEP]) from None
            if failure.status == "too many steps":
                reason = f"more than {settings.max_num_steps} steps (max_num_steps)"
                raise StepFailure(failure.status, reason, state.t, step=float(now[STEP])) from None
            failures.append(failure)
            counts.rejected += 1
            now[FAILED] += 1
            now[RUNG] = cut(first, now[RUNG], now[STEP])


def _with_history(failures, h):
    """The first failure, and what came of it."""
    first, last = failures[0], failures[-1]
    reason = first.reason if last is first else f"{first.reason}; down to steps of {h:.3g} s, at last: {last.reason}"
    return StepFailure(first.status, reason, first.t, **last.seen)


def _most(model, state, begin, end, most):
    """The largest step of the piece, by which loads are seen behind a kink too; of one that is gone on with as it was."""
    piece = state.memory.get("radau_piece")
    if piece is not None and piece[0] == end and "stages_e" in state.memory and piece[1] <= most * (1 + 1e-9):
        return float(piece[1])
    return (end - begin) / enough_steps(model, state, begin, end, min(most, end - begin))


def ladder_of(state, first):
    """[first step, rung] that the state was on, or one that begins with `first`, s."""
    stored = state.memory.get("ladder")
    return [float(first), 0.0] if stored is None else [float(stored[0]), float(stored[1])]
