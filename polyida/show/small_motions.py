"""Pictures of small motions: shapes of modes on the bodies at rest, and amplitude and phase against frequency."""

import numpy as np

from polyida.show import plates
from polyida.show.style import INK, PALETTE, STICK, box, equal, figure, height_for, line, plain, settings

VISIBLE = 0.12  # of the size of what is drawn: the largest displacement of a shape
FINE = 2000  # cells beyond which their edges would hide them
LITTLE = 1e-5  # of the extent: a part of a shape that tells how far it moves what is drawn
NOTHING = 1e-12  # of the largest amplitude: what is less is round-off
REST, MOVED = "#9A9A9A", "#D5E5F0"


def shapes(model, q, modes, scale=1.0):
    """A Figure of several modes, a panel each, all of one size; modes: a list of (title, shape x (n,)). See `draw`."""
    with settings():
        columns = min(2, len(modes))
        rows, width = -(-len(modes) // columns), 6.4 if columns > 1 else 5.0
        around = _around([_ends(model, q, x, scale) for _, x in modes]) if model.is_scene else None
        height = height_for(*around, 0.85 * width / columns, 0.7) if around else 2.0
        made, axes = figure(width, rows * height + 0.25, nrows=rows, ncols=columns, squeeze=False)
        for (title, x), panel in zip(modes, axes.ravel()):
            draw(panel, model, q, x, title, scale, around)
        for panel in axes.ravel()[len(modes) :]:
            panel.set_visible(False)
        if around:
            made.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return made


def draw(axes, model, q, x, title, scale=1.0, around=None):
    """One shape on matplotlib axes: outlines at rest, grey, and what the shape x makes of them, its largest displacement `scale` times
    VISIBLE of the size of the whole; complex shapes as they are when their first large entry is. Models without bodies as bars, an
    entry each. around: corners of what is shown, (2, 2), m.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.ticker import MaxNLocator

    axes.set_title(plain(title))
    if not model.is_scene:
        axes.bar(np.arange(len(x)), np.real(x), color=PALETTE[0])
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(xlabel="coordinate", ylabel="shape", ylim=1.1 * np.array([-1, 1]) * np.abs(x).max())
        return
    rest, moved = _ends(model, q, x, scale)
    axes.plot([], [], color=REST, label="at rest")
    axes.plot([], [], color=INK, label="in the mode, not to scale")
    if model.drawn:
        _cells(axes, model, rest[0], moved[0])
    axes.add_collection(LineCollection(rest[1], colors=REST, linewidths=0.8, linestyles="--"))
    axes.add_collection(LineCollection(moved[1], colors=STICK, linewidths=1.6, capstyle="round"))
    equal(axes, *(around or _around([(rest, moved)])))


def response(frequencies, values, name, outputs):
    """A Figure of amplitude, logarithmic, and phase, degrees, of complex values (k, outputs) at frequencies (k,), Hz."""
    with settings():
        made, (upper, lower) = figure(6.4, 4.2, nrows=2, sharex=True, height_ratios=[1.6, 1])
        size = np.abs(np.where(np.isfinite(values), values, np.nan))
        seen = size > NOTHING * np.nanmax(size, initial=0.0)
        for i, label in enumerate(outputs):
            label = plain(label) if seen[:, i].any() else f"{plain(label)} (none)"
            upper.plot(frequencies, np.where(seen[:, i], size[:, i], np.nan), label=label, **line(i))
            lower.plot(frequencies, np.where(seen[:, i], np.degrees(np.angle(values[:, i])), np.nan), **line(i))
        if seen.any():
            upper.set_yscale("log")
        upper.set(ylabel=f"output over {plain(name)}")
        lower.set(xlabel="frequency, Hz", ylabel="phase, degrees", ylim=(-190, 190), yticks=[-180, -90, 0, 90, 180])
        made.legend(*upper.get_legend_handles_labels(), loc="outside upper center", ncols=min(4, len(outputs)))
        return made


def _places(model, q):
    """(nodes that are drawn, (nodes, 2); segments of bodies without a mesh, (segments, 2, 2)), m."""
    return model.drawn_points + model.nodal(q), model.sticks(q)


def _all(places):
    return np.concatenate([places[0], places[1].reshape(-1, 2)])


def _ends(model, q, x, scale):
    """The places at rest and, by a visible part of the shape x, moved."""
    rest = _places(model, q)
    x = np.real(x) * (LITTLE * model.extent / np.abs(x).max())
    largest = np.hypot(*(_all(_places(model, q + x)) - _all(rest)).T).max() or 1.0
    size = float(np.linalg.norm(np.ptp(_all(rest), axis=0))) or 1.0
    return rest, _places(model, q + scale * VISIBLE * size / largest * x)


def _around(pairs):
    """Corners of all that is drawn in (rest, moved) pairs."""
    return box(np.concatenate([_all(places) for pair in pairs for places in pair]))


def _cells(axes, model, rest, moved):
    from matplotlib.collections import LineCollection, PolyCollection

    cells = plates.polygons(model, moved)
    fine = len(cells) > FINE
    look = {"edgecolors": MOVED, "linewidths": 0.1} if fine else {"edgecolors": PALETTE[0], "linewidths": 0.3}
    axes.add_collection(PolyCollection(cells, facecolors=MOVED, rasterized=fine, **look))
    axes.add_collection(LineCollection(plates.outlines(model, rest), colors=REST, linewidths=0.8))
    axes.add_collection(LineCollection(plates.outlines(model, moved), colors=INK, linewidths=0.7))
