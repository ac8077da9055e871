"""Errors against what they cost, and against the step: runs of integrators, one after the other, measured against one reference.

Two methods that agree may both have stepped over what is short and announced by no kink: such doubts are told.
"""

from collections.abc import Callable
from inspect import signature

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.integrate.state import declared
from polyida.progress import teller
from polyida.show.style import INK, on_axes, plain
from polyida.study.drawing import look, slope_line
from polyida.study.references import agreed, given
from polyida.study.result import Result
from polyida.study.rows import NAN, errors, fitted, measured, smallest_errors
from polyida.study.subject import PARTS, kind_of, members, setting, steps_of, subject
from polyida.validation import is_one_of, is_whole, named_keywords

FINER = 1.5  # times the steps: of two runs that tell how far one moves
STANDS = 10.0  # times nearer to each other than to the reference, and beyond what is known of it: two runs that do not come to it
ABOVE = 10.0  # times what is known of the reference: errors above it are fitted
UNKNOWN = "#88888822"  # what lies below what is known of the reference


def short(reference):
    """The line on what is too short for a reference, of a model with forces that no kink announces; else none."""
    if "looked_at" not in reference:
        return []
    return [
        f"what acts for less than {reference['looked_at']:.1e} s between the steps of the reference is not seen, as far as no kink of the model "
        "announces it: known_to does not hold it"
    ]


def doubts(rows, runs, reference):
    """Lines on integrators whose ends stand still with finer steps, away from the reference. rows, runs: of all settings; with errors."""
    found = []
    for label in dict.fromkeys(row["integrator"] for row in rows):
        pairs = [(row, run) for row, run in zip(rows, runs) if row["integrator"] == label and run.success]
        found += _standing(label, sorted(pairs, key=lambda pair: pair[0]["steps"]), reference)
    return found


def _standing(label, pairs, reference):
    """The line of one integrator, or none."""
    finest, finest_run = pairs[-1] if pairs else ({}, None)
    before = [(row, run) for row, run in pairs if 0 < FINER * row["steps"] <= finest["steps"]]
    for part in ("q", "v") if before and "q" in reference else ():
        row, run = before[-1]
        error, moved = finest[f"error_{part}"], float(np.abs(getattr(finest_run, part)[-1] - getattr(run, part)[-1]).max())
        if error > STANDS * max(moved, reference["known_to"].get(part, 0.0)):
            return [
                f"{label}: from {row['steps']} to {finest['steps']} steps its {part} at the end moves by {moved:.1e}, and stands {error:.1e} from "
                "the reference: it follows another motion, or the reference has stepped over something short that no kink of the model announces"
            ]
    return []


class Precision(Result):
    """Rows of runs with their errors at the end, in q, v and lam, against `reference`.

    reference: {"q", "v", "lam": at t_end, "made_by": [by what], "known_to": {part: how far it may be off}}.
    """

    def __init__(self, rows, notes, reference):
        super().__init__(rows, notes)
        self.reference = reference
        self.notes += self._below()
        known = ", ".join(f"{part} {value:.1e}" for part, value in self.known_to.items() if value == value)
        told = f"known to {known}" if known else "how far it is known is not said"
        self.lead = f"Reference: {'; '.join(reference['made_by'])}; {told}." if "q" in reference else ""

    @property
    def known_to(self) -> dict[str, float]:
        """{part: how far the reference may be off}; an error below it is not known.

        NaN where that is not said, and of a part without numbers.
        """
        known = self.reference.get("known_to", {})
        return {part: float(known.get(part, NAN)) if np.size(self.reference.get(part, ())) else NAN for part in PARTS}

    @property
    def orders(self) -> dict[str, dict[str, float]]:
        """{label: {part: fitted order}}: slope of the error over the length of a step on logarithmic axes.

        The length is t / steps, or h where no steps are counted; the runs are those whose error is ten times above what is known.
        NaN where fewer than two are, and of integrators that choose their steps.
        """
        return {label: {part: self._order(label, part) for part in PARTS} for label in self.labels}

    @property
    def figures(self) -> dict[str, float]:
        """known_to and orders, by names such as "known_to_q" and "order_q RATTLE"."""
        found = {f"known_to_{part}": value for part, value in self.known_to.items()}
        orders = {f"order_{part} {label}": value for label, parts in self.orders.items() for part, value in parts.items()}
        return found | {name: value for name, value in orders.items() if value == value}

    def known(self, row, part):
        """Whether the error of a row is above what is known of the reference."""
        return row[f"error_{part}"] > self._floor(part)

    def of(self, label):
        """The rows of an integrator that came to their end."""
        return [row for row in self.rows if row["integrator"] == label and row["status"] in ("done", "stopped")]

    def fitted(self, label, part):
        """The rows of an integrator that its order is fitted over."""
        return [row for row in self.of(label) if row["h"] is not None and row[f"error_{part}"] > ABOVE * self._floor(part)]

    def _order(self, label, part):
        rows = self.fitted(label, part)
        return fitted([self._length(row) for row in rows], [row[f"error_{part}"] for row in rows])

    def _length(self, row):
        """What the order is over; an integrator of a user's own may count no steps."""
        return row["t"] / row["steps"] if row["steps"] else row["h"]

    def _below(self):
        """Lines on errors that are not known."""
        counts = {part: sum(row[f"error_{part}"] <= self._floor(part) for row in self.rows) for part in PARTS}
        return [
            f"{count} of {len(self.rows)} errors in {part} are below what is known of the reference, {self.known_to[part]:.1e}"
            for part, count in counts.items()
            if count and self.known_to[part] > 0
        ]

    def _floor(self, part):
        known = self.known_to[part]
        return known if known == known else 0.0


