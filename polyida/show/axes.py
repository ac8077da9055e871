"""What keeps the texts of one axes apart at the width of a column: its legend and title above it, ticks of logarithmic axes, names of places."""

import numpy as np

from polyida.errors import InputError
from polyida.reprs import cut
from polyida.show.styles import FAILED, INK, literal
from polyida.validation import instance

LETTER = 0.55  # mean width of a letter, of the font's size
HANDLE = 4.2  # width of a line in a legend with the spaces around it, of the font's size
POINTS = 72.0  # in an inch
POWER_HEIGHT = 1.5  # sizes of the font that a power of ten above an axis takes
GAP = 4.0  # points between legend and title
AROUND = ((1, 1), (-1, 1), (1, -1), (-1, -1), (1, 0), (-1, 0), (0, 1), (0, -1))  # where a name may stand beside its place
DISTANCES = (5.0, 13.0, 22.0)  # points from its place to its name


def finish(axes, title=None, labels=None, ending="", part="plot"):
    """Put the legend above the axes, the title above it, and tidy logarithmic ticks.

    labels: {label of a line: what the legend shows}. ending: how the run failed, or empty. Raises InputError in the name of `part` for a title
    or labels of another type, or of an unknown line.
    """
    tidy_ticks(axes)
    handles, names = axes.get_legend_handles_labels()
    names = _renamed(part, names, labels)
    height = _legend(axes, handles, names) if handles else 0.0
    if title is not None:
        axes.set_title(literal(instance(part, "title", title, str)), pad=height + GAP)
    if ending:
        axes.set_title(literal(ending), color=FAILED, loc="right", pad=height + GAP)
    return axes


def _renamed(part, names, labels):
    """The names of the legend with those replaced that the user's `labels` has. Raises InputError for an unknown line."""
    if labels is None:
        return names
    instance(part, "labels", labels, dict)
    for label, shown in labels.items():
        if literal(label) not in names:
            raise InputError(f"{part}: labels has {label!r:.60}, which is no line; lines are {', '.join(map(repr, names))}")
        if not isinstance(shown, str):
            raise InputError(f"{part}: labels[{label!r:.60}] = {shown!r:.60} must be a text")
    return [labels.get(name.replace(r"\$", "$"), name) for name in names]


def _legend(axes, handles, names):
    """Put the legend above the axes, in as many columns as fit; returns its height in points."""
    from matplotlib import rcParams
    from matplotlib.font_manager import FontProperties

    size = FontProperties(size=rcParams["legend.fontsize"]).get_size_in_points()
    box = axes.get_window_extent()
    room = box.width / axes.figure.dpi * POINTS / size  # in sizes of the font
    longest = int((room - HANDLE) / LETTER)
    names = [cut(name, max(8, longest)) for name in names]
    columns = _fitting_columns(names, room)
    above = POWER_HEIGHT if _has_power(axes.yaxis) else 0.3
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": above}
    look = {"frameon": False, "handlelength": 1.8, "columnspacing": 1.2, "labelspacing": 0.25}
    legend = axes.legend(handles, names, ncols=columns, **place, **look)
    return legend.get_window_extent().height / axes.figure.dpi * POINTS + above * size


def _fitting_columns(names, room):
    """The largest number of columns that fit; a column is as wide as its longest name."""
    for columns in range(len(names), 1, -1):
        longest = [max(map(len, column)) for column in np.array_split(np.array(names, dtype=object), columns)]
        if sum(HANDLE + LETTER * length for length in longest) <= room:
            return columns
    return 1


def _has_power(axis):
    """True if matplotlib writes a common power of ten above the axis."""
    formatter = axis.get_major_formatter()
    formatter.format_ticks(axis.get_majorticklocs())
    return bool(formatter.get_offset())


