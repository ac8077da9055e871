"""What work_precision and step_sizes share: runs, one after the other, measured against one reference, and what speaks against that.

Two methods that agree may both have stepped over what is short and announced by no kink.
"""

import numpy as np

from polyida.integrate.state import asked
from polyida.show.style import INK, on_axes, plain
from polyida.study.drawing import look, slope_line
from polyida.study.reference.agreed import agreed, given
from polyida.study.result import Result
from polyida.study.rows import NAN, errors, fitted, measured, smallest_errors
from polyida.study.subject import PARTS, kind_of, setting

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
        self.lead = _made(reference, self.known_to)

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
            rows.append({"integrator": label, "setting": words, "h": _step(integrator)} | row)
            runs.append(run)
    reference = reference or agreed(given_subject, smallest_errors(runs), lambda what: tell(total, total + 1, what))
    rows = [row | errors(run, reference) for row, run in zip(rows, runs)]
    tell(total + 1, total + 1, "")
    return rows, [*_stopped(rows), *_unknown(reference), *short(reference), *doubts(rows, runs, reference)], reference


def _step(integrator):
    h = asked(integrator, "h")
    return float(h) if isinstance(h, (int, float)) and asked(integrator, "rtol") is None else None


def _stopped(rows):
    return [f"{row['integrator']}, {row['setting']}: {row['message']}" for row in rows if row["status"] not in ("done", "stopped")]


def _made(reference, known_to):
    """By what the reference was made, and how far it is known."""
    known = ", ".join(f"{part} {value:.1e}" for part, value in known_to.items() if value == value)
    told = f"known to {known}" if known else "how far it is known is not said"
    return f"Reference: {'; '.join(reference['made_by'])}; {told}." if "q" in reference else ""


def _unknown(reference):
    return [] if "q" in reference else ["no reference, so no errors: no two methods came to the end", *dict.fromkeys(reference["failed"])]


def against_error(study, part, work, heading, axes):
    """Work over the error in a part, a line an integrator; returns the axes."""
    with on_axes(axes) as axis:
        for i, label in enumerate(study.labels):
            rows = [row for row in study.of(label) if row[work] > 0]
            _line(axis, study, part, i, label, rows, lambda row: (row[f"error_{part}"], row[work]))
        _mark_known(axis, study.known_to[part], "x")
        axis.set(xscale="log", yscale="log", xlabel=f"error in {part} at the end", ylabel=heading, title=plain(study.title))
        _legend(axis)
        return axis


def against_step(study, part, axes):
    """The error in a part over the step, a line an integrator, with lines of the fitted orders, rounded; returns the axes."""
    with on_axes(axes) as axis:
        for i, label in enumerate(study.labels):
            rows = study.of(label)
            _line(axis, study, part, i, label, rows, lambda row: (row["h"], row[f"error_{part}"]))
            order = study.orders[label][part]
            if np.isfinite(order):
                fitted = study.fitted(label, part)
                h = [max(row["h"] for row in fitted), min(row["h"] for row in fitted)]
                slope_line(axis, round(order), h, 0.5 * max(row[f"error_{part}"] for row in fitted))
        _mark_known(axis, study.known_to[part], "y")
        axis.set(xscale="log", yscale="log", xlabel="step h, s", ylabel=f"error in {part} at the end", title=plain(study.title))
        _legend(axis)
        return axis


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
