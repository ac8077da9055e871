"""Work against precision: what each integrator costs at which error, on one motion."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import is_one_of, is_whole
from polyida.keywords import named_keywords
from polyida.study.kinds.precision import Precision, against_reference
from polyida.study.progress import teller
from polyida.study.subject import PARTS, members, subject

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
        from polyida.study.kinds.precision_plot import against_error

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


def cheapest(rows, error, level):
    """CPU seconds at which the lower envelope of runs reaches an error level, interpolated on logarithmic axes; NaN
    where none does.
    """
    pairs = sorted((row["cpu_s"], row[error]) for row in rows if np.isfinite(row.get(error) or np.nan) and row[error] > 0)
    before = None
    for cpu, found in pairs:
        if found <= level:
            if before is None:
                return cpu
            weight = np.log(before[1] / level) / np.log(before[1] / found)
            return float(np.exp((1 - weight) * np.log(before[0]) + weight * np.log(cpu)))
        if before is None or found < before[1]:
            before = (cpu, found)
    return float("nan")
