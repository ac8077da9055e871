"""`Result`: what every study returns, as a table, data frame, plot, figures.json and report."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from polyida.environment import machine_info
from polyida.errors import InputError, printable, text_of
from polyida.files import disk_errors, write_file
from polyida.reprs import cut, table
from polyida.results.motion import xarray
from polyida.show import html
from polyida.show.styles import figure, settings
from polyida.study.executors import to_json
from polyida.study.latex import latex_table
from polyida.validation import flag, instance, listed, named_keywords, path_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

MAX_CELL = 34  # characters of a cell of the printed table
ONLY_FAILED = ("status", "error")  # columns that tables show only if a run failed
NUMBERS = {"name": ("figure", "{}"), "value": ("value", "{:.6g}")}


class Result:
    """Result of a study.

    Parameters
    ----------
    rows : iterable of dict
        A dictionary of plain values for each run or case.
    notes : iterable of str
        Lines on failures and on the meaning of numbers.
    histories : {label: {"t": (frames,) float, name: (frames,) float}}, optional

    Attributes
    ----------
    title, lead : str
        Title of the report, and the paragraph below it.
    columns : {name: (heading, format)}
        Columns of tables in their order; columns that no row has are left out.
    """

    title, lead = "study", ""
    columns: dict = {}
    minor_columns: tuple = ()  # that a narrow terminal leaves out first

    def __init__(self, rows: Iterable[dict], notes: Iterable[str] = (), histories: dict | None = None) -> None:
        """Take the rows {column: value}, notes in words, and histories by name. Raises InputError for other types."""
        self.rows = listed("Result", "rows", rows)
        self.notes = listed("Result", "notes", notes)
        self.histories = {} if histories is None else instance("Result", "histories", histories, dict)

    @property
    def labels(self) -> list[str]:
        """The labels of the integrators in the rows, each once."""
        return list(dict.fromkeys(row["integrator"] for row in self.rows if "integrator" in row))

    @property
    def figures(self) -> dict[str, float]:
        """{name: number}: the key numbers of the study."""
        return {}

    def to_dataframe(self) -> DataFrame:
        """Return the rows as a pandas.DataFrame, with a column for each name."""
        from pandas import DataFrame

        return DataFrame(self.rows, columns=self._names() or None)

    def to_xarray(self) -> Dataset:
        """The histories over (run, frame) as an xarray.Dataset, padded with NaN; without histories the rows over row."""
        Dataset = xarray().Dataset
        if not self.histories:
            return self.to_dataframe().rename_axis("row").to_xarray()
        names = dict.fromkeys(name for history in self.histories.values() for name in history)
        data = np.full((len(names), len(self.histories), max(len(history["t"]) for history in self.histories.values())), np.nan)
        for i, name in enumerate(names):
            for k, history in enumerate(self.histories.values()):
                data[i, k, : len(history.get(name, ()))] = history.get(name, ())
        columns = {name: (["run", "frame"], values) for name, values in zip(names, data)}
        return Dataset(columns, coords={"run": list(self.histories)}).set_coords("t")

    @named_keywords
    def to_latex(self, columns: Iterable[str] | None = None, siunitx: bool = False) -> str:
        """Return the table for a paper in LaTeX, with symbols and units in its headings.

        Parameters
        ----------
        columns : iterable of str, optional
            Names of values of the rows, in their order. Default: the columns of the printed table.
        siunitx : bool
            Columns `S` of siunitx, which align numbers at their decimal point; False: plain mathematics.

        Returns
        -------
        text : str
            A `tabular` with the rules of booktabs. Its first line is a comment that names the packages it needs.

        Raises
        ------
        InputError
            For a name that no row has, and if there are no rows.
        """
        flag("to_latex", "siunitx", siunitx)
        if not self.rows:
            raise InputError("to_latex: the study has no rows")
        shown = self.shown_columns()
        if columns is not None:
            known, chosen = self._names(), listed("to_latex", "columns", columns)
            if not chosen:
                raise InputError("to_latex: columns = [] has no name; give one, or leave it out")
            for name in chosen:
                if not isinstance(name, str) or name not in known:
                    raise InputError(f"to_latex: columns has {name!r:.60}, which no row has; rows have {', '.join(map(str, known))}")
            shown = {name: shown.get(name) or self.columns.get(name, (str(name), "{:.4g}")) for name in chosen}
        headed = {name: (self._paper_heading(name, heading), form) for name, (heading, form) in shown.items()}
        return latex_table(headed, self.rows, siunitx)

    def _paper_heading(self, name, heading):
        """The heading of a column in a table for a paper, with its unit."""
        return heading

    def plot(self, *what: Any, **options: Any) -> Any:
        """Draw the main figure into matplotlib axes, new ones if None, and return the axes."""
        raise InputError(f"{type(self).__name__} has no picture of its own; draw its rows")

    def pictures(self) -> dict:
        """{name: (caption, function of axes that draws the picture)} of the report."""
        return {}

    @named_keywords
    def report(self, folder: str | Path, overwrite: bool = False, command: str = "") -> Path:
        """Write report.html, figures.json, and each picture as PNG, PDF and CSV.

        Parameters
        ----------
        folder : str or Path
            A new or an empty folder, unless `overwrite`.
        overwrite : bool
            Replace the files of an earlier report.
        command : str
            Shown in the report; default: the running script.

        Returns
        -------
        folder : Path

        Raises
        ------
        InputError
            If the folder is not empty or cannot be created.
        """
        folder = path_of("report", "folder", folder)
        flag("report", "overwrite", overwrite)
        if not isinstance(command, str):
            raise InputError(f"report: command = {command!r:.60} must be a text")
        if folder.exists() and not folder.is_dir():
            raise InputError(f"report: {folder} is a file; give a folder")
        if folder.is_dir() and any(folder.iterdir()) and not overwrite:
            raise InputError(f"report: {folder} has something in it: choose another folder, or pass overwrite=True")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"report: the folder {folder} cannot be made: {error.strerror}") from error
        with disk_errors(f"report: {folder}"):
            self.write(
                folder,
                printable(command) or (shlex.join([Path(sys.executable).name, *sys.argv]) if sys.argv[0] else "an interactive session"),
            )
        return folder

    def write(self, folder: Path, command: str, writer: Any = None) -> dict:
        """Write figures.json and the page into an existing folder; returns the data of figures.json. writer: a FigureWriter."""
        try:
            data = finite(json.loads(json.dumps(self.as_dict() | {"command": command}, default=to_json)))
        except (ValueError, RecursionError) as error:  # a list that contains itself, an int of thousands of digits
            raise InputError(f"report: a value of the rows cannot be written: {error}") from None
        write_file(folder / "figures.json", json.dumps(data, indent=1, allow_nan=False) + "\n", sync=True)
        html.write(folder, self.title, self.page(), command, data["machine"], self.lead, writer)
        return data

    def page(self) -> list:
        """The blocks of the report's page: pictures, numbers, tables and notes."""
        pictures = self.report_pictures()
        numbers = [{"name": name, "value": value} for name, value in self.figures.items()]
        blocks: list = [html.Heading("Figures"), *pictures] if pictures else []
        blocks += [html.Heading("Numbers"), html.Table(NUMBERS, numbers)] if numbers else []
        return [*blocks, html.Heading("Rows"), *self.report_tables(), html.Notes(self.notes)]

    def report_pictures(self) -> list:
        """The pictures of `pictures()` as blocks of the report's page."""
        blocks = []
        for name, (caption, draw) in self.pictures().items():
            with settings():
                new, axes = figure(6.4, 3.8)
                draw(axes)
            blocks.append(html.Picture(name, caption, new))
        return blocks

    def report_tables(self) -> list:
        """The rows as blocks of the page; of lists and dictionaries, which figures.json holds, only the size."""
        return [html.Table(self.shown_columns(), [without_lists(row) for row in self.rows])]

    def as_dict(self) -> dict:
        """The content of figures.json: "title", "lead", "figures", "notes", "rows" and "machine" as plain values; None for numbers that are not finite."""
        names = ("title", "lead", "figures", "notes", "rows")
        return finite(json.loads(json.dumps({name: getattr(self, name) for name in names} | {"machine": machine_info()}, default=to_json)))

    def _names(self):
        """Names of all columns that rows have, those of `columns` first."""
        present = list(dict.fromkeys(name for row in self.rows for name in row))
        return [name for name in self.columns if name in present] + [name for name in present if name not in self.columns]

    def shown_columns(self) -> dict:
        """{name: (heading, format)} of the columns that a table shows."""
        failed = any(row.get("error") or row.get("status", "done") != "done" for row in self.rows)
        present = {name for row in self.rows for name in row}
        shown = {name: column for name, column in self.columns.items() if name in present and (failed or name not in ONLY_FAILED)}
        return shown or {name: (name, "{}") for name in self._names()}

    def text_table(self) -> tuple[list[str], list[list[str]]]:
        """(headings, rows of text) of the table with the shown columns."""
        columns = self.shown_columns()
        rows = [[" ".join(html.format_value(row.get(name), form, "-").split()) for name, (_, form) in columns.items()] for row in self.rows]
        return [heading for heading, _ in columns.values()], rows

    def __repr__(self):
        """One line with the class, the title and the number of rows."""
        return f"<{type(self).__name__}: {printable(self.title)}, {len(self.rows)} row{'s' * (len(self.rows) != 1)}>"

    def __str__(self):
        """The title, the table with aligned columns, the figures and the notes, as lines of text."""
        headings, rows = self.text_table()
        lines = [[printable(heading) for heading in headings], *([cut(text, MAX_CELL) for text in row] for row in rows)]
        widths = [max(map(len, column)) for column in zip(*lines)]
        aligned = [(text.rjust(width) if k else text.ljust(width) for k, (text, width) in enumerate(zip(line, widths))) for line in lines]
        figures = [f"{name}: {value:.4g}" for name, value in self.figures.items()]
        around = [printable(text) for text in (*figures, *filter(None, [self.lead]), *self.notes)]
        return "\n".join([printable(self.title), *("  ".join(line).rstrip() for line in aligned), *around])

    def _repr_html_(self):
        """The rows as an HTML table with the notes below it, for a notebook."""
        headings, rows = self.text_table()
        notes = "".join(f"<p>{escape(printable(note))}</p>" for note in [self.lead, *self.notes] if note)
        return table(self.title, headings, [[cut(text, MAX_CELL) for text in row] for row in rows]) + notes


