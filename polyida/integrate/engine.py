"""What methods with a grid of equal steps share: steps of a state at rest, the length of a stretch, a step in parts, a limit of steps.

Each method walks over `pieces` (discontinuities.py) in its own function, because what it begins anew behind a kink differs. In a piece it takes the
steps of a grid: those at rest first (`steps_at_rest`), then compiled stretches (`end_of_stretch`), and a step that fails again in 2, 4, ... parts
(`step_in_parts`). The energy-momentum method halves a step, and each half again, because its state is that of equal steps; nonsmooth methods
do not halve, because an impact does not disappear in shorter steps.
"""

from polyida.errors import StepFailure
from polyida.integrate.discontinuities import Grid
from polyida.integrate.sizes import states_at_rest
from polyida.integrate.state import first_of


def steps_at_rest(model, state, grid, counts):
    """Yield (the State at the end of a step, the grid behind it) as long as `state` stays at rest; each is counted as a step."""
    for at_rest in states_at_rest(model, state, grid, counts):
        grid = grid._replace(done=grid.done + 1)
        counts.steps += 1
        yield at_rest, grid


def end_of_stretch(grid, done, most, to_pause):
    """Number of steps of a grid after a stretch of at most `most` steps that begins after `done`; to_pause: steps to a pause, or none if not positive."""
    return min(done + (to_pause if 0 < to_pause < most else most), grid.count)


def step_in_parts(take, grid, first, last, failures, counts):
    """(the State after the next step of a grid, taken in 2^level equal parts, the level): the first level that succeeds. Raises StepFailure.

    take: function (Grid of the parts, level) that returns the state at their end. first, last: levels that are tried. failures: of this step so
    far, the first of which is raised if all levels fail.
    """
    for level in range(first, last + 1):
        parts = Grid(grid.time(grid.done), grid.time(grid.done + 1), 2**level)
        try:
            return take(parts, level), level
        except StepFailure as failure:
            failures.append(failure)
            counts.rejected += 1
    raise first_of(failures, f"the step in 2 to {2**last} parts fails too")


def too_many_steps(settings, t, h):
    """The StepFailure at t of a run that reaches settings.max_num_steps; h: the next step, s."""
    return StepFailure("too many steps", f"more than {settings.max_num_steps} steps (max_num_steps)", t, step=h)
