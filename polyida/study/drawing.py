"""What the figures of all studies share: logarithmic panels, slopes beside the data, PNG and PDF of each figure."""

import numpy as np

from polyida.show.style import DASHES, INK, PALETTE, figure, save, settings

MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")


def panels(count, width=6.8, height=3.0, columns=2, **layout):
    """(figure, flat array of `count` axes), at most `columns` beside each other; those left over are hidden."""
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
    x, y = np.asarray(x, float), np.asarray(y, float)
    good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    axes.loglog(x[good], y[good], label=label, **look(i))


def slope_line(axes, slope, x, y, label=None):
    """A thin line of the given slope through (x[0], y) over the range x, with its slope written at the end."""
    x = np.asarray(x, float)
    axes.loglog(x, y * (x / x[0]) ** slope, color=INK, linewidth=0.6, linestyle=(0, (2, 2)), zorder=0)
    axes.annotate(
        label or f"{slope:+.3g}",
        (x[-1], y * (x[-1] / x[0]) ** slope),
        fontsize=7,
        color=INK,
        xytext=(2, 2),
        textcoords="offset points",
    )


def legend(made, axes, columns=4):
    """One legend above all panels, of the lines of all `axes`, each label once."""
    known = {}
    for axis in np.ravel(axes):
        known |= dict(zip(*reversed(axis.get_legend_handles_labels())))
    made.legend(known.values(), known, loc="outside upper center", ncols=columns)


def _whole_decades(axis):
    """Widen a short logarithmic axis to whole decades and keep labels to these: others run into each other."""
    from matplotlib.ticker import NullFormatter

    low, high = np.log10(axis.get_view_interval())
    if high - low < 2.2:
        axis.axes.set(**{f"{axis.axis_name}lim": (10 ** np.floor(low + 0.1), 10 ** np.ceil(high - 0.1))})
    axis.set_minor_formatter(NullFormatter())


def saved(made, folder, name):
    """Write a figure as PNG and PDF into the folder; returns both paths."""
    for axis in [axis for axes in made.axes for axis in (axes.xaxis, axes.yaxis) if axis.get_scale() == "log"]:
        _whole_decades(axis)
    return [save(made, folder / f"{name}.{kind}") for kind in ("png", "pdf")]


def drawn(function):
    """A study's `draw(rows, folder)`, run in the settings of this package's figures."""

    def draw(rows, folder):
        with settings():
            return function([row for row in rows if not row.get("error")], folder)

    return draw


def fitted(x, y):
    """Slope of log y over log x by least squares; NaN where there are fewer than two finite positive points."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    return float(np.polyfit(np.log(x[good]), np.log(y[good]), 1)[0]) if good.sum() > 1 else float("nan")
