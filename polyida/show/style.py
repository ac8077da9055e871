"""Look of all figures: fonts, the colour-blind-safe colours of Okabe and Ito, and how a figure is made and saved."""

from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np

INK, STICK = "#222222", "#8C5A2B"  # of lines and text, and of bodies without a mesh
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES = ("-", (0, (4, 1.6)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")
UPRIGHT = 2.4  # inches of a figure's side, below which the label of a colorbar would not fit along it in one line
SAVED = {"pdf": {"metadata": {"CreationDate": None}, "dpi": 400}, "svg": {"metadata": {"Date": None}}}  # dpi: of what is an image in a PDF
SETTINGS = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "legend.fontsize": 8,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "font.family": "DejaVu Sans",
    "mathtext.fontset": "dejavusans",
    "pdf.fonttype": 42,
    "ps.fonttype": 42,  # matplotlib 3.11 splits a PDF's fonts by this one: the minus sign would be embedded as a second font
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "polyida",
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.3,
    "legend.frameon": False,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.use_mathtext": True,
    "figure.autolayout": False,
    "figure.constrained_layout.use": False,
    "savefig.dpi": 200,  # two pixels for each of the 640 that a report shows
    "figure.dpi": 100,
}


def settings():
    """Context in which figures of this package are made and saved; nothing is left changed in matplotlib afterwards."""
    from matplotlib import rc_context

    return rc_context(SETTINGS)


def figure(width=6.4, height=3.6, **layout):
    """An empty Figure of this size in inches, belonging to no window and no global list, and its axes."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), layout="constrained")
    return made, made.subplots(**layout)


@contextmanager
def on_axes(axes=None):
    """matplotlib axes to draw on: those that are given, or new ones of pyplot, in the look of this package."""
    if axes is not None:
        yield axes
        return
    from matplotlib import pyplot

    with settings():
        yield pyplot.subplots(figsize=(6.4, 3.8), layout="constrained")[1]


def line(i):
    """Colour and dash of the i-th of several lines, so that they differ in print without colour as well."""
    return {"color": PALETTE[i % len(PALETTE)], "linestyle": DASHES[i % len(DASHES)]}


def hollow(i, count):
    """Hollow markers of the i-th of `count` lines that may lie on each other: the first the widest, so that every one is seen."""
    return {
        "marker": MARKERS[i % len(MARKERS)],
        "markersize": 2.5 + min(2.2, 8 / count) * (count - 1 - i),
        "markerfacecolor": "none",
        "markeredgewidth": 0.8,
        "linewidth": 0.8,
    }


def save(figure, path):
    """Write a figure to a file, its format given by the suffix; returns the path. Equal figures give equal files."""
    path = Path(path)
    path.write_bytes(rendered(figure, path.suffix[1:]))
    return path


def rendered(figure, kind):
    """The bytes of a figure's file of a kind, "png", "pdf" or "svg".

    What is laid out the first time stays so: the same figure of another kind has the same places.
    """
    file = BytesIO()
    with settings():
        lay_out(figure)
        figure.savefig(file, format=kind, **SAVED.get(kind, {}))
    return file.getvalue()


def lay_out(figure):
    """Settle the places of a figure's axes for good, its numbers in letters."""
    from polyida.show.labels import lettered

    lettered(figure)
    if engine := figure.get_layout_engine():
        to_scale = any(axes.get_aspect() != "auto" for axes in figure.axes)
        for _ in range(2 if to_scale else 1):  # where axes to scale come to lie shows only when the others have their place
            engine.execute(figure)
        figure.set_layout_engine(None)  # not "none": with that each drawing is made twice


def box(points):
    """Lower left and upper right corner of points (n, 2)."""
    return points.min(axis=0), points.max(axis=0)


def height_for(low, high, width, rest):
    """Height in inches of a figure whose axes, `width` inches wide, show a box to scale; `rest` is for labels."""
    return float(np.clip(width * (high - low)[1] / max((high - low)[0], 1e-300) + rest, 1.4, 1.05 * width))


def scaled(low, high, width, keyed):
    """As `figure`, so wide and as high as a box to scale is, and where its colours are explained: "right", or "bottom" if it is too low for
    the label of a colorbar. keyed: whether there is one at all.
    """
    height = height_for(low, high, 0.82 * width, 0.6)
    side = "right" if height > UPRIGHT else "bottom"
    return *figure(width, height + 0.7 * (keyed and side == "bottom")), side


def stress_key(made, axes, drawn, side):
    """A colorbar of von Mises stress on a side of the axes."""
    look = {"shrink": 0.8, "pad": 0.02} if side == "right" else {"shrink": 0.9, "pad": 0.04, "aspect": 30}
    label = "von Mises stress, kPa" if made.get_figwidth() > UPRIGHT else "von Mises\nstress, kPa"
    made.colorbar(drawn, ax=axes, location=side, extend="max", **look).set_label(label)


def equal(axes, low, high, margin=0.04):
    """Show a box to scale, with a margin relative to its longer side and without a grid."""
    margin = margin * (high - low).max()
    low, high = low - margin, high + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.grid(False)


def colour_top(values):
    """Upper end of a colour scale over several arrays: one element at a corner must not darken all others."""
    found = np.concatenate(values)
    return max(float(np.quantile(found, 0.995)) if found.size else 0.0, 1e-12)


def plain(text):
    """A name as matplotlib is to write it letter by letter: a dollar begins no formula."""
    return str(text).replace("$", r"\$")
