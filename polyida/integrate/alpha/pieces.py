"""Steps of generalized-alpha in a smooth piece of a run: of equal size, or with h by the local error; and extrapolation over a run.

`fixed_steps` takes a step that fails in 2, 4, ... parts, `adaptive_steps` changes h by the local error; both begin with the steps of a state at
rest, and take the others by `Steps` (alpha/steps.py). `extrapolated` combines two runs with fixed steps.
"""

import math
from dataclasses import replace

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.alpha.start import started
from polyida.integrate.alpha.step_size import CUT, LAST_LEVEL, StepSizeController
from polyida.integrate.alpha.steps import LONGER, SHORTER
from polyida.integrate.discontinuities import Grid, grid_of, number_of_steps
from polyida.integrate.engine import step_in_parts, steps_at_rest, too_many_steps
from polyida.integrate.sizes import extent, states_at_rest
from polyida.integrate.state import State, States, Stretch, first_of

SAME_H = 1e-9  # relative difference of steps that is round-off
DIVERGED = 0.03  # of the model's extent: distance of the runs with h and h/2 beyond which they are different motions


def fixed_steps(engine, state, begin, end, count):
    """Yield stretches of the states at the ends of `count` equal steps; a step that fails is taken in 2, 4, ... parts. Raises StepFailure."""
    settings, model, counts = engine.settings, engine.model, engine.counts
    grid = grid_of(state, begin, end, count)
    for state, grid in steps_at_rest(model, state, grid, counts):
        state.memory["grid"] = grid.after(grid.done)
        yield Stretch.of(state)
    level, done = min(int(state.memory.get("cut", 0)), settings.max_halvings), grid.done
    while done < grid.count:
        failures = []
        if level == 0:
            try:
                _begin_grid(engine, state, grid)
                while done < grid.count:
                    stretch = engine.stretch(grid, done)
                    state, done = stretch.last, done + len(stretch)
                    counts.steps += len(stretch)
                    yield stretch
                return
            except StepFailure as failure:
                failures.append(failure)
                counts.rejected += 1
        state, level = _step_in_parts(engine, state, grid._replace(done=done), level, failures)
        done, level = done + 1, level - 1
        counts.steps += 1
        state = _cut(state, level, grid=grid.after(done))
        yield Stretch.of(state)


def _begin_grid(engine, state, grid):
    """Begin steps of a grid; from a state behind a step of the same h with the factor and the memory of Newton's method that it had."""
    model, memory = engine.model, state.memory
    near = 1e-12 * max(abs(state.t), abs(grid.end))
    same_h = math.isclose(memory.get("h", 0.0), grid.h, rel_tol=SAME_H)
    goes_on = "factored_at" in memory and same_h and not model.kinks(state.t - near, state.t + near)
    if goes_on:
        engine.restore_factor(memory)
    engine.begin(started(engine.settings, model, state, grid.h, engine.system if goes_on else None), grid.h, goes_on)
    if goes_on:
        engine.recall(memory)


def _step_in_parts(engine, state, grid, level, failures):
    """(the State after the next step of a grid, taken in 2^level parts, the level); the levels begin with that of the step before."""
    settings = engine.settings

    def take(parts, level):
        """The State at the end of the parts of one level."""
        engine.begin(started(settings, engine.model, _cut(state, level), parts.h), parts.h)
        return engine.last_of(parts)

    return step_in_parts(take, grid, max(1, level), settings.max_halvings, failures, engine.counts)


def _cut(state, level, **memory):
    """A state from which the method starts with a_alg = q''."""
    return State(state.t, state.q, state.v, state.a, state.lam, {"cut": float(level), "h": 0.0} | memory)


def adaptive_steps(engine, state, begin, end, longest, most_steps):
    """Yield stretches of states from begin to end, with h as the local error allows, but no step above `longest`.

    Raises StepFailure below the lowest level, if h is round-off of t, and if the steps counted and rejected would be more than most_steps.
    """
    settings, model, counts, control = engine.settings, engine.model, engine.counts, engine.control
    most, t, failures = (end - begin) / number_of_steps(model, state, begin, end, longest), begin, []
    controller = StepSizeController(control, float(state.memory.get("h", control.first)) or np.inf, most, longest)

    def require_progress(h):
        """Raise StepFailure if there are too many steps, or if h is round-off of t."""
        if counts.steps + counts.rejected >= most_steps:
            raise too_many_steps(settings, t, h)
        if h < 16 * np.spacing(abs(t)):
            raise StepFailure("step too small", "the step has shrunk to the round-off of t", t, step=h)

    for state in states_at_rest(model, state, Grid(t, end, max(1, int(np.ceil((end - t) / most * (1 - 1e-12))))), counts):
        require_progress(state.t - t)
        t = state.t
        counts.steps += 1
        state.memory.update({"sizes": np.array(control.sizes)} if control.sizes else {})
        yield Stretch.of(state)
    while t < end:
        grid, moved = _next_grid(t, end, controller.h), False
        require_progress(grid.h)
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
        _change_level(engine, controller, failures, t)
        state = engine.state(t) if moved else state  # not the state that `started` returned: that is behind a kink already


def _next_grid(t, end, h):
    """The Grid of the next steps of h; the last few up to `end` are equal."""
    remaining = (end - t) / h
    if remaining <= 3:
        return Grid(t, end, max(1, int(np.ceil(remaining - 1e-9))))
    count = int(remaining) - 1
    return Grid(t, t + count * h, count)


def _change_level(engine, controller, failures, t):
    """Change the level of h after an attempt that came to t, by its failures and those before, and by its local error. Raises StepFailure."""
    if failures:
        _require_level(controller, CUT, failures)
        controller.level += CUT
    if failures or engine.wanted_step == SHORTER:
        engine.counts.rejected += 1
    if engine.wanted_step == SHORTER:
        controller.reduce(engine.error)
        _require_level(controller, 0, [StepFailure("step size", "the local error stays above rtol and atol", t)])
    elif engine.wanted_step == LONGER:
        controller.raise_step(engine.error)


def _require_level(controller, down, failures):
    """Raise the first of the failures if the level may not go down by so much."""
    if controller.level + down > LAST_LEVEL:
        raise first_of(failures, f"down to steps of {controller.h:.3g} s")


def extrapolated(settings, model, state, t_end, counts):
    """Yield `x = (4 x(h/2) - x(h)) / 3` at the ends of steps of h (Richardson), of order 3 to 4. Raises StepFailure, also if the runs diverge.

    The runs with h and h/2 are independent. phi = 0 and energy hold to the order of the result only. A kink at the end of a step does no harm;
    mesh modes that no step resolves gain nothing. Once the runs are different motions there is nothing to extrapolate, and the run stops.
    """
    plain = replace(settings, extrapolate=False)
    coarse, fine = (States(plain.in_pieces(model, state, t_end, counts, split), counts) for split in (1, 2))
    for one in coarse:
        next(fine)
        two = next(fine)
        counts.steps -= 2
        distance = float(np.abs(two.q - one.q).max())
        if distance > DIVERGED * extent(model, two.q):
            reason = f"the runs with h and h/2 are {distance:.3g} apart in q; there is nothing to extrapolate: take a shorter h"
            raise StepFailure("extrapolation", reason, one.t, **{"|q(h) - q(h/2)|": distance})
        x = [(4 * b - a) / 3 for a, b in ((one.q, two.q), (one.v, two.v), (one.a, two.a), (one.lam, two.lam))]
        yield State(one.t, *x, restart=False)
