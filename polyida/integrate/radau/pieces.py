"""Steps of Radau IIA in a smooth piece of a run: of equal size, or with a size by the local error.

`fixed_steps` takes a step that fails in 2, 4, ... parts; `adaptive_steps` goes on with shorter ones. Both take them by `Steps` (radau/steps.py).
"""

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.discontinuities import PULSE, Grid, grid_of, number_of_steps
from polyida.integrate.engine import step_in_parts, steps_at_rest, too_many_steps
from polyida.integrate.radau import loop
from polyida.integrate.radau.steps import new_control
from polyida.integrate.state import Stretch, first_of


def fixed_steps(engine, settings, model, state, begin, end, most, counts):
    """Yield stretches of the states at the ends of equal steps; a step that fails is repeated in 2, 4, ... parts. Raises StepFailure."""
    grid = _grid(model, state, begin, end, most)
    for state, grid in steps_at_rest(model, state, grid, counts):
        state.memory.update(radau_grid=grid.after(grid.done), **engine.run_memory)
        yield Stretch.of(state)
    if "rest" in state.memory:  # what is known of steps before is not in it
        engine.begin(state)
    while grid.done < grid.count:
        done = grid.done
        try:
            for states in engine.take_fixed(state, grid):
                done, state = done + len(states), states.last
                yield states
            return
        except StepFailure as failure:
            counts.rejected, grid = counts.rejected + 1, grid._replace(done=done)
            state = _step_in_parts(engine, settings, state, grid, failure, counts)
            counts.steps += 1
            grid = grid._replace(done=grid.done + 1)
            state.memory.update(radau_grid=grid.after(grid.done))
            yield Stretch.of(state)


def _grid(model, state, begin, end, most):
    """The stored Grid of the state if its steps suit `most`, else a new one."""
    known = grid_of(state, begin, end, 0, "radau_grid")
    if known.count and known.h <= most * (1 + 1e-9) and (known.h > 0.5 * most or known.count <= PULSE):
        return known
    return Grid(begin, end, number_of_steps(model, state, begin, end, most))


def _step_in_parts(engine, settings, state, grid, failure, counts):
    """The State after the next step of the grid, taken in parts because it failed. Raises StepFailure."""

    def take(parts, level):
        """The State at the end of the parts."""
        reached = state
        for k in range(parts.count):
            reached = engine.step(reached, parts.h, parts.time(k + 1))
        return reached

    return step_in_parts(take, grid, 1, settings.max_halvings, [failure], counts)[0]


def adaptive_steps(engine, settings, model, state, begin, end, most, counts, controller, most_steps):
    """Yield stretches of states from begin to end with error-controlled steps of at most `most`. Raises StepFailure.

    controller: [first step, level], updated.
    """
    first, most, failures = float(controller[0]), _largest_step(model, state, begin, end, most), []
    control = loop.Control(True, 0.0, first, most, end, float(most_steps), new_control(begin, controller[1]))
    now = control.now
    position_memory = lambda taken, k, level: {"ladder": np.array([first, level]), "radau_piece": np.array([end, most])}  # noqa: E731
    while state.t < end:
        try:
            for states in engine.take_adaptive(state, control, position_memory):
                failures, controller[1], state = [], now[loop.LEVEL], states.last
                yield states
        except StepFailure as failure:
            rejected = int(now[loop.FAILED]) - len(failures)
            failures += [StepFailure("step size", "the local error stays above rtol and atol", state.t)] * rejected
            if failure.status == "stuck":
                raise first_of(failures, f"down to steps of {now[loop.STEP]:.3g} s") from None
            if failure.status == "too many steps":
                raise too_many_steps(settings, state.t, float(now[loop.STEP])) from None
            failures.append(failure)
            counts.rejected += 1
            now[loop.FAILED] += 1
            now[loop.LEVEL] = loop.cut(first, now[loop.LEVEL], now[loop.STEP])


def _largest_step(model, state, begin, end, most):
    """The largest step of the piece, so that loads are sampled behind a kink too; of a continued piece the stored one."""
    piece = state.memory.get("radau_piece")
    if piece is not None and piece[0] == end and "stages_e" in state.memory and piece[1] <= most * (1 + 1e-9):
        return float(piece[1])
    return (end - begin) / number_of_steps(model, state, begin, end, min(most, end - begin))


def stored_controller(state, first):
    """[first step, level] of the state, or level 0 with `first`, s."""
    stored = state.memory.get("ladder")
    return [float(first), 0.0] if stored is None else [float(stored[0]), float(stored[1])]
