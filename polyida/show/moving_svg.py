"""A run as an SVG that moves by itself: small, sharp at every size, and readable on light and dark pages."""

import numpy as np

from polyida.show import plates
from polyida.show.styles import PALETTE, STICK

UNITS, MARGIN, WIDTH = 1000, 24, 640  # coordinates from side to side and around; pixels
STYLE = f"""<style>
.plate {{ fill: #d5e5f0; stroke: #222222; }} .stick {{ stroke: {STICK}; stroke-width: 5; }} .joint {{ stroke: #222222; }}
.force {{ stroke: {PALETTE[0]}; }} .rim {{ stroke: #222222; stroke-width: 11; }} .pin {{ stroke: #ffffff; stroke-width: 7; }}
@media (prefers-color-scheme: dark) {{
.plate {{ fill: #2c4a60; stroke: #e8eaed; }} .stick {{ stroke: #d9a06b; }} .joint, .rim {{ stroke: #e8eaed; }}
.force {{ stroke: #56b4e9; }} .pin {{ stroke: #15181c; }}
}}
</style>"""


def moving_svg(run, frames, seconds):
    """The text of an SVG of frames of a run, which begins again after so many seconds. Coordinates are rounded to a thousandth of the width."""
    symbols, low, high = plates.symbols_of(run, frames)
    size = max((high - low).max(), 1e-300)
    width, height = np.ceil((high - low) / size * UNITS).astype(int) + 2 * MARGIN
    lines = plates.curves(run.model)
    places = np.array([lines.places(run.node_positions(k)) for k in frames])
    sticks = np.array([plates.sticks(run, k) for k in frames])
    dots = np.stack([symbols.pins, symbols.pins], axis=2)  # lines without length, drawn with round ends
    kinds = {
        "plate": [places[:, loop] for loop in _loops(lines.edges)],
        "stick": _joined(sticks),
        "joint": _joined(symbols.joints),
        "force": _joined(symbols.forces),
        "rim": _joined(dots),
        "pin": _joined(dots),
    }

    def rounded(points):
        """Points (..., 2), m, as whole numbers of SVG units: scaled to the page, y downwards, with the margin added."""
        x, y = (points[..., 0] - low[0]) / size * UNITS, (high[1] - points[..., 1]) / size * UNITS
        return np.rint(np.stack([x, y], axis=-1)).astype(int) + MARGIN

    parts = []
    for kind, polylines in kinds.items():
        whole = [rounded(points) for points in polylines]
        parts.append(_path(kind, [points[:1] for points in whole if not np.ptp(points, axis=0).any()], 0.0))
        parts.append(_path(kind, [points for points in whole if np.ptp(points, axis=0).any()], seconds))
    begin = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{WIDTH}" height="{round(WIDTH * height / width)}"'
    )
    look = 'fill="none" fill-rule="evenodd" stroke-width="2.5" stroke-linecap="round" stroke-linejoin="round"'
    return "\n".join([f"{begin} {look}>", STYLE, *filter(None, parts), "</svg>\n"])


def _path(kind, polylines, seconds):
    """One path of polylines [(frames, points, 2) int], which moves if it has several frames."""
    if not polylines:
        return ""
    values = ["".join(_line(points[k], closed=kind == "plate") for points in polylines) for k in range(len(polylines[0]))]
    if len(values) == 1:
        return f'<path class="{kind}" d="{values[0]}"/>'
    moving = f'<animate attributeName="d" dur="{seconds:g}s" repeatCount="indefinite" values="{";".join(values)}"/>'
    return f'<path class="{kind}" d="{values[0]}">{moving}</path>'


def _line(points, closed):
    """A polyline (points, 2) int as commands of a path, relative to its first point."""
    steps = np.diff(points, axis=0)
    return f"M{points[0, 0]} {points[0, 1]}l" + " ".join(f"{x} {y}" for x, y in steps.tolist()) + "z" * closed


def _joined(segments):
    """Segments (frames, k, 2, 2) as polylines [(frames, points, 2)]: one that begins where the last ended goes on."""
    lines: list = []
    for k in range(segments.shape[1]):
        if lines and np.array_equal(segments[:, k, 0], lines[-1][-1]):
            lines[-1].append(segments[:, k, 1])
        else:
            lines.append([segments[:, k, 0], segments[:, k, 1]])
    return [np.stack(line, axis=1) for line in lines]


def _loops(edges):
    """Closed loops of boundary edges (k, 2), each a list of nodes."""
    after = dict(edges.tolist())
    loops = []
    while after:
        node, following = after.popitem()
        loop = [node]
        while following != loop[0] and following in after:
            loop.append(following)
            following = after.pop(following)
        loops.append(loop)
    return loops
