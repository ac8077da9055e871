"""What every study gives: rows, figures made of them, notes; as a table, a data frame, a plot, a report."""

import json
from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from polyida.environment import machine_info
from polyida.errors import InputError
from polyida.reprs import cut, table
from polyida.show.html import shown
from polyida.show.report import finite
from polyida.study.isolation import plain

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

CELL = 34  # characters of a cell of the printed table
KEPT = ("status", "error")  # columns that are shown only where something failed


class Result:
    """Rows of plain values, and what follows from them.

    rows: [{column: value}], one a run or a case. figures: {name: number}. notes: lines on what failed and what the numbers mean. title: of
    the report; lead: a paragraph below it. columns: {name: (heading, format)} of the tables, in their order; those that no row has are left
    out. histories: {label: {"t": (frames,), name: (frames,)}}, of studies that look at whole runs.
    """

    title, lead = "study", ""
    columns: dict = {}

    def __init__(self, rows: Iterable[dict], notes: Iterable[str] = (), histories: dict | None = None) -> None:
        self.rows, self.notes, self.histories = list(rows), list(notes), histories or {}

    @property
    def labels(self) -> list[str]:
        """The labels of the integrators that rows are of."""
        return list(dict.fromkeys(row["integrator"] for row in self.rows if "integrator" in row))

    @property
    def figures(self) -> dict[str, float]:
        """{name: number}: what the rows come to."""
        return {}

    def to_dataframe(self) -> "DataFrame":
        """The rows as a pandas.DataFrame."""
        from pandas import DataFrame

        return DataFrame(self.rows, columns=self._names() or None)

    def to_xarray(self) -> "Dataset":
        """The histories as an xarray.Dataset over (run, frame), NaN behind the last frame of each; the rows, over row, where there are
        none.

        Raises InputError where xarray is not installed.
        """
        return dataset(self.histories) if self.histories else self.to_dataframe().rename_axis("row").to_xarray()

    def plot(self, *what: Any, **options: Any) -> Any:
        """Draw the main figure into matplotlib axes, new ones where none are given; returns the axes."""
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
        data = {
            "title": self.title,
            "lead": self.lead,
            "figures": self.figures,
            "notes": self.notes,
            "rows": self.rows,
            "machine": machine_info(),
        }
        return finite(json.loads(json.dumps(data, default=plain)))

    def _names(self):
        """The columns that rows have: those of `columns` first, in their order."""
        there = list(dict.fromkeys(name for row in self.rows for name in row))
        return [name for name in self.columns if name in there] + [name for name in there if name not in self.columns]

    def shown_columns(self) -> dict:
        """{name: (heading, format)} of the columns that a table shows."""
        failed = any(row.get("error") or row.get("status", "done") != "done" for row in self.rows)
        wanted = {name: column for name, column in self.columns.items() if name not in KEPT or failed}
        there = {name for row in self.rows for name in row}
        return {name: column for name, column in wanted.items() if name in there} or {name: (name, "{}") for name in self._names()}

    def __repr__(self):
        return f"<{type(self).__name__}: {self.title}, {len(self.rows)} row{'s' * (len(self.rows) != 1)}>"

    def __str__(self):
        columns = self.shown_columns()
        lines = [[heading for heading, _ in columns.values()]]
        lines += [[cell(row.get(name), form) for name, (_, form) in columns.items()] for row in self.rows]
        widths = [max(len(line[k]) for line in lines) for k in range(len(columns))]
        aligned = [(text.rjust(width) if k else text.ljust(width) for k, (text, width) in enumerate(zip(line, widths))) for line in lines]
        figures = [f"{name}: {value:.4g}" for name, value in self.figures.items()]
        return "\n".join([self.title, *("  ".join(line).rstrip() for line in aligned), *figures, *filter(None, [self.lead]), *self.notes])

    def _repr_html_(self):
        columns = self.shown_columns()
        rows = [[cell(row.get(name), form) for name, (_, form) in columns.items()] for row in self.rows]
        notes = "".join(f"<p>{escape(note)}</p>" for note in [self.lead, *self.notes] if note)
        return table(self.title, [heading for heading, _ in columns.values()], rows) + notes


def cell(value, form="{}"):
    """A value as a cell of a printed table: a dash for what is missing or not finite, long texts cut."""
    return cut(shown(value, form, "-"), CELL)


def dataset(histories):
    """{label: {"t": (frames,), name: (frames,)}} as an xarray.Dataset over (run, frame), t a coordinate, NaN behind a run's last frame.

    Raises InputError where xarray is not installed.
    """
    try:
        from xarray import Dataset
    except ImportError:
        raise InputError("to_xarray: xarray is not installed; pip install 'polyida[xarray]'") from None
    names = list(dict.fromkeys(name for found in histories.values() for name in found if name != "t"))
    count = max(len(found["t"]) for found in histories.values())
    columns = {
        name: (["run", "frame"], np.array([_padded(found.get(name), count) for found in histories.values()])) for name in ["t", *names]
    }
    return Dataset(columns, coords={"run": list(histories)}).set_coords("t")


def _padded(values, count):
    full = np.full(count, np.nan)
    if values is not None:
        full[: len(values)] = values
    return full
