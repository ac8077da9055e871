"""Drift off the constraints over a run: how far phi and its time derivative are from zero."""

from collections.abc import Callable

from numpy.typing import ArrayLike

from polyida.keywords import named_keywords
from polyida.study.kinds.kept import Kept, kept
from polyida.study.progress import teller
from polyida.study.subject import members, subject


class Drift(Kept):
    """What `drift` found: a row a run, histories of both drifts."""

    title = "drift off the constraints"
    columns = {
        "integrator": ("integrator", "{}"),
        "setting": ("setting", "{}"),
        "drift": ("largest |phi|", "{:.1e}"),
        "velocity_drift": ("largest |phi'|", "{:.1e}"),
        "steps": ("steps", "{}"),
        "cpu_s": ("CPU s", "{:.3g}"),
        "status": ("status", "{}"),
    }
    quantities = {"drift": ("largest |phi|", True), "velocity_drift": ("largest |phi_q v + phi_t|", True)}

    @property
    def figures(self) -> dict[str, float]:
        """Both drifts of each integrator, by names such as "drift IDA"."""
        return {f"{name} {row['integrator']}": row[name] for row in self.rows for name in self.quantities}


@named_keywords
def drift(
    model: object,
    t_end: float | None = None,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrators: dict[str, object] | None = None,
    frames: int = 400,
    every: int = 1,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> Drift:
    """Run each of {label: integrator} to t_end and follow `max |phi|` and `max |phi_q v + phi_t|`, in phi's own units (m for joints).

    frames: points of each history, at most; rows have the largest of every `every`-th step. model, q0, v0, progress: as `work_precision`. Raises
    InputError before the first run.
    """
    given = subject("drift", model, t_end, q0, v0)
    known = members("drift", given, integrators, several=False)
    with teller("drift", progress) as tell:
        return Drift(given.name, *kept("drift", given, known, frames, every, _measure, tell))


def _measure(run, at):
    histories = {"drift": run.drift, "velocity_drift": run.velocity_drift}
    row = {name: float(values.max(initial=0.0)) for name, values in histories.items()}
    return row, {"t": run.t[at]} | {name: values[at] for name, values in histories.items()}
