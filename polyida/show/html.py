"""HTML pages of reports: one self-contained file for screen, phone, paper and keyboard, in light and dark colours.

A page is a list of blocks: `Heading`, `Text`, `Notes`, `Table`, `Picture`, `Movie`. The markup is in templates/report.html.
"""

import json
import math
import re
from base64 import b64encode
from contextlib import ExitStack
from csv import reader
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from itertools import product
from numbers import Real
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar
from urllib.parse import quote

import numpy as np

from polyida.environment import footer, machine_info
from polyida.errors import InputError
from polyida.files import remove_left_over, replacing
from polyida.show import plates
from polyida.show.figure_files import figure_files
from polyida.show.styles import STICK, colour_limit

COLOURS = {  # colour of a figure: colour variable of the page, which has a light and a dark value
    "#ffffff": "paper",
    "#222222": "ink",
    "#000000": "ink",
    "#dddddd": "grid",
    "#b0b0b0": "grid",
    "#cccccc": "grid",
    "#777777": "quiet",
    "#555555": "quiet",
    "#9a9a9a": "quiet",
    "#0072b2": "blue",
    "#56b4e9": "sky",
}
MAX_EMBEDDED_CSV = 2_000_000  # bytes; the page links to larger files
MAX_TABLE = 60, 12  # rows and columns of a picture's numbers that the page shows as a table
LONG_TEXT = 60  # characters; longer cells wrap
DASH = "\N{EN DASH}"


@dataclass(frozen=True, eq=False)
class Heading:
    """A heading that begins a section."""

    kind: ClassVar = "heading"
    text: str


@dataclass(frozen=True, eq=False)
class Text:
    """A paragraph; `backticks` mark code."""

    kind: ClassVar = "text"
    paragraph: str


@dataclass(frozen=True, eq=False)
class Notes:
    """Lines on failures and on the meaning of numbers."""

    kind: ClassVar = "notes"
    lines: list


@dataclass(frozen=True, eq=False)
class Table:
    """A table that sorts by each column.

    columns: {key: (heading, format)} with a format such as "{:.2e}", or "code" for code that wraps. rows: dictionaries of plain values;
    missing and non-finite values are dashes.
    """

    kind: ClassVar = "table"
    columns: dict
    rows: list
    caption: str = ""

    def headings(self):
        """[(heading, True if the column holds only numbers)]."""
        numeric = []
        for key in self.columns:
            values = [row.get(key) for row in self.rows if not is_missing(row.get(key))]
            numeric.append(bool(values) and all(isinstance(value, Real) and not isinstance(value, bool) for value in values))
        return [(heading, is_number) for (heading, _), is_number in zip(self.columns.values(), numeric)]

    def cells(self):
        """Rows of cells: text, CSS classes, value to sort by, True for code."""
        numeric = [is_number for _, is_number in self.headings()]
        return [[_cell(row.get(key), form, number) for (key, (_, form)), number in zip(self.columns.items(), numeric)] for row in self.rows]


def _cell(value, form, numeric):
    """A cell of the page: text, CSS classes, whether it is code, and the value by which the page sorts."""
    missing, code = is_missing(value), form == "code" and not is_missing(value)
    text = format_value(value, "{}" if form == "code" else form)
    css = " ".join(["number"] * numeric + ["empty"] * missing + ["long"] * (len(text) > LONG_TEXT and not code))
    return SimpleNamespace(text=text, css=css, is_code=code, value=_order(value) if numeric and not missing else None)


@dataclass(frozen=True, eq=False)
class Picture:
    """A matplotlib figure: SVG in the page, and name.png, name.pdf and name.csv beside it."""

    kind: ClassVar = "picture"
    name: str
    caption: str
    figure: object = field(repr=False)

    def svg(self, files):
        """The <svg> element with the page's colours; its ids begin with the name, so that they are unique in the page."""
        svg = files["svg"].decode()
        svg = svg[svg.index("<svg") :]
        svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<defs>\s*</defs>|<!--.*?-->", "", svg, flags=re.DOTALL)
        prefix = re.sub(r"\W+", "-", self.name)
        svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{prefix}-", svg)
        page_colour = lambda match: f"{match[1]}: var(--{COLOURS[match[2].lower()]})" if match[2].lower() in COLOURS else match[0]  # noqa: E731
        svg = re.sub(r"\b(fill|stroke): (#[0-9a-fA-F]{6})\b", page_colour, svg)
        width, box = re.search(r'width="([\d.]+)pt"', svg)[1], re.search(r'viewBox="[^"]*"', svg)[0]
        Markup = _templates()[1]
        label = Markup.escape(self.caption)
        return Markup(f'<svg {box} role="img" aria-label="{label}" style="--width: {width}pt">{svg[svg.index(">") + 1 :]}')

    def csv_link(self, files):
        """(text, address) of the link to the numbers of the picture as CSV."""
        csv = files["csv"]
        size = f"{len(csv) / 1e6:.1f} MB" if len(csv) > 1e5 else f"{max(1, round(len(csv) / 1e3))} kB"
        if len(csv) > MAX_EMBEDDED_CSV:
            return f"numbers (CSV, {size}, beside this page)", f"{quote(self.name)}.csv"
        return f"numbers (CSV, {size})", f"data:text/csv;charset=utf-8,{quote(csv, safe=',.;:+-_()/ ').replace(' ', '%20')}"

    def numbers(self, files):
        """The numbers of the picture as a Table, or None if they are too many."""
        head, *rows = reader(files["csv"].decode().splitlines())
        if not 0 < len(rows) <= MAX_TABLE[0] or len(head) > MAX_TABLE[1]:
            return None
        columns = {str(i): (heading, "{:.6g}") for i, heading in enumerate(head)}
        return Table(columns, [{str(i): float(text) if text else None for i, text in enumerate(row)} for row in rows])


