"""What a page consists of. Each block gives its part of the page; `sheets` are the files of its pictures, {name: {kind: bytes}}."""

import math
import re
from csv import reader
from dataclasses import dataclass, field
from html import escape
from numbers import Real
from urllib.parse import quote

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
