"""Tables that fit the terminal: headings are wrapped, long texts cut, columns left out, and it is said which. A number stays whole."""

import os
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass

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
    """A text of so many characters at most: `polyida.brief` needs numpy, for which a shell that completes a word does not wait."""
    return text if len(text) <= longest else f"{text[: longest - 1]}…"
