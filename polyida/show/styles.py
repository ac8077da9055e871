"""Style of all figures: fonts, colours, line styles, layout and files. The colours are those of Okabe and Ito, safe for colour-blind readers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from polyida.errors import InputError
from polyida.files import disk_errors, write_file
from polyida.validation import instance, is_whole, one_of, path_of, positive

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE_FILE = Path(__file__).parent / "templates" / "polyida.mplstyle"
PAPER_FILE = Path(__file__).parent / "templates" / "paper.mplstyle"
WIDTHS = {"paper": 3.3, "screen": 6.4}  # inches, of new figures
HEIGHTS = {"paper": 2.3, "screen": 3.8}
PAGE_WIDTH = 6.9  # of a figure across two columns
_CHOSEN: ContextVar[str] = ContextVar("_CHOSEN", default="")  # the style of a `with` around; empty: none
INK, STICK, MARK = "#222222", "#8C5A2B", "#555555"  # lines and text; bodies without a mesh; marks of events
FAILED = "#B00020"  # the end of a run that failed, and cases that failed
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES = ("-", (0, (4, 1.6)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")
LOW_FIGURE = 2.4  # inches: the label of a colorbar does not fit along a shorter side
SAVE_OPTIONS: dict[str, dict[str, Any]] = {
    "pdf": {"metadata": {"CreationDate": None}, "dpi": 400},
    "svg": {"metadata": {"Date": None}},
}  # dpi of images in a PDF


def settings() -> AbstractContextManager:
    """Use the matplotlib settings of this package in a `with`; those of `style("paper")` stay within it.

    Returns
    -------
    context : context manager
        It restores the settings at its end.
    """
    from matplotlib import rc_context

    return nullcontext() if _CHOSEN.get() else rc_context(fname=STYLE_FILE)


@contextmanager
def style(name: str = "paper", columns: int = 1) -> Iterator[None]:
    """Use the matplotlib settings of a journal or of the screen in a `with`, for pictures of this package and for others.

    Parameters
    ----------
    name : {"paper", "screen"}
        "paper": text of 7 and 8 points, thin lines, and new figures as wide as a column. "screen": the style of the reports.
    columns : {1, 2}
        Of "paper": width of new figures in columns, 3.3 or 6.9 inches.

    Yields
    ------
    None
        The settings before are restored at the end.

    Raises
    ------
    InputError
        For another name or number of columns.
    """
    from matplotlib import rc_context, rc_params_from_file, rcParams

    one_of("style", "name", name, WIDTHS)
    if not is_whole(columns, least=1, most=2):
        raise InputError(f"style: columns = {columns!r:.100} must be 1 or 2")
    if name == "screen" and columns != 1:
        raise InputError(f"style: columns = {columns!r} is of 'paper'; the screen has none")
    width = WIDTHS[name] if columns == 1 else PAGE_WIDTH
    with rc_context(fname=STYLE_FILE):
        rcParams.update(rc_params_from_file(PAPER_FILE, use_default_template=False) if name == "paper" else {})
        rcParams["figure.figsize"] = (width, HEIGHTS[name])
        token = _CHOSEN.set(name)
        try:
            yield
        finally:
            _CHOSEN.reset(token)


def figure(width: float = 6.4, height: float = 3.6, **layout: Any) -> tuple[Figure, Any]:
    """Create a figure in the layout of this package.

    Parameters
    ----------
    width, height : float, inch
    **layout
        Arguments of `Figure.subplots`, such as nrows and ncols.

    Returns
    -------
    figure : Figure
        A figure without a window.
    axes : Axes or array of Axes
        Its axes.
    """
    from matplotlib.figure import Figure

    width, height = positive("figure", "width", width, "inches"), positive("figure", "height", height, "inches")
    new = Figure(figsize=(width, height), layout="constrained")
    return new, new.subplots(**layout)


def figure_width(usual: float) -> float:
    """Width in inches of a new figure: that of the `style` around, or the usual one."""
    from matplotlib import rcParams

    return float(rcParams["figure.figsize"][0]) if _CHOSEN.get() else usual


@contextmanager
def on_axes(axes: Axes | None = None) -> Iterator[Axes]:
    """Context that gives the axes to draw on: `axes`, or new pyplot axes in the style of this package if `axes` is None."""
    if axes is not None:
        yield require_axes(axes)
        return
    from matplotlib import pyplot

    with settings() if _CHOSEN.get() else style("screen"):
        yield pyplot.subplots(layout="constrained")[1]


def require_axes(axes: Any) -> Axes:
    """Return matplotlib axes unchanged. Raises InputError for anything else."""
    from matplotlib.axes import Axes

    return instance("plot", "axes", axes, Axes)


def line_style(i: int) -> dict:
    """Colour and dash of the i-th line; lines also differ in print without colour."""
    return {"color": PALETTE[i % len(PALETTE)], "linestyle": DASHES[i % len(DASHES)]}


def marker_style(i: int) -> dict:
    """Colour, dash and marker of the i-th line through measured points."""
    return {"color": PALETTE[i % len(PALETTE)], "linestyle": DASHES[i // len(PALETTE) % len(DASHES)], "marker": MARKERS[i % len(MARKERS)]}


def hollow_markers(i: int, count: int) -> dict:
    """Return keyword arguments of `plot`, {name: value}, for hollow markers of the i-th (from 0) of `count` lines that may coincide.

    The first markers are the largest, so all lines stay visible.
    """
    return {
        "marker": MARKERS[i % len(MARKERS)],
        "markersize": 2.5 + min(2.2, 8 / count) * (count - 1 - i),
        "markerfacecolor": "none",
        "markeredgewidth": 0.8,
        "linewidth": 0.8,
    }


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure to a file, whose suffix selects the format.

    Parameters
    ----------
    figure : Figure
    path : str or Path
        The suffix is the format: .png, .pdf or .svg.

    Returns
    -------
    path : Path
        The file; equal figures give equal files.
    """
    from matplotlib.figure import Figure

    instance("save", "figure", figure, Figure)
    path = path_of("save", "path", path)
    if path.suffix[1:].lower() not in figure.canvas.get_supported_filetypes():
        raise InputError(f"save: {str(path)!r:.100} must end in .png, .pdf or .svg")
    with disk_errors(f"figure {path}"):
        write_file(path, rendered(figure, path.suffix[1:]))
    return path


