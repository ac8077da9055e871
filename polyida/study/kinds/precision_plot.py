"""Errors on logarithmic axes, with what is known of the reference: points below it are not drawn as if they were known."""

import numpy as np

from polyida.show.style import INK, on_axes, plain
from polyida.study.drawing import look, slope_line

UNKNOWN = "#88888822"  # what lies below what is known of the reference


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
