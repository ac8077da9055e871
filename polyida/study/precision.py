"""`work_precision` and `step_sizes`: errors of integrators against their cost and against the step, relative to one reference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from inspect import signature
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida.adjoint.error_bars import error_of
from polyida.errors import InputError, StepFailure
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.state import declared
from polyida.objective.objective import Objective, require_objective
from polyida.progress import teller
from polyida.show.axes import finish
from polyida.show.styles import INK, literal, marker_style, on_axes
from polyida.study.ivp import initial_value_problem, integrator_lists, kind_of, settings_text, step_list
from polyida.study.kept import KeptEnds, require_folder
from polyida.study.plotting import slope_line
from polyida.study.quantity import WORDS, quantity_of
from polyida.study.references import distance, end_of
from polyida.study.refinement import make_reference, user_reference
from polyida.study.result import Result
from polyida.study.rows import NAN, fit_slope
from polyida.validation import named_keywords, one_of, whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COUNTS = ("steps", "rejected", "newton_iterations", "residuals", "tangents", "factorizations", "solves")
FINER = 1.5  # ratio of steps of two runs whose ends are compared
STAGNATION = 10.0  # runs stagnate if their distance to the reference is this multiple of their mutual distance and of the accuracy
ASYMPTOTIC = 0.3  # largest difference of the slopes of two halves of the errors that have an order; a slope below it is none
FITTED = 10.0  # times the accuracy of the reference: smaller errors are not used to fit an order
UNRESOLVED = "#88888822"  # colour of the errors below the accuracy of the reference
SYMBOLS = {"lam": "λ"}  # of parts whose name is no symbol
WORK = {"cpu_s": "CPU time, s", "steps": "steps", "residuals": "residuals", "factorizations": "factorizations", "solves": "solves"}
COLUMNS = {
    "integrator": ("integrator", "{}"),
    "setting": ("setting", "{}"),
    "error_q": ("error in q", "{:.1e}"),
    "error_v": ("error in v", "{:.1e}"),
    "error_lam": ("error in lam", "{:.1e}"),
    "error_x": ("error in x", "{:.1e}"),  # of models with first-order states
    "error_J": ("error in J", "{:.1e}"),  # with an objective
    "estimated_J": ("error in J, estimated", "{:.1e}"),
    "cpu_s": ("CPU s", "{:.3g}"),
    "steps": ("steps", "{}"),
    "residuals": ("residuals", "{}"),
    "factorizations": ("factorizations", "{}"),
    "status": ("status", "{}"),
}


def errors_of(ivp, run, reference):
    """{part: largest absolute error at the end, or that of ivp.quantity in its norm}.

    NaN if the run failed, if there is no reference, or if the part is empty.
    """
    errors = dict.fromkeys(ivp.parts, NAN)
    if not run.success:
        return errors
    known = {part: reference[part] for part in ivp.parts if np.size(reference.get(part, ()))}
    return errors | (ivp.quantity.errors(run, known) if ivp.quantity else distance(known, end_of(run)))


def unresolved_pulse_notes(reference):
    """A note on the time resolution of the reference, if the model has forces without announced discontinuities."""
    if "sampling" not in reference:
        return []
    return [
        f"the reference can miss a force that acts for less than {reference['sampling']:.1e} s, unless the model declares it (kinks); "
        "known_to does not contain that"
    ]


def stagnation_notes(rows, runs, reference):
    """Notes on integrators whose end does not change with finer steps and yet differs from the reference. rows: with their errors."""
    notes = []
    for label in dict.fromkeys(row["integrator"] for row in rows):
        pairs = [(row, run) for row, run in zip(rows, runs) if row["integrator"] == label and run.success]
        pairs.sort(key=lambda pair: pair[0]["steps"])
        coarser = [pair for pair in pairs if 0 < FINER * pair[0]["steps"] <= pairs[-1][0]["steps"]]
        for part in ("q", "v") if coarser and "q" in reference else ():
            (finest, finest_run), (row, run) = pairs[-1], coarser[-1]
            change = float(np.abs(end_of(finest_run)[part] - end_of(run)[part]).max())
            if finest[f"error_{part}"] > STAGNATION * max(change, reference["known_to"].get(part, 0.0)):
                notes.append(
                    f"{label}: from {row['steps']} to {finest['steps']} steps {part} at the end changes by {change:.1e}, but differs by "
                    f"{finest[f'error_{part}']:.1e} from the reference: it follows another motion, or the reference missed a short pulse "
                    "that the model does not announce as a kink"
                )
                break
    return notes


class Precision(Result):
    """Runs with their errors at the end in q, v, lam, in x of a model with first-order states, and in an objective J.

    Plots: errors below the reference's accuracy cannot be resolved; their markers are hollow, at the edge of the grey area.

    Attributes
    ----------
    reference : dict
        {"q", "v", "lam", "x": values at t_end, "J": value, "made_by": [methods], "known_to": {part: accuracy}, "units": {part: unit}}, and
        "cpu_s", the CPU seconds spent on it, if it was made here.
    """

    def __init__(self, name, rows, notes, reference):
        """Take rows, notes and reference; head the columns by parts and add notes on errors below the accuracy and on missing orders."""
        super().__init__(rows, notes)
        self.title = f"{self.title}: {name}"
        self.reference = reference
        self.parts = tuple(dict.fromkeys(name.removeprefix("error_") for row in self.rows for name in row if name.startswith("error_")))
        self.norm = reference.get("norm", "end")
        ends = list(self.columns)
        before = {name: self.columns[name] for name in ends[: ends.index("error_q")]}
        of_parts = {f"error_{part}": (self._error_in(part), "{:.1e}") for part in self.parts if part != "J"}
        self.columns = before | of_parts | {name: column for name, column in self.columns.items() if name not in of_parts}
        for part in self.parts:
            count = sum(row[f"error_{part}"] <= self._accuracy(part) for row in self.rows)
            if count and self.known_to[part] > 0:
                self.notes.append(
                    f"{count} of {len(self.rows)} errors in {part} are below the reference's accuracy, {self.known_to[part]:.1e}"
                )
        known = ", ".join(f"{part} {value:.1e}" for part, value in self.known_to.items() if value == value)
        accuracy = f"its accuracy: {known}" if known else "its accuracy is unknown"
        made_by = reference.get("made_by")
        self.lead = f"Reference: {'; '.join(made_by)}; {accuracy}." if made_by else ""
        self.lead += "" if self.norm == "end" else f" Errors: {WORDS[self.norm]}, at the run's own steps."
        self.notes += [note for label in self.labels for part in self.parts if (note := self._not_asymptotic(label, part))]

    @property
    def known_to(self) -> dict[str, float]:
        """{part: accuracy of the reference}. Errors below it cannot be resolved. NaN if it is unknown or the part is empty."""
        known = self.reference.get("known_to", {})
        return {part: float(known.get(part, NAN)) if np.size(self.reference.get(part, ())) else NAN for part in self.parts}

    @property
    def orders(self) -> dict[str, dict[str, float]]:
        """{label: {part: order}}: slope of the error over the mean step on logarithmic axes.

        The fit uses errors above ten times the reference's accuracy. NaN for fewer than two of them, for error control, for errors that grow or
        hardly fall with the step (a slope of at most 0.3), and for errors that are not asymptotic: the slopes of the coarser and of the finer
        half differ by more than 0.3. `notes` says which.
        """
        return {label: {part: self._order(label, part) for part in self.parts} for label in self.labels}

    @property
    def figures(self) -> dict[str, float]:
        """Accuracy and orders, with names such as "known_to_q" and "order_q RATTLE"."""
        numbers = {f"known_to_{part}": value for part, value in self.known_to.items()}
        orders = {f"order_{part} {label}": value for label, parts in self.orders.items() for part, value in parts.items()}
        return numbers | {name: value for name, value in orders.items() if value == value}

    def _paper_heading(self, name, heading):
        """Heading of the column `name` in a table for a paper: with the unit of an error, if it is known."""
        unit = self.reference.get("units", {}).get(name.removeprefix("error_"))
        return f"{heading}, {unit}" if unit else heading

    def _accuracy(self, part):
        """Accuracy of the reference in a part such as "q"; 0 if it is unknown."""
        known = self.known_to[part]
        return known if known == known else 0.0

    def _finished(self, label):
        """The rows of the integrator of that label whose runs reached their end or stopped as asked."""
        return [row for row in self.rows if row["integrator"] == label and row["status"] in ("done", "stopped")]

    def _fitted(self, label, part):
        """List of the finished rows of the integrator `label` that its order in a part is fitted to.

        They have a step h (not error control) and an error in the part above FITTED times the reference's accuracy.
        """
        return [row for row in self._finished(label) if row["h"] is not None and row[f"error_{part}"] > FITTED * self._accuracy(part)]

    def _order(self, label, part):
        """Observed order of an integrator in a part; NaN if its errors are not asymptotic."""
        return NAN if self._not_asymptotic(label, part) else self._slope(self._fitted(label, part), part)

    def _slope(self, rows, part):
        """Slope of the errors in a part over the mean steps of rows, on logarithmic axes."""
        return fit_slope([self._step(row) for row in rows], [row[f"error_{part}"] for row in rows])

    def _not_asymptotic(self, label, part):
        """Why the errors of an integrator have no order, as a text; empty if they have one, or if there is nothing to fit."""
        rows = sorted(self._fitted(label, part), key=self._step, reverse=True)
        measured = [row for row in self._finished(label) if row["h"] is not None and row[f"error_{part}"] > 0]
        above = any(row[f"error_{part}"] > self._accuracy(part) for row in measured)  # if none is, the note on the accuracy says so
        if len(rows) < 2 <= len(measured) and above:
            return f"{label}: no order in {part}, its errors are at the reference's level"
        if len(rows) > 1 and (slope := self._slope(rows, part)) <= ASYMPTOTIC:
            return f"{label}: no order in {part}, its errors hardly fall with the step, or grow (slope {slope:.1f})"
        half = len(rows) // 2
        if len(rows) < 3:
            return ""
        coarser, finer = self._slope(rows[: half + 1], part), self._slope(rows[half:], part)
        if abs(coarser - finer) <= ASYMPTOTIC:
            return ""
        return f"{label}: no order in {part} yet, its errors fall with {coarser:.1f} over the coarser steps and {finer:.1f} over the finer ones"

    def _error_in(self, part):
        """Words for the error in a part, such as "largest error in q", in tables and pictures."""
        norm = {"end": "error in", "max": "largest error in", "rms": "rms error in"}[self.norm]
        return f"{norm} {self.reference.get('words', {}).get(part, part)}"

    def _step(self, row):
        """Mean step of a run, s, its end over its number of steps; the given h if the integrator has counted no steps."""
        return row["t"] / row["steps"] if row["steps"] else row["h"]

    def _draw(self, axis, part, label, i, x_of):
        """Errors of an integrator over x_of(row), finer settings last, and crosses at the upper edge for runs that failed.

        Errors that the reference cannot resolve are hollow markers at its accuracy.
        """
        accuracy = self._accuracy(part)
        shown = [row for row in self._finished(label) if row[f"error_{part}"] > 0 or row[f"error_{part}"] == 0 and accuracy > 0]
        shown = sorted((row for row in shown if x_of(row) > 0), key=lambda row: row["steps"])
        if shown:
            points = [(x_of(row), max(row[f"error_{part}"], accuracy)) for row in shown]
            axis.plot(*np.transpose(points), label=literal(label), **marker_style(i))
            if below := [point for point, row in zip(points, shown) if row[f"error_{part}"] <= accuracy]:
                axis.plot(*np.transpose(below), label="_below", **marker_style(i) | {"linestyle": "none", "markerfacecolor": "white"})
        finished = self._finished(label)
        failed = [x_of(row) for row in self.rows if row["integrator"] == label and row not in finished and x_of(row) > 0]
        if failed:
            look = marker_style(i) | {"marker": "x", "linestyle": "none", "transform": axis.get_xaxis_transform(), "clip_on": False}
            axis.plot(failed, np.ones(len(failed)), label=literal(f"{label}: failed"), **look)

    def _plot(self, part, axes, x_of, xlabel, title, labels, orders=False):
        """Draw the errors in a part over x_of(row), a line for each integrator; orders: also a thin line for each rounded order."""
        part = self.parts[0] if part is None else one_of("plot", "part", part, self.parts)
        with on_axes(axes) as axis:
            for i, label in enumerate(self.labels):
                self._draw(axis, part, label, i, x_of)
            if orders:
                self._draw_orders(axis, part)
            return self._finish(axis, part, xlabel, title, labels)

    def _error_pictures(self, against):
        """{name: (caption, function of axes)} of the default plots of all parts."""
        where = WORDS[self.norm]
        return {f"error-{part}": (f"Error in {part}, {where}, against {against}.", partial(self.plot, part)) for part in self.parts}

    def _draw_orders(self, axis, part):
        """Draw a thin line for each rounded order below the errors that it was fitted to, of all integrators of that order."""
        found: dict[int, list] = {}
        for label in self.labels:
            order = self.orders[label][part]
            if np.isfinite(order):
                found.setdefault(round(order), []).extend(self._fitted(label, part))
        if axis.lines:
            axis.margins(y=0.15)  # space for the orders
        for order, rows in found.items():
            steps = [self._step(row) for row in rows]
            coarsest = min(row[f"error_{part}"] / self._step(row) ** order for row in rows) * max(steps) ** order
            slope_line(axis, order, [max(steps), min(steps)], 0.5 * coarsest, f"order {order}", offset=(3, -3))

    def _finish(self, axis, part, xlabel, title, labels):
        """Make the axes logarithmic, grey the area below the reference's accuracy, and add names and legend."""
        axis.set(xscale="log", yscale="log")
        accuracy, (low, high) = self.known_to[part], axis.get_ylim()
        if accuracy > low:
            axis.axhspan(low, accuracy, color=UNRESOLVED, zorder=0, linewidth=0)
            axis.axhline(accuracy, color=INK, linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=0, label="accuracy of the reference")
            axis.set_ylim(low, high)
        unit = self.reference.get("units", {}).get(part, "")
        axis.set(xlabel=xlabel, ylabel=f"{literal(self._error_in(SYMBOLS.get(part, part)))}{f', {unit}' if unit else ''}")
        return finish(axis, title, labels)


