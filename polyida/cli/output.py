"""Output of the commands: lines, JSON documents, progress, and tables that fit the terminal."""

import atexit
import gc
import json
import os
import re
import sys
import time
from collections.abc import Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from dataclasses import dataclass
from datetime import timedelta
from importlib.util import find_spec
from pathlib import Path

from polyida.errors import InputError, printable

GC_THRESHOLDS = (100_000, 20, 20)


def prepare():
    """Replace letters that the terminal cannot show; collect garbage rarely, and not at the end. What cannot be used is left aside.

    Output without a stream (`>&-`, pythonw) goes nowhere. MPLBACKEND is dropped if matplotlib has no such backend, for it would not start, and
    COLUMNS if it is no width, for nothing would be shown.

    The compiler and matplotlib create some 500 000 permanent objects; scanning them takes 1.5 s of `polyida compare`.
    """
    gc.set_threshold(*GC_THRESHOLDS)
    atexit.register(gc.freeze)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115, until the end of the process
    if not _is_backend(os.environ.get("MPLBACKEND", "")):
        del os.environ["MPLBACKEND"]
    columns = os.environ.get("COLUMNS", "80")
    if not columns.isdecimal() or int(columns) == 0:
        del os.environ["COLUMNS"]
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):  # a stream that replaces that of the terminal
            stream.reconfigure(errors="replace")


def _is_backend(name):
    """True if matplotlib has a backend of that name, or can not be asked; a name that is empty or of a module counts as one.

    Only the file of the backend is looked for: importing matplotlib takes long.
    """
    if not name or name.startswith("module://") or (found := find_spec("matplotlib")) is None:
        return True
    return (Path(found.origin).parent / "backends" / f"backend_{name.lower()}.py").exists()


