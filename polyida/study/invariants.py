"""`energy` and `drift`: quantities that integrators should conserve over a run, a run for each integrator."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.progress import teller
from polyida.results.motion import unbalanced
from polyida.show.axes import finish
from polyida.show.styles import literal, marker_style, on_axes
from polyida.study.ivp import initial_value_problem, integrator_lists, settings_text
from polyida.study.result import Result
from polyida.validation import named_keywords, one_of, whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FLOOR = 1e-17  # zero on a logarithmic axis
RUN = {"integrator": ("integrator", "{}"), "setting": ("setting", "{}")}  # columns
COST = {"steps": ("steps", "{}"), "cpu_s": ("CPU s", "{:.3g}"), "status": ("status", "{}")}


class Invariants(Result):
    """Rows and histories of runs. quantities: {name of a history: (axis label, True for a logarithmic axis)}; the first is the default."""

    quantities: dict = {}

    def __init__(self, name, rows, notes, histories):
        """Take rows, notes and histories; `name`, of the problem, is added to the title."""
        super().__init__(rows, notes, histories)
        self.title = f"{self.title}: {name}"

    @named_keywords
    def plot(
        self, quantity: str | None = None, axes: Axes | None = None, title: str | None = None, labels: dict[str, str] | None = None
    ) -> Axes:
        """Draw the history of a quantity, a line for each integrator.

        Parameters
        ----------
        quantity : str, optional
            A key of `quantities`; default: the first one.
        axes : Axes, optional
            New pyplot axes if None.
        title : str, optional
            None: no title.
        labels : {label of an integrator: what the legend shows}, optional

        Returns
        -------
        axes : Axes

        Raises
        ------
        InputError
            For a quantity that no run has.
        """
        known = self._known()
        quantity = one_of("plot", "quantity", known[0] if quantity is None else quantity, known)
        label, logarithmic = self.quantities[quantity]
        failed = {row["integrator"] for row in self.rows if row.get("status", "done") not in ("done", "stopped")}
        with on_axes(axes) as axis:
            for i, (name, history) in enumerate(self.histories.items()):
                values = np.maximum(np.abs(history[quantity]), FLOOR) if logarithmic else history[quantity]
                every = max(1, len(values) // 12)  # about twelve markers, each line's at other frames
                markers = {"markevery": (i * every // len(self.histories), every), "markerfacecolor": "none"}
                axis.plot(history["t"], values, label=literal(name), **marker_style(i) | markers)
                if name in failed:
                    look = marker_style(i) | {"marker": "x", "linestyle": "none"}
                    axis.plot(history["t"][-1:], values[-1:], label=literal(f"{name}: failed"), **look)
            axis.set(xlabel="t, s", ylabel=label, yscale="log" if logarithmic else "linear")
            return finish(axis, title, labels)

    def pictures(self) -> dict:
        """A picture of the history of each quantity that some run has."""
        least = f", {FLOOR:g} if it is less"
        return {
            name.replace("_", "-"): (f"{label} against time{least if logarithmic else ''}.", partial(self.plot, name))
            for name, (label, logarithmic) in self.quantities.items()
            if name in self._known()
        }

    def _known(self):
        """Names of the quantities that have a finite value in at least one run."""
        return [name for name in self.quantities if any(np.isfinite(history[name]).any() for history in self.histories.values())]


def _run_all(result_class, measure, study, model, t_end, q0, v0, integrators, frames, every, progress):
    """The result of one run for each integrator; measure(run, frames) -> (row, history)."""
    ivp = initial_value_problem(study, model, t_end, q0, v0)
    lists = integrator_lists(study, ivp, integrators, several=False)
    whole(study, "frames", frames, 2)
    rows, notes, histories = [], [], {}
    with teller(study, progress) as report:
        for label, (integrator,) in lists.items():
            report(len(rows), len(lists), label)
            ivp.warm_up(integrator)
            run = ivp.run(integrator, every=every)
            indices = np.unique(np.linspace(0, len(run.t) - 1, min(frames, len(run.t))).astype(int))
            row, histories[label] = measure(run, indices)
            cost = {"steps": run.counts.steps, "cpu_s": float(run.cpu_seconds), "status": run.status, "message": run.message}
            settings = {"setting": settings_text(integrator, [], run.settings_used), "settings_used": run.settings_used}
            rows.append({"integrator": label} | settings | row | cost)
            notes += [] if run.success else [f"{label}: {run.message}"]
        report(len(lists), len(lists), "")
    return result_class(ivp.name, rows, notes, histories)


class EnergyKept(Invariants):
    """Result of `energy`: a row for each run, and histories of energies and momenta."""

    title = "energy over a run"
    columns = {
        **RUN,
        "energy_change": ("energy error at the end, J", "{:.2e}"),
        "energy_drift": ("largest energy error, J", "{:.2e}"),
        "relative_drift": ("relative to the kinetic energy", "{:.1e}"),
        "momentum_drift": ("momentum change, N s", "{:.1e}"),
        "angular_drift": ("angular momentum change, N m s", "{:.1e}"),
        **COST,
    }
    quantities = {
        "unbalanced": ("energy error, J", False),
        "total": ("total energy, J", False),
        "kinetic": ("kinetic energy, J", False),
        "strain": ("strain energy, J", False),
        "angular_momentum": ("angular momentum, N m s", False),
    }

    @property
    def figures(self) -> dict[str, float]:
        """The largest energy error relative to the range of the kinetic energy, with names such as "relative_drift alpha"."""
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
    """Run each integrator and measure its energy error: the change of energy less external work plus dissipation.

    Parameters
    ----------
    model, t_end, q0, v0
        As in `work_precision`.
    integrators : {label: integrator}
        One integrator for each label.
    frames : int
        Largest number of points of each history.
    every : int
        Rows hold the maximum over every `every`-th step.
    progress : callable or bool, optional
        As in `work_precision`.

    Returns
    -------
    result : EnergyKept
        The energy error is zero for the exact motion, and NaN if the model has no `potential`; `relative_drift` is relative to the range of
        the kinetic energy. The changes of momentum should vanish if no external force acts.

    Raises
    ------
    InputError
        For invalid arguments, before the first run.
    """
    kept = _run_all(EnergyKept, _energy_row, "energy", model, t_end, q0, v0, integrators, frames, every, progress)
    kept.notes += ["the model has no `potential`, and therefore no energy"] if "total" not in kept._known() else []  # noqa: SLF001
    return kept


def _energy_row(run, indices):
    """(row, history) of a run: {name: number} of the energy error and of the largest changes of momentum, and {name: array}.

    history: t and energies and angular momentum in the frames with these indices. NaN where the model does not define momentum.
    """
    energies, error = run.energy, unbalanced(run)
    size, drift = float(np.ptp(energies.kinetic)), float(np.abs(error).max())
    row = {"energy_change": float(error[-1]), "energy_drift": drift, "relative_drift": drift / size if size else np.nan}
    try:
        momentum, angular = run.momentum, run.angular_momentum
    except InputError:  # the model does not define them
        momentum, angular = np.full((len(run.t), 2), np.nan), np.full(len(run.t), np.nan)
    row |= {"momentum_drift": float(np.abs(momentum - momentum[0]).max()), "angular_drift": float(np.abs(angular - angular[0]).max())}
    histories = {"unbalanced": error} | {name: getattr(energies, name) for name in ("total", "kinetic", "strain")}
    return row, {"t": run.t[indices]} | {name: values[indices] for name, values in (histories | {"angular_momentum": angular}).items()}


class Drift(Invariants):
    """Result of `drift`: a row for each run, and histories of both violations."""

    title = "drift off the constraints"
    columns = {**RUN, "drift": ("largest |phi|", "{:.1e}"), "velocity_drift": ("largest |phi'|", "{:.1e}"), **COST}
    quantities = {"drift": ("max |φ|", True), "velocity_drift": ("max |dφ/dt|", True)}

    @property
    def figures(self) -> dict[str, float]:
        """Both violations of each integrator, with names such as "drift IDA"."""
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
    """Run each integrator and measure the largest constraint violations of its run, `max |phi|` and `max |phi_q v + phi_t|`.

    Parameters
    ----------
    model, t_end, q0, v0, integrators, frames, every, progress
        As in `pi.study.energy`.

    Returns
    -------
    result : Drift
        The violations are in the units of phi (m for joints).

    Raises
    ------
    InputError
        For invalid arguments, before the first run.
    """
    return _run_all(Drift, _drift_row, "drift", model, t_end, q0, v0, integrators, frames, every, progress)


def _drift_row(run, indices):
    """(row, history) of a run: the largest |phi| and |phi'| of all steps."""
    histories = {"drift": run.drift, "velocity_drift": run.velocity_drift}
    row = {name: float(values.max(initial=0.0)) for name, values in histories.items()}
    return row, {"t": run.t[indices]} | {name: values[indices] for name, values in histories.items()}
