"""Figures of studies: panels on logarithmic axes, reference slopes, and the pictures that a report takes."""

from dataclasses import replace
from functools import wraps

import numpy as np

from polyida.show.html import Picture
from polyida.show.styles import INK, PALETTE, figure, hollow_markers, marker_style, settings
from polyida.study.rows import positive


def panels(count, width=6.8, height=3.0, columns=2, **layout):
    """(figure, flat array of `count` axes) with at most `columns` side by side. Raises LookupError for count = 0."""
    if not count:
        raise LookupError("no rows to draw")
    columns = min(columns, count)
    rows = -(-count // columns)
    new, axes = figure(width, height * rows, nrows=rows, ncols=columns, squeeze=False, **layout)
    for unused in axes.ravel()[count:]:
        unused.set_visible(False)
    return new, axes.ravel()[:count]


def loglog(axes, x, y, i, label=None):
    """Draw the finite positive values of one line on two logarithmic axes."""
    axes.loglog(*positive(x, y), label=label, **marker_style(i))


def nested_style(colour, ring, rings, dash="-"):
    """Style of the `ring`-th of `rings` lines of one colour that may coincide: hollow markers of decreasing size."""
    return {"color": PALETTE[colour % len(PALETTE)], "linestyle": dash} | hollow_markers(ring, rings)


def slope_line(axes, slope, x, y, label=None, offset=(2, 2)):
    """Draw a thin line of the given slope through (x[0], y) over the range x, with its slope at the end; offset: of the text, points."""
    x = np.asarray(x, float)
    axes.loglog(x, y * (x / x[0]) ** slope, color=INK, linewidth=0.6, linestyle=(0, (2, 2)), zorder=0)
    axes.annotate(
        label or (f"{slope:+.3g}" if slope else "0"),
        (x[-1], y * (x[-1] / x[0]) ** slope),
        fontsize="small",
        color=INK,
        xytext=offset,
        textcoords="offset points",
        ha="right" if offset[0] < 0 else "left",
        va="top" if offset[1] < 0 else "bottom",
    )


def target_line(axes, y, label):
    """Draw a thin dashed line across the axes at y with a label at its left end."""
    axes.axhline(y, color="#777777", linewidth=0.8, linestyle=(0, (5, 3)), zorder=1)
    place = {"xycoords": ("axes fraction", "data"), "xytext": (3, 2), "textcoords": "offset points"}
    axes.annotate(label, (0, y), fontsize="small", color="#555555", **place)


def setting_label(kind, value):
    """A step, s, or a tolerance in a legend: "h = 2e-3", "rtol 1e-5"."""
    number, power = short_number(value).split("e")
    return f"{'h =' if kind == 'h' else kind} {number}e{int(power)}"


def short_number(value):
    """A number with at most two digits: "2e-03", "2.5e-03"."""
    number, power = f"{value:.1e}".split("e")
    return f"{number.removesuffix('.0')}e{power}"


def line_picture(figure, name, caption=""):
    """`picture` of a figure of lines. Logarithmic axes show at least two decades. Raises LookupError if no line has a point."""
    from matplotlib.ticker import NullFormatter

    if not any(len(line.get_xdata()) for axes in figure.axes for line in axes.get_lines() if line.get_label()[:1] != "_"):
        raise LookupError("no rows to draw")
    for axis in [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) if axis.get_scale() == "log"]:
        # widen a short axis until two decades are marked, and label only these: other labels would collide
        low, high = np.log10(axis.get_view_interval())
        while np.floor(high) - np.ceil(low) < 1:
            if np.floor(high) + 1 - high < low - np.ceil(low) + 1:
                high = np.floor(high) + 1
            else:
                low = np.ceil(low) - 1
        axis.axes.set(**{f"{axis.axis_name}lim": (10**low, 10**high)})
        axis.set_minor_formatter(NullFormatter())
    return picture(figure, name, caption)


def picture(figure, name, caption=""):
    """A figure in the form that the report of a study takes: a list of one Picture."""
    return [Picture(name, caption, figure)]


def study_figure(function):
    """Decorator of a study's function draw(rows) -> list of Picture.

    The function gets the rows without errors and is called with the plot settings of this package. A picture without a caption gets the first
    line of the function's docstring.
    """

    @wraps(function)
    def draw(rows):
        """Draw the rows that did not fail, and give each picture without a caption the first line of the docstring."""
        with settings():
            pictures = function([row for row in rows if not row.get("error")])
        caption = (function.__doc__ or "").strip().partition("\n")[0]
        return [one if one.caption else replace(one, caption=caption or one.name) for one in pictures]

    return draw