@contextmanager
def file_errors():
    """Context that turns errors of the operating system into an InputError that names the file, standard output included."""
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        # discard the rest of standard output, otherwise Python tries again at its end
        with suppress(OSError, ValueError, AttributeError):
            try:
                sys.stdout.flush()
            except (OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            sys.exit(1)
        raise InputError(f"{str(error.filename or 'standard output')[:200]}: {error.strerror or error}") from error


def print_lines(*lines, style="", file=None):
    """Print those of the lines that are not empty."""
    from rich.console import Console
    from rich.text import Text

    for line in filter(None, lines):
        Console(file=file).print(Text(printable(line), style=style), soft_wrap=True)


@contextmanager
def document(as_document):
    """Context of `--json`: if `as_document`, all printed text goes to the error stream.

    It gives a function of the document, which is printed at the end, also if the command ends with an error.
    """
    out, documents = sys.stdout, []
    try:
        with redirect_stdout(sys.stderr) if as_document else nullcontext():
            yield documents.append
    finally:
        if as_document and documents:
            from polyida.study.result import finite

            print(json.dumps(finite(documents[-1]), indent=1, allow_nan=False), file=out)


REDRAW, PRINT_INTERVAL = 0.2, 30.0  # s between two drawings of a bar, and between two lines without a terminal
MIN_SPENT = 1.0  # s of a stage before its remaining time is estimated
READ_TIME = 0.05  # s; a task that takes less was read from its file


@contextmanager
def progress_display():
    """Context that gives a ProgressDisplay. The caller redraws it: no thread takes time from measured runs."""
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield ProgressDisplay()
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    columns = (
        TextColumn("{task.description}", markup=False, table_column=Column(no_wrap=True, max_width=24)),
        BarColumn(bar_width=16),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}", table_column=Column(no_wrap=True)),
        TextColumn("{task.fields[detail]}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
    )
    options = {"auto_refresh": False, "transient": True, "redirect_stdout": False, "redirect_stderr": False}
    with Progress(*columns, console=console, expand=True, **options) as bars:
        yield ProgressDisplay(bars)


class ProgressDisplay:
    """Progress of stages: a bar for each in a terminal, otherwise a line from time to time. bars: a Progress of rich."""

    def __init__(self, bars=None):
        """A display without stages so far, of bars or of lines."""
        self.bars = bars
        self.tasks = {}  # {label: its bar}
        self.begun = {}  # {label: time of its beginning}
        self.shown = time.monotonic()  # time of the last drawing or line

    def __call__(self, label, fraction, detail="", left=None):
        """Report the fraction of a stage, None if unknown. left: remaining time, s; None: estimated from the fraction."""
        label, detail = printable(label), printable(detail)
        now, is_new = time.monotonic(), label not in self.begun
        spent = now - self.begun.setdefault(label, now)
        if left is None and fraction and spent > MIN_SPENT:
            left = spent * (1 - fraction) / fraction
        left_text = time_left_text(left)
        is_due = now - self.shown >= (REDRAW if self.bars else PRINT_INTERVAL)
        if self.bars:
            if is_new:
                for task in self.tasks.values():  # the stages before are finished
                    self.bars.update(task, total=1.0, completed=1.0, left="")
                self.tasks[label] = self.bars.add_task(label, total=None if fraction is None else 1.0, left="", detail="")
            if is_new or is_due or fraction is not None and fraction >= 1:
                self.shown = now
                self.bars.update(self.tasks[label], completed=fraction or 0.0, left=left_text, detail=detail)
                self.bars.refresh()
        elif is_due:
            self.shown = now
            done = label if fraction is None else f"{label}: {fraction:.0%}"
            print(", ".join(filter(None, (done, left_text, detail))), file=sys.stderr, flush=True)


class TaskProgress:
    """Progress of a study's tasks, with the remaining time from the mean of the tasks that ran."""

    def __init__(self, name, display):
        """Begin the clock of the tasks of a study of this name."""
        self.name = name
        self.display = display
        self.last = time.monotonic()  # time of the last call
        self.times = []  # s, of the tasks that ran

    def __call__(self, done, total, task):
        """Show how many tasks are done, the task that runs, and the time left by the mean of the tasks that ran."""
        now = time.monotonic()
        self.times += [now - self.last] if now - self.last > READ_TIME else []
        self.last = now
        left = (total - done) * sum(self.times) / len(self.times) if self.times else None
        values = ", ".join(f"{key} {value}" for key, value in task.items())
        self.display(self.name, done / max(total, 1), f"{done}/{total} {values}".rstrip(), left)


def time_left_text(left: float | None) -> str:
    """Seconds as `0:01:30 left`; empty for None."""
    return "" if left is None else f"{timedelta(seconds=round(left))} left"


FILE_WIDTH = 160  # characters of output that goes to no terminal
LAYOUTS = ((40, False), (40, True), (24, True), (14, True))  # (characters of a cell at most, True if headings are wrapped)


@dataclass(frozen=True)
class Grid:
    """Headings and rows of text, without what steers a terminal. minor: headings of columns that a narrow terminal leaves out early."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    minor: Sequence[str] = ()

    def __post_init__(self):
        """Escape control characters in all texts and store them as lists."""
        for name in ("headings", "minor"):
            object.__setattr__(self, name, [printable(text) for text in getattr(self, name)])
        object.__setattr__(self, "rows", [[printable(text) for text in row] for row in self.rows])

    def transposed(self):
        """The grid with rows and columns exchanged: a column for each row."""
        headings, *rows = zip(self.headings, *self.rows)
        return Grid(headings, rows)

    def values(self, i):
        """The set of the different texts in column i, without empty ones and dashes."""
        return {row[i] for row in self.rows} - {"", "-"}

    def without(self, removed):
        """The grid without the columns of these numbers."""
        columns = [i for i in range(len(self.headings)) if i not in removed]
        return Grid([self.headings[i] for i in columns], [[row[i] for i in columns] for row in self.rows])

    def removal_order(self):
        """Columns in the order of removal: empty ones, those with one value, minor ones, then from the right; the first stays."""
        key = lambda i: (min(len(self.values(i)), 2), self.headings[i] not in self.minor)  # noqa: E731
        return sorted(range(len(self.headings) - 1, 0, -1), key=key)

    def drawn(self, title, longest, wrapped):
        """A table of rich. longest: characters of a cell; wrapped: True if headings may have several lines."""
        from rich.text import Text

        table = _new_table(title, True)
        cells = [[_wrapped(row[0], longest), *(shortened(text, longest) for text in row[1:])] for row in self.rows]
        for i, heading in enumerate(self.headings):
            width = max((len(line) for row in cells for line in row[i].split("\n")), default=0) if wrapped else len(heading)
            table.add_column(Text(_wrapped(heading, width)), justify="right" if i else "left", no_wrap=True)
        for row in cells:
            table.add_row(*map(Text, row))
        return table

    def fitted(self, console, title):
        """A table of rich that fits the console, or None."""
        from rich.measure import Measurement

        tables = (self.drawn(title, *layout) for layout in LAYOUTS)
        wide = console.options.update(width=10_000)
        return next((table for table in tables if Measurement.get(console, wide, table).maximum <= console.width), None)


def print_grid(title: str, *grids: Grid, complete_in: str) -> None:
    """Print the first grid that fits, or the columns of the last grid that fit. complete_in: where all columns are."""
    console = terminal(sys.stdout)
    for grid in grids:
        if table := grid.fitted(console, title):
            console.print(table)
            return
    grid, removed = grids[-1], []
    for i in grid.removal_order()[:-1]:
        removed.append(i)
        if table := grid.without(removed).fitted(console, title):
            break
    console.print(table or grid.without(removed).drawn(title, *LAYOUTS[-1]))
    named = []
    for i in sorted(removed):
        values = grid.values(i)
        value = f" ({shortened(next(iter(values)), LAYOUTS[-1][0])})" if len(values) == 1 and len(grid.rows) > 1 else ""
        named += [grid.headings[i] + value] if values else []
    if named:
        console.print(printable(f"No room for {', '.join(named)}: {complete_in} has all."), highlight=False, markup=False)


def print_texts(headings: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> None:
    """Print a table with a name and a text in each row; the text takes as many lines as it needs."""
    from rich.text import Text

    table = _new_table(title, any(headings))
    table.add_column(headings[0], no_wrap=True)
    table.add_column(headings[1], overflow="fold")
    for row in rows:
        table.add_row(*(Text(printable(text)) for text in row))
    terminal(sys.stdout).print(table)


def print_result(result, files=()):
    """Print a study's Result: its table, figures, notes and files."""
    headings, rows = result.text_table()
    minor = [heading for name, (heading, _) in result.shown_columns().items() if name in result.minor_columns]
    print_grid(result.title, Grid(headings, rows, minor), complete_in=str(files[0]) if files else "the report")
    print_lines(*(f"{name}: {value:.6g}" for name, value in result.figures.items()), result.lead, *result.notes)
    print_lines(*(f"Written: {path}" for path in files))


def terminal(stream):
    """Console of a stream with the width of the terminal, or of COLUMNS, or FILE_WIDTH."""
    from rich.console import Console

    return Console(file=stream, width=None if stream.isatty() or "COLUMNS" in os.environ else FILE_WIDTH)


def _new_table(title, has_heading):
    """An empty table of rich with a title, without frame, and with a line of headings if it has any."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    style = {"title_justify": "left", "box": box.SIMPLE_HEAD, "show_edge": False, "padding": (0, 1, 0, 0)}
    return Table(title=Text(printable(title)) if title else None, show_header=has_heading, **style)


def _wrapped(heading, width):
    """A text in lines of at most `width` characters, broken at spaces, hyphens and underscores."""
    lines = [""]
    for piece in re.findall(r"[^ _-]+[ _-]*", heading):
        if lines[-1] and len((lines[-1] + piece).rstrip()) > width:
            lines.append("")
        lines[-1] += piece
    return "\n".join(line.rstrip() for line in lines)


def shortened(text: str, longest: int) -> str:
    """A text of at most so many characters. (`polyida.reprs` imports numpy, for which completion in the shell does not wait.)"""
    return text if len(text) <= longest else f"{text[: longest - 1]}…"
