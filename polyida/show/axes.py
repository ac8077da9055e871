"""What keeps the texts of one axes apart at the width of a column: its legend and title above it, ticks of logarithmic axes, and labels of points."""

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
NEAR_DIRECTIONS = 8  # around a point, in which its label is tried
NEAR_DISTANCES = (9.0, 18.0, 28.0, 40.0, 54.0)  # points
LINE_FROM = 20.0  # points: labels that are farther off have a line to their point


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
    columns = int(room / (HANDLE + LETTER * max(map(len, names))))
    columns = max(1, min(columns, len(names)))
    above = POWER_HEIGHT if _has_power(axes.yaxis) else 0.3
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": above}
    look = {"frameon": False, "handlelength": 1.8, "columnspacing": 1.2, "labelspacing": 0.25}
    legend = axes.legend(handles, names, ncols=columns, **place, **look)
    return legend.get_window_extent().height / axes.figure.dpi * POINTS + above * size


def _has_power(axis):
    """True if a power of ten stands above the axis."""
    formatter = axis.get_major_formatter()
    formatter.format_ticks(axis.get_majorticklocs())
    return bool(formatter.get_offset())


def tidy_ticks(axes):
    """Label decades on logarithmic axes; of less than two decades also 2 and 5 times them, two ticks at least."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            _tidy_log(axis)


def _tidy_log(axis):
    from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
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


def place_labels(axes, labels, optional=False, **look):
    """Write texts near their points so that no two overlap.

    labels: [(point (2,) in data coordinates, text)], those placed first before. optional: texts without a free place nearby are left out;
    else they are farther from their point, with a line to it. The layout of the figure must not change afterwards: it is computed here.
    """
    axes.figure.draw_without_rendering()
    taken = []
    angles = np.pi / 4 + 2 * np.pi * np.arange(NEAR_DIRECTIONS) / NEAR_DIRECTIONS
    for point, text in labels:
        for distance in NEAR_DISTANCES[:2] if optional else NEAR_DISTANCES:
            made = _free_label(axes, point, text, distance, angles, taken, look)
            if made is not None:
                taken.append(made)
                break
        else:
            if not optional:
                taken.append(_label(axes, point, text, NEAR_DISTANCES[-1], angles[0], look)[1])


def _free_label(axes, point, text, distance, angles, taken, look):
    """The box of a label at the first angle at which it overlaps none of `taken`; None if there is none."""
    for angle in angles:
        drawn, box = _label(axes, point, text, distance, angle, look)
        if not any(box.overlaps(other) for other in taken):
            return box
        drawn.remove()
    return None


def _label(axes, point, text, distance, angle, look):
    """(annotation, its box in pixels) at a distance in points from a point."""
    from matplotlib.text import Text

    sideways, upward = np.cos(angle), np.sin(angle)
    horizontal = "center" if abs(sideways) < 0.3 else "left" if sideways > 0 else "right"
    vertical = "center" if abs(upward) < 0.3 else "bottom" if upward > 0 else "top"
    line = {"arrowstyle": "-", "linewidth": 0.4, "color": INK, "shrinkA": 0.0, "shrinkB": 2.0} if distance > LINE_FROM else None
    drawn = axes.annotate(
        literal(text),
        point,
        xytext=(0.7 * distance * sideways, 0.7 * distance * upward),
        textcoords="offset points",
        ha=horizontal,
        va=vertical,
        arrowprops=line,
        annotation_clip=False,
        **{"fontsize": "small", "color": INK} | look,
    )
    drawn.get_window_extent()  # places the text
    return drawn, Text.get_window_extent(drawn)  # without its line
