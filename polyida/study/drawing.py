"""What the figures of all studies share: logarithmic panels, slopes beside the data, PNG and PDF of each figure."""

from dataclasses import replace
from functools import wraps

import numpy as np

from polyida.show.html import Picture
from polyida.show.style import DASHES, INK, MARKERS, PALETTE, figure, hollow, settings
from polyida.study.rows import positive


def panels(count, width=6.8, height=3.0, columns=2, **layout):
    """(figure, flat array of `count` axes), at most `columns` beside each other; those left over are hidden.

    LookupError where there is nothing to show.
    """
    if not count:
        raise LookupError("no rows to draw")
    columns = min(columns, count)
    rows = -(-count // columns)
    made, axes = figure(width, height * rows, nrows=rows, ncols=columns, squeeze=False, **layout)
    for extra in axes.ravel()[count:]:
        extra.set_visible(False)
    return made, axes.ravel()[:count]


def look(i):
    """Colour, dash and marker of the i-th of several lines."""
    return {
        "color": PALETTE[i % len(PALETTE)],
        "linestyle": DASHES[i // len(PALETTE) % len(DASHES)],
        "marker": MARKERS[i % len(MARKERS)],
        "markersize": 3.5,
        "linewidth": 1.0,
    }


def loglog(axes, x, y, i, label=None):
    """One line of finite positive values on two logarithmic axes."""
    axes.loglog(*positive(x, y), label=label, **look(i))


def nested(colour, ring, rings, dash="-"):
    """Look of the `ring`-th of `rings` lines that may lie on each other: hollow markers of falling size, nested."""
    return {"color": PALETTE[colour % len(PALETTE)], "linestyle": dash} | hollow(ring, rings)


def slope_line(axes, slope, x, y, label=None, beside=(2, 2)):
    """A thin line of the given slope through (x[0], y) over the range x; its slope is `beside` its end, points."""
    x = np.asarray(x, float)
    axes.loglog(x, y * (x / x[0]) ** slope, color=INK, linewidth=0.6, linestyle=(0, (2, 2)), zorder=0)
    axes.annotate(
        label or (f"{slope:+.3g}" if slope else "0"),
        (x[-1], y * (x[-1] / x[0]) ** slope),
        fontsize=7,
        color=INK,
        xytext=beside,
        textcoords="offset points",
        ha="right" if beside[0] < 0 else "left",
        va="top" if beside[1] < 0 else "bottom",
    )


def aim_line(axes, y, label):
    """A thin dashed line across the axes at y, with what it is written above its left end."""
    axes.axhline(y, color="#777777", linewidth=0.8, linestyle=(0, (5, 3)), zorder=1)
    axes.annotate(label, (0, y), xycoords=("axes fraction", "data"), xytext=(3, 2), textcoords="offset points", fontsize=7, color="#555555")


def legend(made, axes, columns=4):
    """One legend above all panels, of the lines of all `axes`, each label once."""
    known = {}
    for axis in np.ravel(axes):
        known |= dict(zip(*reversed(axis.get_legend_handles_labels())))
    if not known:
        raise LookupError("no rows to draw")
    made.legend(known.values(), known, loc="outside upper center", ncols=columns)


def tag(kind, value):
    """A step, s, or a tolerance in words of a legend: "h = 2e-3", "rtol 1e-5"."""
    number, power = digits(value).split("e")
    return f"{'h =' if kind == 'h' else kind} {number}e{int(power)}"


def digits(value):
    """A number by its first digit, or two where it has them: "2e-03", "2.5e-03"."""
    number, power = f"{value:.1e}".split("e")
    return f"{number.removesuffix('.0')}e{power}"


def curves(made, name, caption=""):
    """`picture` of a figure of lines. LookupError where none has a point."""
    from matplotlib.ticker import NullFormatter

    if not any(len(line.get_xdata()) for axes in made.axes for line in axes.get_lines() if line.get_label()[:1] != "_"):
        raise LookupError("no rows to draw")
    for axis in [axis for axes in made.axes for axis in (axes.xaxis, axes.yaxis) if axis.get_scale() == "log"]:
        # widen a short axis until two whole decades are marked; label these alone: others would collide
        low, high = np.log10(axis.get_view_interval())
        while np.floor(high) - np.ceil(low) < 1:
            if np.floor(high) + 1 - high < low - np.ceil(low) + 1:
                high = np.floor(high) + 1
            else:
                low = np.ceil(low) - 1
        axis.axes.set(**{f"{axis.axis_name}lim": (10**low, 10**high)})
        axis.set_minor_formatter(NullFormatter())
    return picture(made, name, caption)


def picture(made, name, caption=""):
    """A figure as a study's report takes it: a list of one Picture."""
    return [Picture(name, caption, made)]


def drawn(function):
    """A study's figure, `draw(rows)`, of the rows that did not fail, in the settings of this package.

    A picture without a caption has the first line of what the function says of itself.
    """

    @wraps(function)
    def draw(rows):
        with settings():
            made = function([row for row in rows if not row.get("error")])
        about = (function.__doc__ or "").strip().partition("\n")[0]
        return [picture if picture.caption else replace(picture, caption=about or picture.name) for picture in made]

    return draw
