"""What integrators should keep over a run: energy, momentum and the constraints. A run each, its row and its histories."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.progress import teller
from polyida.results.motion import unbalanced
from polyida.show.style import on_axes, plain
from polyida.study.drawing import look
from polyida.study.result import Result
from polyida.study.subject import members, setting, subject
from polyida.validation import is_one_of, is_whole, named_keywords

FLOOR = 1e-17  # what is zero on a logarithmic axis


class Kept(Result):
    """Rows of whole runs, and the histories of what they should keep.

    quantities: {name of a history: (label of its axis, whether the axis is logarithmic)}, the first one the main picture.
    """

    quantities: dict = {}

    def __init__(self, name, rows, notes, histories):
        super().__init__(rows, notes, histories)
        self.title = f"{self.title}: {name}"

    def plot(self, quantity: str | None = None, axes=None):
        """Draw the history of a quantity, a line an integrator; returns the axes. Raises InputError for one that there is not."""
        known = self._there()
        quantity = known[0] if quantity is None else quantity
        if not is_one_of(quantity, known):
            raise InputError(f"plot: quantity = {quantity!r} must be one of {', '.join(known)}")
        label, logarithmic = self.quantities[quantity]
        with on_axes(axes) as axis:
            for i, (name, found) in enumerate(self.histories.items()):
                values = np.maximum(np.abs(found[quantity]), FLOOR) if logarithmic else found[quantity]
                every = max(1, len(values) // 12)  # a marker now and then, each line's at places of its own
                marks = {"markevery": (i * every // len(self.histories), every), "markerfacecolor": "none", "markersize": 4}
                axis.plot(found["t"], values, label=plain(name), **look(i) | marks)
            axis.set(xlabel="t, s", ylabel=label, title=plain(self.title), yscale="log" if logarithmic else "linear")
            axis.legend(loc="best")
            return axis

    def pictures(self) -> dict:
        """The history of each quantity."""
        return {
            name.replace("_", "-"): (f"{self.quantities[name][0]} against time.", lambda axes, name=name: self.plot(name, axes))
            for name in self._there()
        }

    def _there(self):
        """The quantities that some run has, not all of them NaN."""
        return [name for name in self.quantities if any(np.isfinite(found[name]).any() for found in self.histories.values())]


def kept(made, measure, study, model, t_end, q0, v0, integrators, frames, every, progress):
    """The Kept of class `made` from one run for each of the integrators; measure(run, frames) gives (row, history). The rest: as of `energy`."""
    given = subject(study, model, t_end, q0, v0)
    known = members(study, given, integrators, several=False)
    if not is_whole(frames, 2):
        raise InputError(f"{study}: frames = {frames!r} must be a whole number of at least 2")
    rows, notes, histories = [], [], {}
    with teller(study, progress) as tell:
        for label, (integrator,) in known.items():
            tell(len(rows), len(known), label)
            given.warm_up(integrator)
            run = given.run(integrator, every=every)
            row, histories[label] = measure(run, spread(run, frames))
            work = {"steps": run.counts.steps, "cpu_s": float(run.cpu_seconds), "status": run.status, "message": run.message}
            rows.append({"integrator": label, "setting": setting(integrator, [])} | row | work)
            notes += [] if run.success else [f"{label}: {run.message}"]
        tell(len(known), len(known), "")
    return made(given.name, rows, notes, histories)


def spread(run, frames):
    """Indices of at most so many frames of a run, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, len(run.t) - 1, min(frames, len(run.t))).astype(int))


class EnergyKept(Kept):
    """What `energy` found: a row a run, histories of energies and momenta."""

    title = "energy over a run"
    columns = {
        "integrator": ("integrator", "{}"),
        "setting": ("setting", "{}"),
        "energy_change": ("change at the end, J", "{:.2e}"),
        "energy_drift": ("largest change, J", "{:.2e}"),
        "relative_drift": ("of its size", "{:.1e}"),
        "momentum_drift": ("of momentum, N s", "{:.1e}"),
        "angular_drift": ("of angular momentum, N m s", "{:.1e}"),
        "steps": ("steps", "{}"),
        "cpu_s": ("CPU s", "{:.3g}"),
        "status": ("status", "{}"),
    }
    quantities = {
        "unbalanced": ("energy gained or lost beside all work, J", False),
        "total": ("total energy, J", False),
        "kinetic": ("kinetic energy, J", False),
        "strain": ("strain energy, J", False),
        "angular_momentum": ("angular momentum, N m s", False),
    }

    @property
    def figures(self) -> dict[str, float]:
        """The largest change relative to the energy's own size, by names such as "relative_drift alpha"."""
        return {f"relative_drift {row['integrator']}": row["relative_drift"] for row in self.rows}


@named_keywords
def energy(
    model: object,
    t_end: float | None = None,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrators: dict[str, object] | None = None,
    frames: int = 400,
    every: int = 1,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> EnergyKept:
    """Run each of {label: integrator} to t_end and follow the energy: its change less the work of motors and loads, more what is
    dissipated.

    It is zero for the exact motion, where the model states its potential; NaN where it does not. Its size is the range of the kinetic
    energy. Momenta, where the model says them, should stay where nothing outside acts: their drifts are the largest changes. frames: points
    of each history, at most; rows have the largest of every `every`-th step. model, q0, v0, progress: as `work_precision`. Raises
    InputError before the first run.
    """
    return kept(EnergyKept, _energies, "energy", model, t_end, q0, v0, integrators, frames, every, progress)


def _energies(run, at):
    found, change = run.energy, unbalanced(run)
    size = float(np.ptp(found.kinetic))
    drift = float(np.abs(change).max())
    row = {"energy_change": float(change[-1]), "energy_drift": drift, "relative_drift": drift / size if size else np.nan}
    momentum, angular = _momenta(run)
    row |= {"momentum_drift": float(np.abs(momentum - momentum[0]).max()), "angular_drift": float(np.abs(angular - angular[0]).max())}
    parts = {"unbalanced": change} | {name: getattr(found, name) for name in ("total", "kinetic", "strain")}
    return row, {"t": run.t[at]} | {name: values[at] for name, values in (parts | {"angular_momentum": angular}).items()}


def _momenta(run):
    """Momentum (frames, 2) and angular momentum (frames,); NaN where the model does not say them."""
    try:
        return run.momentum, run.angular_momentum
    except InputError:
        return np.full((len(run.t), 2), np.nan), np.full(len(run.t), np.nan)


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

    frames: points of each history, at most; rows have the largest of every `every`-th step. model, q0, v0, progress: as `work_precision`.
    Raises InputError before the first run.
    """
    return kept(Drift, _drifts, "drift", model, t_end, q0, v0, integrators, frames, every, progress)


def _drifts(run, at):
    histories = {"drift": run.drift, "velocity_drift": run.velocity_drift}
    row = {name: float(values.max(initial=0.0)) for name, values in histories.items()}
    return row, {"t": run.t[at]} | {name: values[at] for name, values in histories.items()}