def without_lists(row):
    """A copy of a row with the number of their entries in place of lists and dictionaries."""
    return {name: f"{len(value)} values" if isinstance(value, (list, dict)) else value for name, value in row.items()}


def finite(value):
    """Plain data with None in place of numbers that are not finite, which JSON cannot hold."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class StudyResult(Result):
    """Result of a `Study`: its rows, and what the functions `figures`, `notes` and `draw` of the study make of them.

    A function that raises becomes a note; the others are called all the same. quick: True for the small selection of tasks.
    """

    def __init__(self, study, rows, quick=False):
        """Call the functions of the study with all rows, and note what failed and, if quick, what the small selection leaves out."""
        self.study = study
        self.title = study.name.replace("_", " ")
        self.lead = study.title
        self._figures, self._pictures, failures = dict.fromkeys(study.headline, math.nan), None, []
        for figures in self._call(study.figures, rows, failures):
            self._figures |= {name: float(value) for name, value in figures.items()}
        notes = [line for lines in self._call(study.notes, rows, failures) for line in lines]
        self._pictures = [picture for pictures in self._call(study.draw, rows, failures) for picture in pictures]
        missing = [name for name, value in self._figures.items() if not math.isfinite(value)]
        notes += [f"no value, no successful run gives one: {', '.join(missing)}"] if missing else []
        tasks = study.tasks(False) + study.tasks(True)
        varied = {name for task in tasks for name in task}
        for row in rows:
            if row.get("error"):
                failures.append(f"failed: {', '.join(f'{name} {row[name]}' for name in row if name in varied)[:100]}: {row['error']}")
        notes += failures + (_quick_note(study) if quick else [])
        super().__init__([{name: value for name, value in row.items() if name != "traceback"} for row in rows], notes)
        names = study.columns or tuple(name for name in dict.fromkeys(name for row in self.rows for name in row) if name != "error")
        self.columns = self._column_formats(names, self.rows)
        self.minor_columns = tuple(name for name in names if name not in varied and name not in ("error", "cpu_s", "outcome"))

    @staticmethod
    def _call(functions, rows, failures):
        """The results of one or several functions of the rows; each exception is a line in `failures`."""
        for function in functions if isinstance(functions, tuple) else (functions,):
            try:
                yield function(rows)
            except Exception as error:  # noqa: BLE001, rows may lack anything
                reason = str(error) if isinstance(error, LookupError) and " " in str(error) else f"{type(error).__name__}: {text_of(error)}"
                failures.append(f"not computed: {function.__name__.strip('_')}: {reason}")

    @staticmethod
    def _column_formats(names, rows):
        """{name: (heading, format)} of the columns that have a value."""
        values = {name: [row[name] for row in rows if row.get(name) != "" and not html.is_missing(row.get(name))] for name in names}
        return {name: (name, "{}" if all(isinstance(x, int) for x in column) else "{:.4g}") for name, column in values.items() if column}

    @property
    def figures(self) -> dict[str, float]:
        """{name: number}: what the study's functions `figures` gave."""
        return self._figures

    def shown_columns(self) -> dict:
        """{name: (heading, format)} of the columns of the table."""
        return self.columns

    def as_dict(self) -> dict:
        """The result as plain data, with the name of the study as "study"."""
        return super().as_dict() | {"study": self.study.name}

    def report_pictures(self) -> list:
        """The pictures that the study's functions `draw` gave."""
        return self._pictures

    def report_tables(self) -> list:
        """A table for each kind of task, with the columns that it has; values that all its tasks share are in the caption."""
        kinds: dict[tuple, list] = {}
        for row in self.rows:
            names = list(row)
            kinds.setdefault(tuple(names[: names.index("error")] if "error" in names else names), []).append(without_lists(row))
        tables = []
        for kind, rows in kinds.items():
            columns = self._column_formats(self.study.columns or self.columns, rows)
            values = {name: [row.get(name) for row in rows] for name in columns if name in kind}
            shared = {name: entries[0] for name, entries in values.items() if 1 < len(rows) == entries.count(entries[0])}
            caption = ", ".join(f"{name}: {html.format_value(value)}" for name, value in shared.items())
            tables.append(html.Table({name: column for name, column in columns.items() if name not in shared}, rows, caption))
        return tables


def _quick_note(study):
    """A note on the values of tasks that the quick selection leaves out."""
    quick, full = study.tasks(True), study.tasks(False)

    def values(tasks, name):
        """{value: None} of the different texts and numbers that tasks have under a name, in their order."""
        entries = [task.get(name) for task in tasks]
        return dict.fromkeys(value for value in entries if isinstance(value, (str, int, float)) and not isinstance(value, bool))

    missing = []
    for name in dict.fromkeys(name for task in full for name in task):
        absent = [value for value in values(full, name) if value not in values(quick, name)]
        texts = [value if isinstance(value, str) else f"{value:g}" for value in absent]
        if texts:
            named = len(texts) <= 8 or any(isinstance(value, str) for value in values(full, name))
            missing.append(f"{name} {', '.join(texts) if named else f'of {len(texts)} values'}")
    return [f"the quick selection has {len(quick)} runs, the full one {len(full)}; missing values: {'; '.join(missing)}"] if missing else []
