"""A figure's SVG made part of a page: its own ids, the page's colours, nothing that reaches beyond it."""

import re
from html import escape

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
