"""An HTML page of blocks: one file that stands alone, light and dark, for a screen, a phone, paper and the keyboard.

Each block gives its part of the page; `sheets` are the files of its pictures, {name: {kind: bytes}}.
"""

import json
import math
import re
from base64 import b64encode
from csv import reader
from dataclasses import dataclass, field
from html import escape
from numbers import Real
from pathlib import Path
from urllib.parse import quote

import numpy as np

from polyida.environment import footer, machine_info
from polyida.errors import InputError
from polyida.show import plates
from polyida.show.press import drawn
from polyida.show.style import STICK, box, colour_top

COLOURS = {  # of a figure -> of the page, which has them light and dark
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
WITHIN = 2_000_000  # bytes of CSV that the page itself holds
SHOWN = 60, 12  # rows and columns of numbers that the page shows as a table
MANY = 10  # columns, beyond which a table is smaller on paper
LONG = 60  # letters, from which a cell is a sentence
DASH = "\N{EN DASH}"


def inline(text, name, label):
    """The <svg> of a file's text. name: begins its ids, so that no two figures of a page share one. label: what it says to who cannot see it."""
    svg = text[text.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<defs>\s*</defs>|<!--.*?-->", "", svg, flags=re.DOTALL)
    own = re.sub(r"\W+", "-", name) + "-"
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{own}", svg)
    svg = re.sub(r"\b(fill|stroke): (#[0-9a-fA-F]{6})\b", _coloured, svg)
    width, box = re.search(r'width="([\d.]+)pt"', svg)[1], re.search(r'viewBox="[^"]*"', svg)[0]
    begin = f'<svg {box} role="img" aria-label="{escape(label)}" style="--width: {width}pt">'
    return begin + svg[svg.index(">") + 1 :]


def _coloured(found):
    kind, colour = found.groups()
    return f"{kind}: var(--{COLOURS[colour.lower()]})" if colour.lower() in COLOURS else found[0]


@dataclass(frozen=True, eq=False)
class Heading:
    """A heading, which begins a section."""

    text: str

    def html(self, sheets):
        return f"<h2>{escape(self.text)}</h2>"


@dataclass(frozen=True, eq=False)
class Text:
    """A paragraph; what stands between `backticks` is code."""

    paragraph: str

    def html(self, sheets):
        return f"<p>{prose(self.paragraph)}</p>"


@dataclass(frozen=True, eq=False)
class Notes:
    """Lines that a reader must not miss: what failed, what the numbers mean. Nothing where there are none."""

    lines: list

    def html(self, sheets):
        return f'<ul class="notes">{"".join(f"<li>{prose(line)}</li>" for line in self.lines)}</ul>' if self.lines else ""


@dataclass(frozen=True, eq=False)
class Table:
    """Rows that sort by each column.

    columns: {key: (heading, format)}, format as "{:.2e}", or "code" for code that wraps. rows: dictionaries of plain values; what a row
    does not have, and what is not finite, is a dash.
    """

    columns: dict
    rows: list
    caption: str = ""

    def html(self, sheets):
        numeric = {key: _numeric([row.get(key) for row in self.rows]) for key in self.columns}
        head = "".join(f'<th scope="col"{_class(numeric[key])}>{escape(heading)}</th>' for key, (heading, _) in self.columns.items())
        body = "".join(
            f"<tr>{''.join(_cell(row.get(key), form, numeric[key]) for key, (_, form) in self.columns.items())}</tr>" for row in self.rows
        )
        caption = f"<caption>{prose(self.caption)}</caption>" if self.caption else ""
        many = ' class="many"' if len(self.columns) > MANY else ""
        table = f"<table{many}>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        return scrolled(table, self.caption or "Table")


@dataclass(frozen=True, eq=False)
class Picture:
    """A matplotlib figure, which becomes `name`.png, `name`.pdf and `name`.csv beside the page and, in it, SVG with text."""

    name: str
    caption: str
    figure: object = field(repr=False)

    def html(self, sheets):
        files = sheets[self.name]
        svg = inline(files["svg"].decode(), self.name, self.caption)
        return (
            f'<figure class="picture">{scrolled(svg, f"Figure: {self.caption}")}<figcaption>{prose(self.caption)} '
            f"{_link(self.name, files['csv'])} <small>{escape(self.name)}.png and .pdf are beside this page.</small></figcaption>"
            f"{_numbers(files['csv'].decode())}</figure>"
        )


def prose(text):
    """Text with code between backticks."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(str(text)))


def scrolled(inner, label):
    """What may be wider than a phone, in a box of its own that scrolls, by keyboard too."""
    return f'<div class="wide" tabindex="0" role="group" aria-label="{escape(label)}">{inner}</div>'


def missing(value):
    """Whether there is nothing to show: no value, or a number that is not finite."""
    return value is None or (isinstance(value, Real) and not math.isfinite(value))


def shown(value, form="{}", dash=DASH):
    """A value as text; what is no number is as it is in a column of numbers."""
    if missing(value):
        return dash
    if isinstance(value, bool):
        return "yes" if value else "no"
    return form.format(value) if isinstance(value, Real) else str(value)


def _numeric(values):
    """Whether a column holds numbers alone, and one at least."""
    there = [value for value in values if not missing(value)]
    return bool(there) and all(isinstance(value, Real) and not isinstance(value, bool) for value in there)


def _class(numeric, empty=False, long=False):
    classes = " ".join(["number"] * numeric + ["empty"] * empty + ["long"] * long)
    return f' class="{classes}"' if classes else ""


def _cell(value, form, numeric):
    order = f' data-value="{float(value)!r}"' if numeric and not missing(value) else ""
    code = form == "code" and not missing(value)
    text = escape(shown(value, "{}" if form == "code" else form))
    return f"<td{_class(numeric, missing(value), len(text) > LONG and not code)}{order}>{f'<code>{text}</code>' if code else text}</td>"


def _link(name, csv):
    """A link to the numbers, which the page itself holds unless they are many."""
    size = f"{len(csv) / 1e6:.1f} MB" if len(csv) > 1e5 else f"{max(1, round(len(csv) / 1e3))} kB"
    if len(csv) > WITHIN:
        return f'<a href="{quote(name)}.csv">numbers (CSV, {size}, beside this page)</a>'
    data = quote(csv, safe=",.;:+-_()/ ").replace(" ", "%20")
    return f'<a download="{escape(name)}.csv" href="data:text/csv;charset=utf-8,{data}">numbers (CSV, {size})</a>'


def _numbers(text):
    """The few numbers of a CSV file as a table behind a click; empty where there are many."""
    head, *rows = reader(text.splitlines())
    if not 0 < len(rows) <= SHOWN[0] or len(head) > SHOWN[1]:
        return ""
    columns = {str(i): (heading, "{:.6g}") for i, heading in enumerate(head)}
    table = Table(columns, [{str(i): float(text) if text else None for i, text in enumerate(row)} for row in rows])
    return f"<details><summary>The numbers as a table</summary>{table.html({})}</details>"


PLACES, SHADES = 65535, 64  # steps of a place, over the longer side, and of the colours
WEIGHT = 400_000  # points times frames that a page may hold
FEWEST, MOST = 12, 60  # frames


@dataclass(frozen=True, eq=False)
class Movie:
    """The plates of a run, coloured by von Mises stress, and bodies without a mesh as sticks; play, pause and a slider below.

    seconds: how long one pass takes; by default the simulated time, held to 4..12 s. Raises InputError for a run that has no plates.
    """

    run: object = field(repr=False)
    caption: str = "The motion, coloured by the von Mises stress of every element."
    seconds: float | None = None

    def html(self, sheets):
        data, top = frames(self.run, self.seconds)
        height = round(1500 * (data["height"] / data["width"]) + 20)
        label = f"{self.caption} From t = {data['t'][0]:g} to {data['t'][-1]:g} s."
        return (
            f'<figure class="movie"><canvas width="1520" height="{height}" role="img" aria-label="{escape(label)}"></canvas>'
            '<div class="controls" hidden><button type="button">Play</button>'
            f'<input type="range" min="0" max="{len(data["t"]) - 1}" value="0" step="1" aria-label="Frame"><output></output></div>'
            f"{_key(data['colours'], top) if len(data['offsets']) > 1 else ''}<figcaption>{prose(self.caption)}</figcaption>"
            "<noscript><p>The animation needs a script, which this browser does not run.</p></noscript>"
            f'<script type="application/json">{json.dumps(data, separators=(",", ":"))}</script></figure>'
        )


def frames(run, seconds=None):
    """(the data of the script, the upper end of the colours, kPa): nodes, then ends of sticks, in whole numbers.

    Of a mesh that is too fine for WEIGHT the outline alone is there.
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    plates.require_run("movie", run, overwrite=False)
    nodes, offsets = plates.connectivity(run.model)
    edges, kept = plates.edges(run.model), np.arange(int(nodes.max(initial=-1)) + 1)
    if fine := len(kept) * FEWEST > WEIGHT:
        kept, nodes, offsets = np.unique(edges), nodes[:0], offsets[:1]
        edges = np.searchsorted(kept, edges)
    sticks = len(plates.sticks(run, 0))
    chosen = plates.spread(run, int(np.clip(WEIGHT // (len(kept) + 2 * sticks + 1), FEWEST, MOST)))
    places = np.array([np.concatenate([run.node_positions(k)[kept], plates.sticks(run, k).reshape(-1, 2)]) for k in chosen])
    stress = np.array([[] if fine else run.von_mises(k) / 1e3 for k in chosen])
    (low, high), top = box(places.reshape(-1, 2)), colour_top([*stress])
    size = (high - low).max() or 1.0
    width, height = np.maximum((high - low) / size, 0.05) * PLACES
    return {
        "t": run.t[chosen].tolist(),
        "seconds": float(np.clip(run.t[-1] - run.t[0], 4, 12)) if seconds is None else seconds,
        "width": float(width),
        "height": float(height),
        "offsets": offsets.tolist(),
        "nodes": nodes.tolist(),
        "edges": edges.tolist(),
        "sticks": (len(kept) + np.arange(2 * sticks).reshape(-1, 2)).tolist(),
        "stick": STICK,
        "places": _packed(PLACES * (places - low) / size, "<u2"),
        "stress": _packed((SHADES - 1) * np.minimum(stress / top, 1), "u1"),
        "colours": [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0, 1, SHADES))],
    }, top


def _packed(values, kind):
    return b64encode(np.rint(values).astype(kind).tobytes()).decode()


def _key(colours, top):
    band = ", ".join(colours[::7])
    return f'<div class="scale">0 <span style="background: linear-gradient(90deg, {band})"></span> {top:.3g} kPa and more, von Mises stress</div>'


HERE = Path(__file__).parent / "page"
BESIDE = ("png", "pdf", "csv")  # kinds of a picture's files that lie beside the page


def write(folder, title, blocks, command, machine=None, lead="", press=None):
    """Write report.html into a folder, with NAME.png, NAME.pdf and NAME.csv of each Picture; returns its path.

    command: what made it, and machine: where, by default here (`machine_info`); both stand at the page's end. lead: a paragraph below the
    title. press: a Press that has drawn some of the pictures, by their names. What is there under these names is replaced. Raises
    InputError for two pictures of one name.
    """
    folder, pictures = Path(folder), [block for block in blocks if isinstance(block, Picture)]
    names = [picture.name for picture in pictures]
    if twice := [name for name in names if names.count(name) > 1]:
        raise InputError(f"report: two pictures are called {twice[0]!r}; each needs a name of its own")
    folder.mkdir(parents=True, exist_ok=True)
    for picture in pictures:
        if press and picture.name not in press:
            press.give(picture.name, picture.figure)
    sheets = press.files() if press else {picture.name: drawn(picture.figure) for picture in pictures}
    for picture in pictures:
        for kind in BESIDE:
            (folder / f"{picture.name}.{kind}").write_bytes(sheets[picture.name][kind])
    path = folder / "report.html"
    path.write_text(page(title, blocks, command, machine or machine_info(), lead, sheets), encoding="utf-8")
    return path


def page(title, blocks, command, machine, lead, sheets):
    """The page as text. sheets: the files of its pictures, {name: {kind: bytes}}."""
    return PAGE.format(
        title=escape(title),
        style=_read("page.css"),
        lead=f'<p class="lead">{prose(lead)}</p>' if lead else "",
        blocks="\n".join(block.html(sheets) for block in blocks),
        command=escape(command),
        machine=escape(footer(machine)),
        script="\n".join(_read(name) for name in ("table.js", "movie.js")),
    )


def _read(name):
    return (HERE / name).read_text(encoding="utf-8")


PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
{style}</style>
</head>
<body>
<a class="skip" href="#content">Skip to the content</a>
<header>
<h1>{title}</h1>
{lead}
</header>
<main id="content" tabindex="-1">
{blocks}
</main>
<footer>
<p>Made by <code>{command}</code></p>
<p>{machine}</p>
</footer>
<script>
{script}</script>
</body>
</html>
"""
