"""What is printed: lines and documents on the two streams, progress, and tables that fit the terminal."""

import atexit
import gc
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from polyida.errors import InputError

THRESHOLDS = (100_000, 20, 20)  # new objects before a collection of the youngest, and collections before one of the next older


def prepare():
    """Write letters that the terminal's encoding lacks as question marks; collect garbage seldom, and not once more at the end.

    The compiler and matplotlib make some 500 000 objects that live as long as the process; looking through them again
    and again takes a second of `polyida compare`, and half a second more at the end.
    """
    gc.set_threshold(*THRESHOLDS)
    atexit.register(gc.freeze)
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):  # a stream that somebody has put in the place of the terminal's
            stream.reconfigure(errors="replace")


@contextmanager
def writable():
    """What the operating system refuses within it, standard output included, is one InputError that names the place."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        _give_up()
        sys.exit(1)
    except OSError as error:
        _give_up()
        raise InputError(f"{str(error.filename or 'standard output')[:200]}: {error.strerror or error}") from error


def _give_up():
    """Let what is still in standard output go nowhere, so that Python does not try again at its end."""
    with suppress(OSError, ValueError, AttributeError):
        sys.stdout.flush()
        return
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def lines(*given, style=None):
    """Print lines, empty ones left out."""
    from rich.console import Console
    from rich.text import Text

    for line in filter(None, given):
        Console().print(Text(line, style=style or ""), soft_wrap=True)


def error(message, trace=""):
    """One red line on the error stream; under it the user's own traceback where the fault is in their file."""
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True)
    console.print(Text(message, style="red"), soft_wrap=True)
    if trace:
        console.print(Text(trace), soft_wrap=True)


@contextmanager
def document(wanted):
    """Context of `--json`, where that is `wanted`: what is printed within goes to the error stream.

    Gives a function that takes the one document, plain data, which goes to standard output at the end, also where the command leaves with
    1.
    """
    out, given = sys.stdout, []
    try:
        with redirect_stdout(sys.stderr) if wanted else nullcontext():
            yield given.append
    finally:
        if wanted and given:
            from polyida.show.report import finite

            print(json.dumps(finite(given[-1]), indent=1, allow_nan=False), file=out)


EVERY = 0.2  # s between two drawings of a bar
SELDOM = 30.0  # s between two lines
SETTLED = 1.0  # s of a stage after which its pace tells something
READ = 0.05  # s within which a part of a study is read, not run

Tell = Callable[..., None]


@contextmanager
def bars() -> Iterator[Tell]:
    """Context that gives `tell(label, fraction, detail="", left=None)`; fraction None: end unknown; left: s, from the pace where None.

    Drawn by whoever reports: no thread takes time from the run that is measured.
    """
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Lines()
        return
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    columns = (
        TextColumn("{task.description}", table_column=Column(no_wrap=True, max_width=24)),
        BarColumn(bar_width=16),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}", table_column=Column(no_wrap=True)),
        TextColumn("{task.fields[detail]}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
    )
    quiet: dict[str, Any] = {"auto_refresh": False, "transient": True, "redirect_stdout": False, "redirect_stderr": False}
    with Progress(*columns, console=console, expand=True, **quiet) as progress:
        yield Bars(progress)


class Stages:
    """When each stage began, and how long it goes on at its pace."""

    def __init__(self):
        self.begun, self.shown = {}, time.monotonic()

    def due(self, every):
        """Whether so many seconds are over since the last time that this was so."""
        now = time.monotonic()
        if over := now - self.shown >= every:
            self.shown = now
        return over

    def spent(self, label):
        """Seconds since a stage was first told."""
        now = time.monotonic()
        return now - self.begun.setdefault(label, now)

    def left(self, label, fraction):
        """Seconds until its end, None where that is not known."""
        spent = self.spent(label)
        return spent * (1 - fraction) / fraction if fraction and spent > SETTLED else None


class Bars:
    """A bar a stage."""

    def __init__(self, progress):
        self.progress, self.tasks, self.stages = progress, {}, Stages()

    def __call__(self, label, fraction, detail="", left=None):
        if new := label not in self.tasks:
            for task in self.tasks.values():  # a stage begins, so those before it are over, also those whose end was not known
                self.progress.update(task, total=1.0, completed=1.0, left="")
            self.tasks[label] = self.progress.add_task(label, total=None if fraction is None else 1.0, left="", detail="")
        if not new and not self.stages.due(EVERY) and not (fraction is not None and fraction >= 1):
            return
        left = self.stages.left(label, fraction) if left is None else left
        self.progress.update(self.tasks[label], completed=fraction or 0.0, left=in_words(left), detail=detail)
        self.progress.refresh()


class Lines:
    """A line, seldom."""

    def __init__(self):
        self.stages = Stages()

    def __call__(self, label, fraction, detail="", left=None):
        left = self.stages.left(label, fraction) if left is None else left
        if self.stages.due(SELDOM):
            done = "" if fraction is None else f"{fraction:.0%}"
            print(", ".join(filter(None, (f"{label}: {done}".rstrip(": "), in_words(left), detail))), file=sys.stderr, flush=True)


