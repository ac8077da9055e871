"""What every study gives: rows, figures made of them, notes; as a table, a data frame, a plot, a report."""

import json
import math
from pathlib import Path

from polyida.errors import InputError
from polyida.machine import machine_info
from polyida.study.isolation import plain

CELL = 34  # characters of a cell of the printed table
KEPT = ("status", "error")  # columns that are shown only where something failed


class Result:
    """Rows of plain values, and what follows from them.

    rows: [{column: value}], one a run or a case. figures: {name: number}. notes: lines on what failed and what the numbers mean.
    title: of the report. columns: {name: (heading, format)} of the tables, in their order; those that no row has are left out.
    histories: {label: {"t": (frames,), name: (frames,)}}, of studies that look at whole runs.
    """

    title = "study"
    columns: dict = {}

    def __init__(self, rows, notes=(), histories=None):
        self.rows, self.notes, self.histories = list(rows), list(notes), histories or {}

    @property
    def figures(self) -> dict[str, float]:
        """{name: number}: what the rows come to."""
        return {}

    def to_dataframe(self):
        """The rows as a pandas.DataFrame."""
        from pandas import DataFrame

        return DataFrame(self.rows, columns=self._names() or None)

    def to_xarray(self):
        """The histories as an xarray.Dataset over (run, frame), NaN behind the last frame of each; the rows, over row, where there are none.

        Raises InputError where xarray is not installed.
        """
        from polyida.study.histories import dataset

        return dataset(self.histories) if self.histories else self.to_dataframe().rename_axis("row").to_xarray()

    def plot(self, axes=None):
        """Draw the main figure into matplotlib axes, new ones where None are given; returns the axes."""
        raise InputError(f"{type(self).__name__} has no picture of its own; draw its rows")

    def pictures(self) -> dict:
        """{name: (caption, function of axes that draws it)} of the report."""
        return {}

    def report(self, folder: str | Path, overwrite: bool = False, command: str = "") -> Path:
        """Write report.html, figures.json, and each picture as PNG, PDF and CSV into a folder; returns the folder.

        command: what made it, by default the script that runs. Raises InputError where the folder has something in it, unless `overwrite`.
        """
        from polyida.study.report import write

        return write(self, folder, overwrite, command)

    def as_dict(self) -> dict:
        """Rows, figures, notes and machine as figures.json holds them: what is not finite is None."""
        data = {"title": self.title, "figures": self.figures, "notes": self.notes, "rows": self.rows, "machine": machine_info()}
        return finite(json.loads(json.dumps(data, default=plain)))

    def _names(self):
        """The columns that rows have: those of `columns` first, in their order."""
        there = list(dict.fromkeys(name for row in self.rows for name in row))
        return [name for name in self.columns if name in there] + [name for name in there if name not in self.columns]

    def shown(self) -> dict:
        """{name: (heading, format)} of the columns that a table shows."""
        failed = any(row.get("error") or row.get("status", "done") != "done" for row in self.rows)
        wanted = {name: column for name, column in self.columns.items() if name not in KEPT or failed}
        there = {name for row in self.rows for name in row}
        return {name: column for name, column in wanted.items() if name in there} or {name: (name, "") for name in self._names()}

    def __repr__(self):
        return f"<{type(self).__name__}: {self.title}, {len(self.rows)} row{'s' * (len(self.rows) != 1)}>"

    def __str__(self):
        columns = self.shown()
        lines = [[heading for heading, _ in columns.values()]]
        lines += [[text(row.get(name), form) for name, (_, form) in columns.items()] for row in self.rows]
        widths = [max(len(line[k]) for line in lines) for k in range(len(columns))]
        table = ["  ".join(_aligned(line[k], width, k) for k, width in enumerate(widths)).rstrip() for line in lines]
        figures = [f"{name}: {value:.4g}" for name, value in self.figures.items()]
        return "\n".join([self.title, *table, *figures, *self.notes])

    def _repr_html_(self):
        from html import escape

        columns = self.shown()
        head = "".join(f"<th>{escape(heading)}</th>" for heading, _ in columns.values())
        body = "".join(
            f"<tr>{''.join(f'<td>{escape(text(row.get(name), form))}</td>' for name, (_, form) in columns.items())}</tr>"
            for row in self.rows
        )
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return f"<p><strong>{escape(self.title)}</strong></p><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{notes}"


def text(value, form="", longest=CELL):
    """A value as a cell of a table: a dash for what is missing or not finite, long texts cut."""
    if value is None or isinstance(value, float) and not math.isfinite(value):
        return "-"
    if isinstance(value, float) or form and not isinstance(value, str):
        return format(value, form or ".4g")
    found = str(value)
    return found if len(found) <= longest else f"{found[: longest - 1]}…"


def finite(value):
    """Plain data in which numbers that JSON cannot hold are None."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _aligned(cell, width, column):
    """The first column to the left, the others to the right."""
    return cell.ljust(width) if column == 0 else cell.rjust(width)
