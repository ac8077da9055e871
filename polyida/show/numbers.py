"""The numbers behind a figure, taken from what is drawn: columns, and the same as CSV."""

import re
from itertools import zip_longest

import numpy as np

DIGITS = ".9g"


def columns(figure):
    """[(heading, values)] of the lines, points, segments and polygons of a figure. x is there once where lines of a panel share it.

    Where a panel has lines or points with labels, those without are frames and guides, and left out.
    """
    panels = [(axes, _series(axes)) for axes in figure.axes]
    panels, found = [(axes, series) for axes, series in panels if series], []
    for axes, series in panels:
        panel, known = f"{_title(axes)}: " if len(panels) > 1 else "", None
        x = next((other.get_xlabel() for other in axes.get_shared_x_axes().get_siblings(axes) if other.get_xlabel()), "x")
        for label, names, values in series:
            own = list(zip([x, *names], values, strict=True))[known is not None and np.array_equal(known, values[0], equal_nan=True) :]
            first, known = known is None, values[0]
            found += [(panel + _heading(name, "" if first and name == x else label), column) for name, column in own]
    return found


def csv(figure):
    """The columns of a figure as CSV, a heading above each; columns that are shorter end in empty fields."""
    found = columns(figure)
    head = ",".join('"{}"'.format(heading.replace('"', '""')) for heading, _ in found)
    rows = zip_longest(*([_number(value) for value in np.asarray(values, float)] for _, values in found), fillvalue="")
    return "\n".join([head, *map(",".join, rows)]) + "\n"


def _number(value):
    return "" if value != value else format(value, DIGITS)


def _title(axes):
    return _words(next(filter(None, map(axes.get_title, ("left", "center", "right"))), axes.get_ylabel()))


def _heading(name, label):
    return f"{_words(name)} ({label})" if label else _words(name)


def _words(label):
    """A label in one line, without the signs of matplotlib's formulas; a dollar that `plain` wrote as one is one."""
    return re.sub(r"(\\\$)|[$\\]", lambda found: "$" if found[1] else "", label.replace("\n", " "))


def _series(axes):
    """[(label, names of the columns after x, [x, ...])] of what a panel shows in its own coordinates."""
    lines = [line for line in axes.get_lines() if line.get_transform() == axes.transData and len(line.get_xdata())]
    found = [(line.get_label(), [axes.get_ylabel()], [_floats(line.get_xdata()), _floats(line.get_ydata())]) for line in lines]
    found += [(artist.get_label(), *_collected(artist, axes)) for artist in axes.collections]
    found = [(label, names, values) for label, names, values in found if values]
    named = [(_words(label), names, values) for label, names, values in found if label and label[0] != "_"]
    return named or [("", names, values) for _, names, values in found if len(names) == 1]


def _floats(values):
    return np.asarray(np.ma.filled(np.ma.asarray(values, float), np.nan))


def _collected(artist, axes):
    """(names, values) of points, or of the corners of segments and polygons with the number of each and its value."""
    from matplotlib.collections import LineCollection, PathCollection, PolyCollection

    vertical = axes.get_ylabel() or "y"
    if isinstance(artist, PathCollection):
        return [vertical], list(_floats(artist.get_offsets()).T) if len(artist.get_offsets()) else []
    if not isinstance(artist, LineCollection | PolyCollection) or not artist.get_paths():
        return [], []
    closed = isinstance(artist, PolyCollection)
    corners = [path.vertices[:-1] if closed else path.vertices for path in artist.get_paths()]
    counts = [len(place) for place in corners]
    values = [*np.concatenate(corners).T, np.repeat(np.arange(len(counts)), counts)]
    if artist.get_array() is None:
        return [vertical, "number"], values
    quantity = next((bar.ax.get_ylabel() or bar.ax.get_xlabel() for bar in (other.colorbar for other in axes.collections) if bar), "value")
    return [vertical, "number", quantity], [*values, np.repeat(_floats(artist.get_array()), counts)]