def rendered(figure: Figure, kind: str) -> bytes:
    """The content of a figure's file of kind "png", "pdf" or "svg". The first call fixes the layout for all kinds."""
    file = BytesIO()
    with settings():
        finish_layout(figure)
        figure.savefig(file, format=kind, **SAVE_OPTIONS.get(kind, {}))
    return file.getvalue()


def finish_layout(figure):
    """Compute the layout once and fix it. Tick labels become unicode text: matplotlib needs 40 % of the drawing time to parse formulas."""
    from matplotlib.ticker import LogFormatterSciNotation, ScalarFormatter

    class UnicodeText:
        def __call__(self, x, pos=None):
            """The text of the tick at x, in unicode in place of a formula."""
            return unicode_number(super().__call__(x, pos))

        def get_offset(self):
            """The text of the offset or common power of ten of the axis, in unicode in place of a formula."""
            return unicode_number(super().get_offset())

    for axis in [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]:
        for formatter in (axis.get_major_formatter(), axis.get_minor_formatter()):
            if type(formatter) in (ScalarFormatter, LogFormatterSciNotation):
                formatter.__class__ = type("Unicode", (UnicodeText, type(formatter)), {})
    if engine := figure.get_layout_engine():
        to_scale = any(axes.get_aspect() != "auto" for axes in figure.axes)
        for _ in range(2 if to_scale else 1):  # axes to scale move when the other axes have their place
            engine.execute(figure)
        figure.set_layout_engine(None)  # not "none": with that each drawing is made twice


def unicode_number(formula):
    """A tick label of matplotlib as unicode text: r"$\\mathdefault{2\\times10^{-5}}$" gives "2×10⁻⁵"."""
    if not formula.startswith("$"):
        return formula
    superscripts = str.maketrans("0123456789-−", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁻")
    text = re.sub(r"\^\{([-−]?\d+)\}", lambda power: power[1].translate(superscripts), formula)
    return text.replace(r"\mathdefault", "").replace(r"\times", "×").translate(str.maketrans("-", "−", "${}"))


def literal(text: object) -> str:
    """A label that matplotlib shows unchanged: a dollar sign starts no formula."""
    return str(text).replace("$", r"\$")


def bounds(points):
    """Lower left and upper right corner of points (n, 2)."""
    return points.min(axis=0), points.max(axis=0)


def height_to_scale(low, high, width, margin):
    """Height of a figure in inches whose axes show a box to scale. width: of the axes; margin: height of labels, both in inches."""
    return float(np.clip(width * (high - low)[1] / max((high - low)[0], 1e-300) + margin, 1.4, 1.05 * width))


def figure_to_scale(low, high, width, colorbar):
    """(figure, axes, side of the colorbar) for a box to scale; the colorbar is at the bottom of low figures, else on the right."""
    height = height_to_scale(low, high, 0.82 * width, 0.6)
    side = "right" if height > LOW_FIGURE else "bottom"
    return *figure(width, height + 0.7 * (colorbar and side == "bottom")), side


def stress_colorbar(figure, axes, cells, side):
    """Add the colorbar of von Mises stress on a side of the axes."""
    options = {"shrink": 0.8, "pad": 0.02} if side == "right" else {"shrink": 0.9, "pad": 0.04, "aspect": 30}
    label = "von Mises stress, kPa" if figure.get_figwidth() > LOW_FIGURE else "von Mises\nstress, kPa"
    figure.colorbar(cells, ax=axes, location=side, extend="max", **options).set_label(label)


def show_to_scale(axes, low, high, margin=0.04):
    """Show a box to scale without a grid; margin: relative to the longer side."""
    margin = margin * (high - low).max()
    low, high = low - margin, high + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.grid(False)


def colour_limit(values):
    """Upper end of the colour scale of several arrays: their 99.5 % quantile, so that one element at a corner does not darken all others."""
    values = np.concatenate(values)
    return max(float(np.quantile(values, 0.995)) if values.size else 0.0, 1e-12)


def legend_above(figure, axes, columns=None):
    """One legend above all panels of the labelled lines of `axes`, each label once; columns: as many as fit if None."""
    known = {label: handle for axis in np.ravel(axes) for handle, label in zip(*axis.get_legend_handles_labels())}
    if not known:
        raise LookupError("no rows to draw")
    room = int(100 * figure.get_figwidth() / 6.4)  # 100 characters in 6.4 inches, 8 for each line
    labels = [label if len(label) <= room - 8 else f"{label[: room - 9]}…" for label in known]
    fitting = room // (max(map(len, labels)) + 8)
    figure.legend(known.values(), labels, loc="outside upper center", ncols=columns or max(1, min(len(known), fitting)))
