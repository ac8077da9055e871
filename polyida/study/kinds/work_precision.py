"""Errors against what they cost, and against the step: the studies of integrators on one motion, with a reference."""

from collections.abc import Callable
from inspect import signature

import numpy as np
from numpy.typing import ArrayLike

from polyida.bar import teller
from polyida.errors import InputError
from polyida.given import is_one_of, is_whole
from polyida.keywords import named_keywords
from polyida.study.kinds.precision import Precision, against_error, against_reference, against_step
from polyida.study.subject import PARTS, members, steps_of, subject

WORK = {"cpu_s": "CPU seconds", "steps": "steps", "residuals": "residuals", "factorizations": "factorizations", "solves": "solves"}
COLUMNS = {
    "integrator": ("integrator", "{}"),
    "setting": ("setting", "{}"),
    "error_q": ("error in q", "{:.1e}"),
    "error_v": ("error in v", "{:.1e}"),
    "error_lam": ("error in lam", "{:.1e}"),
    "cpu_s": ("CPU s", "{:.3g}"),
    "steps": ("steps", "{}"),
    "residuals": ("residuals", "{}"),
    "factorizations": ("factorizations", "{}"),
    "status": ("status", "{}"),
}


class WorkPrecision(Precision):
    """What `work_precision` found: a row a run, the reference, orders, and error against cost as a picture."""

    columns = COLUMNS

    def __init__(self, name, rows, notes, reference):
        super().__init__(rows, notes, reference)
        self.title = f"work against precision: {name}"

    def plot(self, part: str = "q", axes=None, work: str = "cpu_s"):
        """Draw work against the error in `part` ("q", "v", "lam") at the end, a line an integrator; returns the axes.

        work: "cpu_s", "steps", "residuals", "factorizations" or "solves". Points whose error is below what is known of the reference
        are hollow and stand at that, in the grey: how far below they are nobody knows. Raises InputError for another name.
        """
        for name, value, known in (("part", part, PARTS), ("work", work, tuple(WORK))):
            if not is_one_of(value, known):
                raise InputError(f"plot: {name} = {value!r} must be one of {', '.join(known)}")
        return against_error(self, part, work, WORK[work], axes)

    def pictures(self) -> dict:
        """CPU time against the error in q, v and lam, and residuals against that in q."""
        drawn = {f"error-{part}": (f"CPU seconds against the error in {part} at the end.", part, "cpu_s") for part in PARTS}
        drawn["residuals"] = ("Evaluations of the residual against the error in q at the end.", "q", "residuals")
        return {
            name: (caption, lambda axes, part=part, work=work: self.plot(part, axes, work)) for name, (caption, part, work) in drawn.items()
        }


@named_keywords
def work_precision(
    model: object,
    t_end: float | None = None,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrators: dict[str, object] | None = None,
    reference: object = None,
    repeats: int = 1,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> WorkPrecision:
    """Run every setting of every integrator from (q0, v0) to t_end, one after the other, and measure errors there, in q, v and lam.

    model: a Model, a Scene, a Problem or the name of one, whose own start and end are taken where none are given. integrators:
    {label: [settings]}, a user's own too. reference: None: the digits of a published problem, or else what Radau IIA and a method of
    another family agree on, refined until they do to a tenth of the smallest error; or {"q", "v", "lam"} at t_end, a run or a state there.
    repeats: of each run; CPU seconds are their median. progress: function of (done, total, what), or True: a bar.

    Errors are the largest absolute deviations, in the units of q, v and lam. Runs are timed, so nothing else should go on meanwhile. A run
    that fails is a row with its status and message. Raises InputError before the first run.
    """
    given = subject("work_precision", model, t_end, q0, v0)
    known = members("work_precision", given, integrators)
    if not is_whole(repeats):
        raise InputError(f"work_precision: repeats = {repeats!r} must be a whole number of at least 1")
    with teller("work_precision", progress) as tell:
        return WorkPrecision(given.name, *against_reference("work_precision", given, known, reference, repeats, tell))


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

    integrators: {label: class that takes `h=`, or function of h, that gives an integrator}; orders are over this h, also of one that
    chooses its steps by what the function makes of it. The rest is as `work_precision` takes it. Raises InputError before the first run.
    """
    given = subject("step_sizes", model, t_end, q0, v0)
    steps = steps_of("step_sizes", h)
    known = members("step_sizes", given, _made(integrators, steps))
    with teller("step_sizes", progress) as tell:
        rows, notes, reference = against_reference("step_sizes", given, known, reference, 1, tell)
    for row, step in zip(rows, np.tile(steps, len(known))):
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