def _with_estimates(ivp, integrators, objective, rows, reference, progress):
    """(rows with their estimated and, relative to the most accurate corrected value, measured errors in J; notes; reference with that value)."""
    bars, notes = [], []
    for row, integrator in zip(rows, (one for settings in integrators.values() for one in settings)):
        progress(f"{row['integrator']}, {row['setting']}: estimate")
        try:
            with ivp.user_errors():
                if row["status"] != "done":
                    raise InputError(row["message"])
                bars.append(error_of(ivp.run(integrator), objective, again=not isinstance(integrator, GeneralizedAlpha)))
        except (InputError, StepFailure) as error:
            bars.append(None)
            notes.append(f"{row['integrator']}, {row['setting']} has no estimated error: {str(error).removeprefix('error_of: ')}")
    errors = [NAN if one is None or not one.trusted else one.time + (one.newton or 0.0) for one in bars]
    known = [(abs(error), one.value + error) for one, error in zip(bars, errors) if np.isfinite(error)]
    least, value = min(known, default=(NAN, NAN))
    result = []
    for row, one, error in zip(rows, bars, errors):
        if one is not None and not np.isfinite(error):
            notes.append(f"{row['integrator']}, {row['setting']}: the estimated error is not trusted: {'; '.join(one.reasons['time'])}")
        result.append(row | {"error_J": NAN if one is None else abs(one.value - value), "estimated_J": abs(error)})
    return result, notes, reference | {"J": value, "known_to": reference.get("known_to", {}) | {"J": least}}