class Parts:
    """What the progress of a study tells: how many of its parts are done, and the time left, at the mean of those that were run."""

    def __init__(self, name, tell):
        self.name, self.tell, self.last, self.times = name, tell, time.monotonic(), []

    def __call__(self, done, total, task):
        now = time.monotonic()
        self.times += [now - self.last] if now - self.last > READ else []
        self.last = now
        left = (total - done) * sum(self.times) / len(self.times) if self.times else None
        named = ", ".join(f"{key} {value}" for key, value in task.items())
        self.tell(self.name, done / max(total, 1), f"{done}/{total} {named}".rstrip(), left)


def in_words(left: float | None) -> str:
    """Seconds as `0:01:30 left`, empty where they are not known."""
    return "" if left is None else f"{timedelta(seconds=round(left))} left"


WIDE = 160  # characters, where what is printed goes to no terminal
TRIED = ((40, False), (40, True), (24, True), (14, True))  # characters that a cell may have, whether headings are wrapped


@dataclass(frozen=True)
class Grid:
    """Headings and rows of text. least: headings of the columns that go before others where there is no room."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    least: Sequence[str] = ()

    def turned(self):
        """The same with a column for each row."""
        headings, *rows = zip(self.headings, *self.rows)
        return Grid(headings, rows)

    def values(self, i):
        """The different values of a column that are told."""
        return {row[i] for row in self.rows} - {"", "-"}

    def without(self, gone):
        """The same without some columns."""
        kept = [i for i in range(len(self.headings)) if i not in gone]
        return Grid([self.headings[i] for i in kept], [[row[i] for i in kept] for row in self.rows])

    def order(self):
        """The columns in the order in which they go: empty ones, those of one value, the least ones, then from the right; the first stays."""
        return sorted(range(len(self.headings) - 1, 0, -1), key=lambda i: (min(len(self.values(i)), 2), -(self.headings[i] in self.least)))


def show(title: str, *grids: Grid, whole: str) -> None:
    """Print the first of several forms of a table that fits whole, or what fits of the last one. whole: where all of it is to be found."""
    console = console_of(sys.stdout)
    for grid in grids:
        if drawn := _fitting(console, title, grid):
            console.print(drawn)
            return
    grid, gone = grids[-1], []
    for i in grid.order()[:-1]:
        gone.append(i)
        if drawn := _fitting(console, title, grid.without(gone)):
            break
    console.print(drawn or _drawn(title, grid.without(gone), *TRIED[-1]))
    if told := [_told(grid, i) for i in sorted(gone) if grid.values(i)]:
        console.print(f"No room for {', '.join(told)}: {whole} has all.", highlight=False, markup=False)


def texts(headings: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> None:
    """Print a table of a name and a text a row; the text takes as many lines as it needs."""
    from rich.text import Text

    drawn = _empty(title, any(headings))
    drawn.add_column(headings[0], no_wrap=True)
    drawn.add_column(headings[1], overflow="fold")
    for row in rows:
        drawn.add_row(*map(Text, row))
    console_of(sys.stdout).print(drawn)


def console_of(stream):
    """What prints on a stream: as wide as the terminal, or as COLUMNS says, and wide where it is neither."""
    from rich.console import Console

    return Console(file=stream, width=None if stream.isatty() or "COLUMNS" in os.environ else WIDE)


def _told(grid, i):
    """A column that is left out, with its value where it has one alone."""
    values = grid.values(i)
    return f"{grid.headings[i]} ({shortened(*values, TRIED[-1][0])})" if len(values) == 1 and len(grid.rows) > 1 else grid.headings[i]


def _fitting(console, title, grid):
    """A drawing of the grid that is no wider than the console, or None."""
    from rich.measure import Measurement

    for tried in TRIED:
        drawn = _drawn(title, grid, *tried)
        if Measurement.get(console, console.options.update(width=10_000), drawn).maximum <= console.width:
            return drawn
    return None


def _drawn(title, grid, longest, wrapped):
    from rich.text import Text

    drawn, cells = _empty(title, True), [[_broken(row[0], longest), *(shortened(text, longest) for text in row[1:])] for row in grid.rows]
    for i, heading in enumerate(grid.headings):
        width = max((len(line) for row in cells for line in row[i].split("\n")), default=0) if wrapped else len(heading)
        drawn.add_column(Text(_broken(heading, width)), justify="right" if i else "left", no_wrap=True)
    for row in cells:
        drawn.add_row(*map(Text, row))
    return drawn


def _empty(title, heads):
    from rich import box
    from rich.table import Table
    from rich.text import Text

    look = {"title_justify": "left", "box": box.SIMPLE_HEAD, "show_edge": False, "padding": (0, 1, 0, 0)}
    return Table(title=Text(title) if title else None, show_header=heads, **look)


def _broken(heading, width):
    """A text in lines no longer than `width`, where spaces, hyphens and underscores let it be broken so."""
    lines = [""]
    for piece in re.findall(r"[^ _-]+[ _-]*", heading):
        if lines[-1] and len((lines[-1] + piece).rstrip()) > width:
            lines.append("")
        lines[-1] += piece
    return "\n".join(line.rstrip() for line in lines)


def shortened(text: str, longest: int) -> str:
    """A text of so many characters at most: `polyida.reprs` needs numpy, for which a shell that completes a word does not wait."""
    return text if len(text) <= longest else f"{text[: longest - 1]}…"