def is_missing(value):
    """True for None and for numbers that are not finite."""
    return value is None or (isinstance(value, Real) and not isinstance(value, int) and not math.isfinite(value))


def _order(value):
    """Text of the number by which a page sorts; the largest one of an int beyond the floats."""
    try:
        return repr(float(value))
    except OverflowError:
        return "1e308" if value > 0 else "-1e308"


def format_value(value, form="{}", dash=DASH):
    """A value as text of a table, numbers by the format `form`; `dash` for a missing value."""
    if is_missing(value):
        return dash
    if isinstance(value, bool):
        return "yes" if value else "no"
    try:
        return form.format(value) if isinstance(value, Real) else str(value)
    except (OverflowError, ValueError):  # an int beyond the floats, or of more digits than Python prints
        return f"about 10^{int(abs(value)).bit_length() * math.log10(2.0):.0f}"


POSITIONS, SHADES = 65535, 64  # integer steps of a coordinate, over the longer side, and of the colours
MAX_POINTS = 400_000  # points times frames in a page
MIN_FRAMES, MAX_FRAMES = 12, 60


@dataclass(frozen=True, eq=False)
class Movie:
    """Animation of a run's plates, coloured by von Mises stress, of bodies without a mesh as sticks, of joints and forces, and names of events.

    seconds: duration; None: the simulated time, between 4 and 12 s. Raises InputError for a run without plates.
    """

    kind: ClassVar = "movie"
    run: object = field(repr=False)
    caption: str = "The motion, coloured by the von Mises stress of every element."
    seconds: float | None = None
    frames: int = MAX_FRAMES  # at most

    def data(self):
        """(data of the script as integers, upper end of the colours in kPa). Fine meshes are reduced to their outline."""
        run = self.run
        plates.require_run("movie", run, overwrite=False)
        lines = plates.curves(run.model)
        shown, nodes, offsets, edges = _drawn_cells(lines)
        stick_ends = 2 * len(plates.sticks(run, 0))
        frames = self._frames(len(shown) + stick_ends)
        symbols, low, high = plates.symbols_of(run, frames)
        bodies = np.array(
            [np.concatenate([lines.places(run.node_positions(k))[shown], plates.sticks(run, k).reshape(-1, 2)]) for k in frames]
        )
        drawn = [kind.reshape(len(frames), -1, 2) for kind in symbols]
        points = np.concatenate([bodies, *drawn], axis=1)
        parts = [stick_ends, *(kind.shape[1] for kind in drawn)]
        firsts = len(shown) + np.cumsum([0, *parts])  # of sticks, joints, forces, pins
        sticks, joints, forces = ((first + np.arange(length).reshape(-1, 2)).tolist() for first, length in zip(firsts, parts[:3]))
        stress = np.array([run.von_mises(k) / 1e3 if len(nodes) else [] for k in frames])
        top = colour_limit([*stress])
        size = (high - low).max() or 1.0
        width, height = np.maximum((high - low) / size, 0.05) * POSITIONS
        return {
            "t": run.t[frames].tolist(),
            "clock": plates.clock(run, frames),
            "seconds": float(np.clip(run.t[-1] - run.t[0], 4, 12)) if self.seconds is None else self.seconds,
            "start": int(np.abs(bodies - bodies[0]).sum(axis=(1, 2)).argmax()),  # shown before it plays: the farthest from the first
            "width": float(width),
            "height": float(height),
            "low": low.tolist(),
            "size": float(size),
            "ticks": [_ticks(*ends, size) for ends in zip(low, high)],
            "offsets": offsets.tolist(),
            "nodes": nodes.tolist(),
            "edges": edges.tolist(),
            "sticks": sticks,
            "joints": joints,
            "forces": forces,
            "pins": np.arange(firsts[3], firsts[4]).tolist(),
            "stick": STICK,
            "places": _packed(POSITIONS * (points - low) / size, "<u2"),
            "stress": _packed((SHADES - 1) * np.minimum(stress / top, 1), "u1"),
            "colours": _shades(),
        }, top

    def _frames(self, points):
        """Indices of at most `frames` frames; of fewer where the points of bodies, so many, and of symbols are more than a page holds."""
        symbols = plates.symbols_of(self.run, plates.spread(self.run, self.frames))[0]  # fewer frames do not have more
        number = points + sum(kind[0].size // 2 for kind in symbols)
        return plates.spread(self.run, int(np.clip(MAX_POINTS // (number + 1), min(MIN_FRAMES, self.frames), self.frames)))


def _drawn_cells(lines):
    """(numbers of the points that are drawn, nodes and offsets of the cells, edges) of Curves; of fine meshes the points of the edges alone."""
    nodes, offsets, edges = lines.nodes, lines.offsets, lines.edges
    shown = np.arange(int(nodes.max(initial=-1)) + 1)
    if len(shown) * MIN_FRAMES <= MAX_POINTS:
        return shown, nodes, offsets, edges
    shown = np.unique(edges)
    return shown, nodes[:0], offsets[:1], np.searchsorted(shown, edges)


def _packed(values, kind):
    """Values, rounded to whole numbers of a numpy dtype, as a base64 text."""
    return b64encode(np.rint(values).astype(kind).tobytes()).decode()


def _shades():
    """The colours of the colour scale of stresses, SHADES texts like "#440154" from zero to the largest stress."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0, 1, SHADES))]


def _ticks(low, high, size):
    """[[place, text]] of the marks of an axis from low to high, m."""
    from matplotlib.ticker import MaxNLocator

    values = MaxNLocator(nbins=6, steps=[1, 2, 5, 10]).tick_values(low, high)
    return [[float(POSITIONS * (value - low) / size), f"{value:.6g}"] for value in values if low <= value <= high]


TEMPLATES = Path(__file__).parent / "templates"


def policy(script):
    """The page's Content-Security-Policy: this script alone runs, and nothing is loaded from elsewhere."""
    digest = b64encode(sha256(script.encode()).digest()).decode()
    return (
        f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )


def json_in_html(data):
    """JSON for a script element, in which no text of the data can end the element or begin another."""
    text = json.dumps(data, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


@cache
def _templates():
    """(jinja2 template of a page, the class Markup of text that is HTML already)."""
    from jinja2 import Environment, FileSystemLoader
    from markupsafe import Markup, escape

    environment = Environment(loader=FileSystemLoader(TEMPLATES), autoescape=True, trim_blocks=True)
    environment.filters["code"] = lambda text: Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text))))
    environment.filters["json"] = lambda data: Markup(json_in_html(data))
    return environment.get_template("report.html"), Markup


def block_html(block, files=None):
    """The HTML of one block. files: {name: {kind: bytes}} of the pictures."""
    return str(_templates()[0].module.part(block, files or {}))


def page_text(title, blocks, files=None, lead="", command="", machine=""):
    """The text of a whole page. files: {name: {kind: bytes}} of the pictures; without a command the page has no foot."""
    template, Markup = _templates()
    style, *scripts = (Markup((TEMPLATES / name).read_text(encoding="utf-8")) for name in ("page.css", "table.js", "movie.js"))
    script = Markup("\n").join(scripts)
    about = {"title": title, "lead": lead, "command": command, "machine": machine}
    return template.render(about, blocks=blocks, files=files or {}, style=style, script=script, policy=policy(script))


def write(folder, title, blocks, command, machine=None, lead="", writer=None):
    """Write report.html into a folder, with name.png, name.pdf and name.csv of each Picture; returns its path.

    command, machine: the page's last lines; None: this machine. lead: paragraph below the title. writer: a FigureWriter that may already
    have some of the pictures. Files of these names are replaced. Raises InputError if two pictures have the same name.
    """
    folder, pictures = Path(folder), [block for block in blocks if isinstance(block, Picture)]
    names = [picture.name for picture in pictures]
    if duplicates := [name for name in names if names.count(name) > 1]:
        raise InputError(f"report: two pictures have the name {duplicates[0]!r}; each picture needs its own name")
    folder.mkdir(parents=True, exist_ok=True)
    remove_left_over(folder)
    for picture in pictures:
        if writer and picture.name not in writer.figures:
            writer.add(picture.name, picture.figure)
    files = writer.files() if writer else {picture.name: figure_files(picture.figure) for picture in pictures}
    page = page_text(title, blocks, files, lead, command, footer(machine or machine_info()))
    path = folder / "report.html"
    with ExitStack() as whole:  # all files are written before the first of them is replaced
        for name, kind in product(names, ("png", "pdf", "csv")):
            whole.enter_context(replacing(folder / f"{name}.{kind}")).write_bytes(files[name][kind])
        whole.enter_context(replacing(path)).write_text(page, encoding="utf-8", newline="\n")
    return path