def measure_errors(study, ivp, integrators, reference, repeats, progress, objective=None, folder=None):
    """(rows, notes, reference): the runs of every integrator one after the other, then the reference, computed if None.

    folder: that keeps the ends of reference runs, beside the memory.
    """
    reference, total = _given_reference(study, ivp, reference), sum(map(len, integrators.values()))
    rows, runs = _measured_runs(ivp, integrators, repeats, lambda done, text: progress(done, total + 1, text))
    if ivp.quantity:
        ivp = replace(ivp, quantity=ivp.quantity.at_steps_of(runs))

    def smallest_errors(reference):
        """{part: smallest error above zero of all runs relative to this reference}; 0 for a part in which no run has such an error."""
        errors = [errors_of(ivp, run, reference) for run in runs]
        return {part: min((each[part] for each in errors if each[part] > 0), default=0.0) for part in ivp.parts}

    if reference is None:
        reference = make_reference(ivp, smallest_errors, lambda text: progress(total, total + 1, text), kept=KeptEnds(ivp, folder))
    errors = (errors_of(ivp, run, reference) for run in runs)
    rows = [row | {f"error_{part}": error for part, error in each.items()} for row, each in zip(rows, errors)]
    progress(total + 1, total + 1, "")
    notes = [f"{row['integrator']}, {row['setting']}: {row['message']}" for row in rows if row["status"] not in ("done", "stopped")]
    if objective is not None:
        rows, more, reference = _with_estimates(ivp, integrators, objective, rows, reference, lambda text: progress(total, total + 1, text))
        notes += more
    if not reference.get("made_by") and reference["failed"]:
        notes += ["no reference, so no errors: no two methods reached the end", *dict.fromkeys(reference["failed"])]
    notes += [*unresolved_pulse_notes(reference), *([] if ivp.quantity else stagnation_notes(rows, runs, reference))]
    norm, words = (ivp.quantity.norm, ivp.quantity.words) if ivp.quantity else ("end", {})
    return rows, notes, reference | {"units": units_of(ivp), "norm": norm, "words": words}


