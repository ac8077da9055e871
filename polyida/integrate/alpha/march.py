"""Equal steps from the start of a run's piece to its end; one that fails is cut in two, four, ... parts."""

from polyida.errors import StepFailure
from polyida.integrate.alpha.start import started
from polyida.integrate.kinks import Grid, goes_on, grid_of
from polyida.integrate.rest import held
from polyida.integrate.state import State, Stretch


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
        if level == 0:
            try:
                for stretch in _whole(engine, settings, model, state, grid._replace(done=done)):
                    state, done = stretch.last, done + len(stretch)
                    counts.steps += len(stretch)
                    yield stretch
                return
            except StepFailure as failure:
                first = failure
                counts.rejected += 1
        here, failed = grid._replace(done=done), [first] if level == 0 else []
        state, level = _in_parts(engine, settings, model, state, here, max(1, level), failed, counts)
        done, level = done + 1, level - 1
        counts.steps += 1
        state = _cut(state, level, grid.after(done))
        yield Stretch.of(state)


def _whole(engine, settings, model, state, grid):
    ready = started(settings, model, state, grid.h)
    engine.begin(ready, grid.h)
    if goes_on(model, state, grid, "factored_at"):
        engine.recall(state.memory)
    yield from engine.run(grid)


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