def tidy_ticks(axes):
    """Label decades on logarithmic axes; of less than two decades also 2 and 5 times them, two ticks at least."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            _tidy_log(axis)


def _tidy_log(axis):
    """Put ticks of a logarithmic axis on decades, or on 1, 2 and 5 times them where the axis has less than two decades."""
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

    low, high = sorted(axis.get_view_interval())
    if low <= 0.0:  # nothing is drawn
        return
    decades = np.floor(np.log10(high)) - np.ceil(np.log10(low))
    axis.set_minor_formatter(NullFormatter())
    if decades >= 1:
        axis.set_major_locator(LogLocator())
        return
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(LogFormatterSciNotation(labelOnlyBase=False, minor_thresholds=(np.inf, np.inf)))
    marks = np.outer(10.0 ** np.arange(np.floor(np.log10(low)) - 1, np.log10(high) + 2), (1.0, 2.0, 5.0)).ravel()
    if np.count_nonzero((marks >= low) & (marks <= high)) < 2:
        low = min(low, marks[marks <= low].max())
        high = max(high, marks[marks >= high].min())
        axis.axes.set(**{f"{axis.axis_name}lim": (low, high)})


def place_labels(axes, labels, required=True, lines=None):
    """Write texts beside their places where they cover neither each other nor another place, and stay within the axes.

    labels: [(place (2,), in data, text, direction (2,) in which the text should be, or None)], the most important first. required: False leaves
    out what finds no room close to its place. lines: segments (k, 2, 2), in data, of which texts cover as little as they can. Call it when all
    else is drawn.
    """
    from matplotlib.patheffects import withStroke

    figure = axes.figure.canvas.figure
    for _ in range(2) if figure.get_layout_engine() else ():  # the layout decides where places are; axes to scale move in a second one
        figure.get_layout_engine().execute(figure)
    axes.apply_aspect()
    anchors, size = axes.transData.transform([place for place, *_ in labels]), figure.dpi / POINTS
    ends = np.zeros((0, 2, 2)) if lines is None else axes.transData.transform(lines.reshape(-1, 2)).reshape(-1, 2, 2)
    drawn = _points_along(ends, 0.25 * size)
    taken: list = []
    halo = [withStroke(linewidth=2.0, foreground="white")]
    for k, (place, text, direction) in enumerate(labels):
        others = [anchor for i, anchor in enumerate(anchors) if i != k]
        look = {"textcoords": "offset points", "color": INK, "fontsize": "small", "annotation_clip": False, "path_effects": halo}
        label = axes.annotate(literal(text), place, xytext=(0, 0), **look)
        best, least = None, np.inf  # offset, and how many of the drawn points it covers
        for offset in _offsets(direction, DISTANCES if required else DISTANCES[:1]):
            box = _moved(label, offset)
            covered = _inside(box, drawn) if _is_free(box, taken, others, axes.bbox) else np.inf
            if covered < least:
                best, least = offset, covered
            if least == 0:
                break
        if best:
            taken.append(_moved(label, best).padded(size))
        elif not required:
            label.remove()
        else:
            taken.append(label.get_window_extent())


def _offsets(direction, distances):
    """Offsets (x, y) in points from a place to its text: the nearest first, and of these first where a direction points."""
    sides = AROUND if direction is None else sorted(AROUND, key=lambda side: -np.dot(side, direction) / np.hypot(*side))
    return [(distance * x, distance * y) for distance in distances for x, y in sides]


def _moved(label, offset):
    """The box of a label after it is moved to an offset from its place."""
    x, y = np.sign(offset).astype(int)
    label.xyann = offset
    label.set(ha=("center", "left", "right")[x], va=("center", "bottom", "top")[y])
    return label.get_window_extent()


def _points_along(segments, step):
    """Points (points, 2) on segments (k, 2, 2), at most a step apart."""
    begin, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    counts = np.ceil(np.hypot(*way.T) / step).astype(int)
    numbers = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.repeat(begin, counts, axis=0) + np.repeat(way, counts, axis=0) * ((numbers + 0.5) / np.repeat(counts, counts))[:, None]


def _inside(box, points):
    """Number of the points (points, 2) in a box."""
    return np.count_nonzero(np.all((points > box.min) & (points < box.max), axis=1))


def _is_free(box, taken, points, page):
    """True if a box is within the page, overlaps none of the taken boxes and contains none of the points; all in pixels."""
    inside = box.x0 >= page.x0 and box.x1 <= page.x1 and box.y0 >= page.y0 and box.y1 <= page.y1
    return inside and not any(box.overlaps(other) for other in taken) and not any(box.contains(*point) for point in points)