def _given_reference(study, ivp, reference):
    """The reference of the user or the published one; without values if the user wants none (False), and None if it is to be computed."""
    if reference is False:
        return {"made_by": [], "failed": []}
    if reference is not None:
        return user_reference(study, ivp, reference)
    return user_reference(study, ivp, ivp.published) if "known_to" in ivp.published and not ivp.quantity else None


def _measured_runs(ivp, integrators, repeats, progress):
    """(rows with settings, costs and counts, runs) of every setting; the CPU time is the median of the repeated runs."""
    rows, runs, warm = [], [], set()
    for label, settings in integrators.items():
        for integrator in settings:
            if (kind := kind_of(integrator)) not in warm:
                ivp.warm_up(integrator)
                warm.add(kind)
            progress(len(rows), f"{label}, {settings_text(integrator, settings)}")
            repeated = [ivp.run(integrator, every=10**9) for _ in range(repeats)]
            run, h = repeated[0], declared(integrator).fixed_step() or None
            row = {"integrator": label, "h": h, "status": run.status, "message": run.message, "t": float(run.t[-1])}
            row |= {"cpu_s": float(median(run.cpu_seconds for run in repeated))} | {key: int(getattr(run.counts, key)) for key in COUNTS}
            rows.append(row | {"setting": settings_text(integrator, settings, run.settings_used), "settings_used": run.settings_used})
            runs.append(ivp.run(integrator, every=ivp.quantity.every(run)) if ivp.quantity else run)
    return rows, runs


