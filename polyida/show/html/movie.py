"""The motion of a run as an animation that plays in the page: its frames as small whole numbers, drawn by a script."""

import json
from base64 import b64encode
from dataclasses import dataclass, field
from html import escape

import numpy as np

from polyida.show import plates
from polyida.show.html.blocks import prose
from polyida.show.style import STICK, box, colour_top

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
        "colours": _colours(),
    }, top


def _packed(values, kind):
    return b64encode(np.rint(values).astype(kind).tobytes()).decode()


def _colours():
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0, 1, SHADES))]


def _key(colours, top):
    band = ", ".join(colours[::7])
    return f'<div class="scale">0 <span style="background: linear-gradient(90deg, {band})"></span> {top:.3g} kPa and more, von Mises stress</div>'