def against_reference(study, given_subject, members, reference, repeats, tell):
    """(rows, notes, reference): every integrator's runs, one after the other, then the reference, made where None is given."""
    reference = given(study, given_subject, reference) if reference is not None else given_subject.published
    reference = given(study, given_subject, reference) if reference else None
    rows, runs, warm, total = [], [], set(), sum(map(len, members.values()))
    for label, settings in members.items():
        for integrator in settings:
            if (kind := kind_of(integrator)) not in warm:
                given_subject.warm_up(integrator)
                warm.add(kind)
            words = setting(integrator, settings)
            tell(len(rows), total + 1, f"{label}, {words}")
            row, run = measured(given_subject, integrator, repeats)
            h = declared(integrator).fixed_step() or None
            rows.append({"integrator": label, "setting": words, "h": h} | row)
            runs.append(run)
    reference = reference or agreed(given_subject, smallest_errors(runs), lambda what: tell(total, total + 1, what))
    rows = [row | errors(run, reference) for row, run in zip(rows, runs)]
    tell(total + 1, total + 1, "")
    notes = [f"{row['integrator']}, {row['setting']}: {row['message']}" for row in rows if row["status"] not in ("done", "stopped")]
    if "q" not in reference:
        notes += ["no reference, so no errors: no two methods came to the end", *dict.fromkeys(reference["failed"])]
    return rows, [*notes, *short(reference), *doubts(rows, runs, reference)], reference


def _line(axis, study, part, i, label, rows, point):
    """A line of an integrator's rows; points that are not known are hollow, at what is, and those at zero have no place."""
    floor = study.known_to[part]
    rows = [row for row in rows if row[f"error_{part}"] > 0 or row[f"error_{part}"] == 0 and floor > 0]
    if not rows:
        return
    floored = [row | {f"error_{part}": max(row[f"error_{part}"], floor if floor > 0 else 0.0)} for row in rows]
    axis.plot(*np.transpose([point(row) for row in floored]), label=plain(label), **look(i))
    if below := [row for row, true in zip(floored, rows) if not study.known(true, part)]:
        style = look(i) | {"linestyle": "none", "markerfacecolor": "white", "markersize": 5}
        axis.plot(*np.transpose([point(row) for row in below]), label="_below", **style)


def _mark_known(axis, known, direction):
    """Grey where errors are below what is known of the reference, where the axis comes there."""
    axis.set(xscale="log", yscale="log")
    low, high = axis.get_xlim() if direction == "x" else axis.get_ylim()
    if known > low:
        span, line = (axis.axvspan, axis.axvline) if direction == "x" else (axis.axhspan, axis.axhline)
        span(low, known, color=UNKNOWN, zorder=0, linewidth=0)
        line(known, color=INK, linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=0, label="what is known of the reference")
        (axis.set_xlim if direction == "x" else axis.set_ylim)(low, high)


def _legend(axis):
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="best")


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
        with on_axes(axes) as axis:
            for i, label in enumerate(self.labels):
                rows = [row for row in self.of(label) if row[work] > 0]
                _line(axis, self, part, i, label, rows, lambda row: (row[f"error_{part}"], row[work]))
            _mark_known(axis, self.known_to[part], "x")
            axis.set(xscale="log", yscale="log", xlabel=f"error in {part} at the end", ylabel=WORK[work], title=plain(self.title))
            _legend(axis)
            return axis

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
        with on_axes(axes) as axis:
            for i, label in enumerate(self.labels):
                rows = self.of(label)
                _line(axis, self, part, i, label, rows, lambda row: (row["h"], row[f"error_{part}"]))
                order = self.orders[label][part]
                if np.isfinite(order):
                    fitted = self.fitted(label, part)
                    h = [max(row["h"] for row in fitted), min(row["h"] for row in fitted)]
                    slope_line(axis, round(order), h, 0.5 * max(row[f"error_{part}"] for row in fitted))
            _mark_known(axis, self.known_to[part], "y")
            axis.set(xscale="log", yscale="log", xlabel="step h, s", ylabel=f"error in {part} at the end", title=plain(self.title))
            _legend(axis)
            return axis

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