def units_of(ivp):
    """{part: unit} of a model where all entries of the part have the same one."""
    model = ivp.model
    if ivp.quantity and ivp.quantity.of is not None:
        return dict.fromkeys(ivp.parts, ivp.quantity.unit)
    units = {*model.units} - {""}
    return ({"q": "m", "v": "m/s"} if model.is_scene else {}) | ({"lam": units.pop()} if len(units) == 1 else {})


class WorkPrecision(Precision):
    """Result of `work_precision`: a row for each run, `reference`, `known_to` and `orders`."""

    title = "work against precision"
    columns = COLUMNS

    @named_keywords
    def plot(
        self,
        part: str | None = None,
        axes: Axes | None = None,
        work: str = "cpu_s",
        title: str | None = None,
        labels: dict[str, str] | None = None,
    ) -> Axes:
        """Draw the error against work, a line for each integrator.

        Parameters
        ----------
        part : {"q", "v", "lam", "x", "J"} or the quantity `of` of the study, optional
            Default: the first one that the study has.
        axes : Axes, optional
            New pyplot axes if None.
        work : {"cpu_s", "steps", "residuals", "factorizations", "solves"}
        title : str, optional
            None: no title.
        labels : {label of an integrator: what the legend shows}, optional

        Returns
        -------
        axes : Axes
            Errors below the reference's accuracy cannot be resolved: their markers are hollow, at the edge of the grey area. Runs that failed are
            crosses at the upper edge.

        Raises
        ------
        InputError
            For another part or work.
        """
        one_of("plot", "work", work, WORK)
        return self._plot(part, axes, lambda row: row[work], WORK[work], title, labels)

    def pictures(self) -> dict:
        """The errors of all parts against CPU time, and that in the first one against residuals."""
        caption = f"Error in {self.parts[0]}, {WORDS[self.norm]}, against evaluations of the residual."
        return self._error_pictures("CPU time") | {"residuals": (caption, lambda axes: self.plot(axes=axes, work="residuals"))}


