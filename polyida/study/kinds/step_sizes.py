"""Errors against the step: the order that an integrator shows on a motion, and where it ends."""

from collections.abc import Callable
from inspect import signature

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import floats, is_one_of
from polyida.keywords import named_keywords
from polyida.study.kinds.precision import Precision, against_reference
from polyida.study.kinds.work_precision import COLUMNS
from polyida.study.progress import teller
from polyida.study.subject import PARTS, members, subject


class StepSizes(Precision):
    """What `step_sizes` found: a row a run, the reference, orders, and errors against the step as a picture."""

    columns = {name: COLUMNS[name] for name in ("integrator", "setting")} | {"h": ("h, s", "{:.3g}")} | COLUMNS

    def __init__(self, name, rows, notes, reference):
        super().__init__(rows, notes, reference)
        self.title = f"errors against the step: {name}"

    def _length(self, row):
        return row["h"]

    def plot(self, part: str = "q", axes=None):
        """Draw the error in `part` ("q", "v", "lam") at the end against h, with lines of the fitted orders, rounded; returns the axes.

        Points below what is known of the reference are hollow. Raises InputError for another name.
        """
        from polyida.study.kinds.precision_plot import against_step

        if not is_one_of(part, PARTS):
            raise InputError(f"plot: part = {part!r} must be one of {', '.join(PARTS)}")
        return against_step(self, part, axes)

    def pictures(self) -> dict:
        """The errors in q, v and lam."""
        return {
            f"error-{part}": (f"Error in {part} at the end against the step.", lambda axes, part=part: self.plot(part, axes))
            for part in PARTS
        }


@named_keywords
def step_sizes(
    model: object,
    t_end: float | None = None,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrators: dict[str, Callable[[float], object]] | None = None,
    h: ArrayLike = (8e-3, 4e-3, 2e-3, 1e-3),
    reference: object = None,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> StepSizes:
    """Run every integrator with every step h, s, from (q0, v0) to t_end, and measure errors there, in q, v and lam.

    integrators: {label: class that takes `h=`, or function of h, that gives an integrator}; orders are over this h, also of one that chooses
    its steps by what the function makes of it. The rest is as `work_precision` takes it. Raises InputError
    before the first run.
    """
    given = subject("step_sizes", model, t_end, q0, v0)
    steps = floats(h)
    if steps is None or steps.ndim != 1 or not steps.size or not (steps > 0).all():
        raise InputError(f"step_sizes: h = {h!r} must be positive steps in s, at least one")
    known = members("step_sizes", given, _made(integrators, sorted(map(float, steps), reverse=True)))
    with teller("step_sizes", progress) as tell:
        rows, notes, reference = against_reference("step_sizes", given, known, reference, 1, tell)
    for row, step in zip(rows, np.tile(sorted(steps, reverse=True), len(known))):
        row["h"] = float(step)
    return StepSizes(given.name, rows, notes, reference)


def _made(integrators, steps):
    if not isinstance(integrators, dict):
        return integrators
    for label, make in integrators.items():
        if not callable(make):
            raise InputError(f"step_sizes: integrators[{label!r}] = {make!r} must be a class or a function of h")
    return {label: [_of_step(label, make, h) for h in steps] for label, make in integrators.items()}


def _of_step(label, make, h):
    told = f"step_sizes: integrators[{label!r}] = {getattr(make, '__name__', repr(make))} makes no integrator of a step h"
    if isinstance(make, type) and "h" not in signature(make).parameters:
        raise InputError(f"{told}: the class takes no h; give a function of h")
    try:
        return make(h=h) if isinstance(make, type) else make(h)
    except TypeError as error:
        raise InputError(f"{told}: {error}") from error