@named_keywords
def work_precision(
    model: object,
    t_end: float | None = None,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrators: dict[str, object] | None = None,
    of: object = None,
    norm: str = "end",
    reference: object = None,
    reference_folder: str | Path | None = None,
    objective: Objective | None = None,
    repeats: int = 1,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> WorkPrecision:
    """Run every setting of every integrator and compare errors at the end with CPU time and work.

    Parameters
    ----------
    model : Model, Scene, Problem or str
        A string is the name of a problem.
    t_end : float, s, optional
        Default: that of the problem.
    q0, v0 : (n,) float, optional
        State at t = 0. Default: that of the problem, or zero.
    integrators : {label: [integrators]}
        Several settings of each integrator, also of a user's own.
    of : str, attachment, sensor or function, optional
        What is compared in place of q, v and lam: the place of a point or a joint, by its name, or of an attachment such as `body.at("right")`, a
        sensor of `pi.sensor`, or a function of the run that gives an array (frames, ...), each entry of its frame alone. Its name is the part of
        plots: "bar right" of this attachment, "sensor" of a sensor, "quantity" of a lambda.
    norm : {"end", "max", "rms"}
        Of the errors: at the end, the largest one, or their root mean square, over the run's own steps. Of a run of more than 200 steps every
        second one counts, or every third and so on, and the end. There the reference is interpolated in q and v, with lam from the
        equations of motion. Each setting runs once more for that; its CPU time is that of the run without.
    reference : {"q", "v", "lam", "x"}, Trajectory or State at t_end, or False, optional
        Default: the published digits of the problem, or else Radau IIA, refined until another method agrees with it to a tenth of the
        smallest error: Radau IIA of order 3, or one of another family where that does not come near. The next study of the same model, start and
        end takes what is known and refines it if its errors are smaller. False: none, which an objective does not need.
    reference_folder : str or Path, optional
        Folder that keeps the ends of reference runs for later processes, in a file for each model, start and end. In memory they stay anyway.
    objective : Objective, optional
        A quantity J, one of `pi.objective`. Each run is repeated for `pi.error_of`. J of the run with the smallest trusted estimate, corrected by it,
        is the reference of J; its accuracy is the size of that estimate.
    repeats : int
        Runs of each setting; the CPU time is their median.
    progress : callable or bool, optional
        Function of (done, total, text); by default a bar at a terminal and in a notebook; False: none. During the reference the text
        says how many CPU seconds its next run will take.

    Returns
    -------
    result : WorkPrecision
        A row for each run. Errors are the largest absolute deviations, in the units of q, v, lam, x and J; beside that in J stands the estimated
        one. A failed run is a row with its status and message.

    Raises
    ------
    InputError
        For invalid arguments, before the first run.

    Notes
    -----
    The runs follow one another, because their CPU time is measured; other work on the machine distorts it.
    """
    ivp = initial_value_problem("work_precision", model, t_end, q0, v0)
    ivp = replace(ivp, quantity=quantity_of("work_precision", ivp, of, norm))
    lists = integrator_lists("work_precision", ivp, integrators)
    if objective is not None:
        require_objective("work_precision", objective)
    elif reference is False:
        raise InputError("work_precision: reference = False leaves no errors; give an objective, such as pi.objective.Deviation(...)")
    whole("work_precision", "repeats", repeats)
    folder = require_folder("work_precision", reference_folder)
    with teller("work_precision", progress) as report:
        return WorkPrecision(ivp.name, *measure_errors("work_precision", ivp, lists, reference, repeats, report, objective, folder))


class StepSizes(Precision):
    """Result of `step_sizes`: a row for each run, `reference`, `known_to` and `orders`."""

    title = "errors against the step"
    columns = {name: COLUMNS[name] for name in ("integrator", "setting")} | {"h": ("h, s", "{:.3g}")} | COLUMNS

    @named_keywords
    def plot(
        self, part: str | None = None, axes: Axes | None = None, title: str | None = None, labels: dict[str, str] | None = None
    ) -> Axes:
        """Draw the error against the mean step, with one thin line for each rounded order.

        Parameters
        ----------
        part : {"q", "v", "lam", "x"} or the quantity `of` of the study, optional
            Default: the first one that the study has.
        axes : Axes, optional
            New pyplot axes if None.
        title : str, optional
            None: no title.
        labels : {label of an integrator: what the legend shows}, optional

        Returns
        -------
        axes : Axes
            Errors below the reference's accuracy cannot be resolved: their markers are hollow, at the edge of the grey area. Runs that failed are
            crosses at the upper edge.

        Raises
        ------
        InputError
            For another part.
        """
        return self._plot(part, axes, self._step, "mean step, s", title, labels, orders=True)

    def pictures(self) -> dict:
        """Return {file name: (caption, function that draws the figure)}: the errors of all parts against the step."""
        return self._error_pictures("the step")


@named_keywords
def step_sizes(
    model: object,
    t_end: float | None = None,
    *,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrators: dict[str, Callable[[float], object]] | None = None,
    h: ArrayLike = (8e-3, 4e-3, 2e-3, 1e-3),
    of: object = None,
    norm: str = "end",
    reference: object = None,
    reference_folder: str | Path | None = None,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> StepSizes:
    """Run every integrator with every step and measure errors at the end and their orders.

    Parameters
    ----------
    model, t_end, q0, v0
        As in `work_precision`.
    integrators : {label: class or function}
        A class with an argument h, or a function of h that returns an integrator.
    h : (k,) float, s
        The steps, not longer than t_end. Integrators shorten them, so that a whole number of steps ends at t_end: plots and orders use the
        mean step of each run.
    of, norm, reference, reference_folder, progress
        As in `work_precision`.

    Returns
    -------
    result : StepSizes
        A row for each run, with the h that was asked for.

    Raises
    ------
    InputError
        For invalid arguments, before the first run.
    """
    ivp = initial_value_problem("step_sizes", model, t_end, q0, v0)
    ivp = replace(ivp, quantity=quantity_of("step_sizes", ivp, of, norm))
    steps = step_list("step_sizes", h)
    if steps[0] > ivp.t_end:
        raise InputError(f"step_sizes: h = {steps[0]:g} s must not be longer than the run, t_end = {ivp.t_end:g} s")
    if isinstance(integrators, dict):
        integrators = {label: [_with_step(label, make, h) for h in steps] for label, make in integrators.items()}
    lists = integrator_lists("step_sizes", ivp, integrators)
    folder = require_folder("step_sizes", reference_folder)
    with teller("step_sizes", progress) as report:
        rows, notes, reference = measure_errors("step_sizes", ivp, lists, reference, 1, report, folder=folder)
    for row, step in zip(rows, np.tile(steps, len(lists))):
        row["h"] = float(step)
    return StepSizes(ivp.name, rows, notes, reference)


def _with_step(label, make, h):
    """The integrator that a class or function of the user makes of a step h, s. Raises InputError if it makes none."""
    if not callable(make):
        raise InputError(f"step_sizes: integrators[{label!r}] = {make!r} must be a class or a function of h")
    message = f"step_sizes: integrators[{label!r}] = {getattr(make, '__name__', repr(make))} makes no integrator of a step h"
    if isinstance(make, type) and "h" not in signature(make).parameters:
        raise InputError(f"{message}: the class takes no h; give a function of h")
    try:
        return make(h=h) if isinstance(make, type) else make(h)
    except TypeError as error:
        raise InputError(f"{message}: {error}") from error
