"""Geometry of the bodies in each frame of a run; drawings of meshes and of scenes before a run; figures of vibration modes. Positions are in m."""

import numpy as np

from polyida.errors import InputError
from polyida.reprs import cut
from polyida.results.curves import curves_of, curves_of_mesh
from polyida.show.axes import place_labels
from polyida.show.mechanism import SYMBOL, symbols
from polyida.show.styles import (
    INK,
    PALETTE,
    STICK,
    bounds,
    figure,
    figure_width,
    height_to_scale,
    legend_above,
    line_style,
    literal,
    require_axes,
    settings,
    show_to_scale,
)
from polyida.validation import flag, is_whole, positive

EVENT_FRAMES, EVENT_TEXT = 5, 30  # frames that show the name of an event; characters of names
AMPLITUDE = 0.12  # largest displacement of a drawn shape, relative to the size of the scene
MOST_FRAMES = 10**6  # of an animation or a picture
MAX_EDGES = 2000  # cells; edges of more cells would hide them
PROBE = 1e-5  # of the extent: displacement from which the scale of a shape is measured
ROUND_OFF = 1e-12  # amplitudes below this part of the largest are not drawn
REST, MOVED = "#9A9A9A", "#D5E5F0"
FORCE = PALETTE[0]  # of springs, dampers, loads
ABOVE = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": 4}  # a legend
ONE_COLUMN = 4.5  # inches; narrower figures have their panels below each other
NEAR = 0.02  # of the size of a scene: parts that are closer share a label


def require_run(part, run, overwrite):
    """Raise InputError in the name of `part` unless `run` is a run with frames and `overwrite` is True or False."""
    if not hasattr(run, "model") or not hasattr(run, "node_positions"):
        raise InputError(f"{part}: {type(run).__name__} is no run; give what solve or load returns")
    if run.model is None:
        raise InputError(f"{part}: {run.missing}; the run that was loaded has no plates")
    if len(run.t) == 0:
        raise InputError(f"{part}: the run has no frames")
    flag(part, "overwrite", overwrite)


def bodies(model):
    """The plates of a scene's model, also reduced and rigid ones. Raises InputError for a model without anything to draw."""
    if not drawable(model):
        raise InputError(f"{type(model).__name__} has no plates to draw: only the model of a scene has")
    return model.drawn


def drawable(model):
    """True if a model has anything to draw."""
    return model is not None and bool(model.drawn or len(model.sticks(np.zeros(model.n))))


def sticks(run, k):
    """Segments (segments, 2, 2), m, that draw the bodies without a mesh in frame k of a run."""
    return run.model.sticks(np.asarray(run.q[k], float))


def places(run, k):
    """All points that are drawn in frame k of a run, (points, 2), m."""
    return np.concatenate([run.node_positions(k), sticks(run, k).reshape(-1, 2)])


def connectivity(model):
    """Corner nodes of the cells of all plates, with common node numbers, and offsets (cells + 1,) of the cells."""
    nodes, offsets, last = [np.zeros(0, int)], [np.zeros(1, int)], 0
    for body in bodies(model):
        nodes.append(body.mesh.nodes.astype(int) + body.nodes.start)
        offsets.append(body.mesh.offsets[1:].astype(int) + last)
        last += len(body.mesh.nodes)
    return np.concatenate(nodes), np.concatenate(offsets)


def curves(model):
    """The Curves of all plates of a scene's model together: the lines of their cells and boundaries. Raises InputError without any."""
    return curves_of([(body.mesh, body.nodes.start) for body in bodies(model)], *connectivity(model))


def closed(nodes, offsets):
    """(nodes, offsets) with the first corner of every cell repeated after its last."""
    return np.insert(nodes, offsets[1:], nodes[offsets[:-1]]), offsets + np.arange(len(offsets))


def draw_mesh(axes, mesh, values=None, label="", symmetric=False, sections=None):
    """Draw the cells of a mesh to scale: filled by `values` (cells,), with a colorbar if `label` is given, or plain.

    symmetric: colours for values of both signs, white at zero. sections: {name: edges (k, 2, 2), or points (k, 2), to be marked}.
    """
    from matplotlib.collections import LineCollection, PolyCollection

    cells = curves_of_mesh(mesh).polygons(mesh.points)
    low, high = bounds(mesh.points)
    fine, wide = len(cells) > MAX_EDGES, (high - low)[0] > 2.0 * (high - low)[1]
    look = {"edgecolors": "face" if fine else INK, "linewidths": 0.2, "rasterized": fine}
    if values is None:
        axes.add_collection(PolyCollection(cells, facecolors=MOVED, **look))
    else:
        limit = float(np.abs(values).max()) or 1.0
        colours = {"cmap": "RdBu_r", "clim": (-limit, limit)} if symmetric else {"cmap": "viridis"}
        drawn = axes.add_collection(PolyCollection(cells, array=values, **colours, **look))
        if label:
            axes.figure.colorbar(drawn, ax=axes, shrink=0.8, label=label, location="bottom" if wide else "right")
    for i, (name, places) in enumerate((sections or {}).items()):
        if places.ndim == 3:
            axes.add_collection(LineCollection(places, label=literal(name), linewidths=2.0, **line_style(i)))
        else:
            axes.plot(*places.T, label=literal(name), color=PALETTE[i % len(PALETTE)], marker="o", linestyle="none")
    if sections:
        axes.legend(**ABOVE)
    show_to_scale(axes, low, high)


def draw_scene(axes, bodies, parts, places):
    """Draw the parts of a scene to scale with their names.

    bodies: {name: (mesh and places of its nodes, or None and segments (k, 2, 2))}; parts: {name: part}; places: {name: (k, 2)} of the others,
    where they hold on to bodies and to the ground.
    """
    points = [at.reshape(-1, 2) for _, at in bodies.values()]
    lines = [_draw_body(axes, mesh, at) for mesh, at in bodies.values()]
    low, high = _widened(*bounds(np.concatenate([*places.values(), *points])))
    size = float((high - low).max())
    drawn = symbols(parts, _as_drawn, SYMBOL * size)
    draw_symbols(axes, drawn, 0)
    show_to_scale(axes, *reach(low, high, drawn), margin=0.09)
    labels = [(at.mean(axis=0), name, None) for name, at in zip(bodies, points) if len(at)]
    labels += [(place, ", ".join(names), None) for place, names in _names_by_place(places, NEAR * size)]
    place_labels(axes, labels, lines=np.concatenate([*lines, drawn.joints[0], drawn.forces[0]]))


def _draw_body(axes, mesh, at):
    """Draw a body: the cells of a mesh with its nodes at `at`, or the segments `at` if it has none; returns the segments of its outline."""
    from matplotlib.collections import LineCollection, PolyCollection

    if mesh is None:
        draw_sticks(axes, at, linewidths=1.6)
        return at
    shape = curves_of_mesh(mesh)
    cells, outline = shape.polygons(at), shape.outlines(at)
    axes.add_collection(PolyCollection(cells, facecolors=MOVED, edgecolors=MOVED, linewidths=0.4, rasterized=len(cells) > MAX_EDGES))
    axes.add_collection(LineCollection(outline, colors=INK, linewidths=0.7))
    return outline


def _names_by_place(places, near):
    """[(place, names)] of {name: (k, 2)} by the mean of its places; names that are nearer than `near`, m, share the first one's place."""
    labels: list = []
    for name, at in places.items():
        if len(at):
            middle = at.mean(axis=0)
            shared = [names for place, names in labels if np.hypot(*(place - middle)) < near]
            if shared:
                shared[0].append(name)
            else:
                labels.append((middle, [name]))
    return labels


def _as_drawn(side, part):
    """Place or direction of an attachment, or of the ground, in the reference configuration."""
    return np.array([complex(*getattr(side, part))])


def _widened(low, high):
    """Two corners of a box; that of a single point becomes 1 m wide and high."""
    return (low, high) if np.any(high > low) else (low - 0.5, high + 0.5)


def symbols_of(run, frames):
    """(Symbols of a run's scene in some frames, lower left and upper right corner of them and of the bodies)."""
    boxes = np.array([bounds(places(run, k)) for k in frames])
    low, high = _widened(boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0))
    q = np.asarray(run.q[np.asarray(frames)], float)
    size = SYMBOL * float((high - low).max())
    parts = run.model.parts if run.model.is_scene else {}
    drawn = symbols(parts, lambda side, part: run.model.place((side, part), q), size, len(q))
    return drawn, *reach(low, high, drawn)


def draw_sticks(axes, segments, colour=STICK, **options):
    """Draw bodies without a mesh: lines between their points, and a dot for a body of one point."""
    from matplotlib.collections import LineCollection

    axes.add_collection(LineCollection(segments, colors=colour, capstyle="round", **options))
    dots = segments[:, 0][np.all(segments[:, 0] == segments[:, 1], axis=1)]
    if len(dots):
        axes.plot(*dots.T, color=colour, marker="o", markersize=3.0, linestyle="none", label="_dots")


def draw_symbols(axes, drawn, k, **options):
    """Draw frame k of Symbols; returns the artists of joints, forces and pins."""
    from matplotlib.collections import LineCollection

    joints = axes.add_collection(LineCollection(drawn.joints[k], colors=INK, linewidths=0.6, zorder=2.5, **options))
    forces = axes.add_collection(LineCollection(drawn.forces[k], colors=FORCE, linewidths=0.9, zorder=2.6, **options))
    look = {"marker": "o", "markersize": 3.0, "markerfacecolor": "white", "markeredgecolor": INK, "markeredgewidth": 0.7}
    (pins,) = axes.plot(*drawn.pins[k].T, linestyle="none", zorder=2.7, label="_pins", **look, **options)
    return joints, forces, pins


def reach(low, high, drawn):
    """The corners (2, 2) of the smallest box that holds the box low, high and all symbols."""
    points = np.concatenate([np.array([low, high]), *(part.reshape(-1, 2) for part in drawn)])
    return bounds(points)


def frames_at(run, times):
    """Index of the frame nearest to each time, (times,); of equally near frames the first."""
    times, t = np.asarray(times, float), run.t
    after = np.clip(np.searchsorted(t, times), 1, max(1, len(t) - 1)).clip(max=len(t) - 1)
    before = np.maximum(after - 1, 0)
    return np.searchsorted(t, np.where(times - t[before] <= t[after] - times, t[before], t[after]))


def spread(run, count):
    """At most `count` different frames evenly spread in time, the first and the last among them."""
    if not is_whole(count, most=MOST_FRAMES):
        raise InputError(f"frames = {count!r:.100} must be a whole number, from 1 to {MOST_FRAMES}")
    return np.unique(frames_at(run, np.linspace(run.t[0], run.t[-1], count)))


def clock(run, frames):
    """The text of each frame: its time, and the names of the events of the last EVENT_FRAMES frames, each once, newest first."""
    names = [{} for _ in frames]
    for event in reversed(run.events):
        first = np.searchsorted(frames, min(event.frame, frames[-1]))
        for shown in names[first : first + EVENT_FRAMES]:
            shown[event.name] = None
    texts = [f", {cut(', '.join(shown), EVENT_TEXT)}" if shown else "" for shown in names]
    return [f"t = {run.t[k]:.3f} s{text}" for k, text in zip(frames, texts)]


def plot_modes(part, found, q, number, scale, axes):
    """The Figure of `modes.plot` and `buckling.plot`: of all modes of a result, or those of these indices, or of one on the user's axes.

    found: has model, shapes (count, n) and title(k). Raises InputError, in the name of `part`.
    """
    count = len(found.shapes)
    numbers = list(range(count)) if number is None else number if isinstance(number, list) else [number]
    if not numbers or not all(is_whole(k, 0, count - 1) for k in numbers):
        raise InputError(f"{part}: number = {number!r} must be the index of one of {count} modes, or a list of these")
    scale = positive(part, "scale", scale, "no unit")
    if axes is None:
        return shapes(found.model, q, [(found.title(k), found.shapes[k]) for k in numbers], scale)
    draw(require_axes(axes), found.model, q, found.shapes[numbers[0]], found.title(numbers[0]), scale)
    return axes.figure


def shapes(model, q, modes, scale=1.0):
    """Figure of several modes in panels of one size; modes: [(title, shape x (n,))]. The rest is as in `draw`."""
    with settings():
        width = figure_width(6.4 if len(modes) > 1 else 5.0)
        columns = min(2, len(modes)) if width > ONE_COLUMN else 1
        rows = -(-len(modes) // columns)
        box = _box([_rest_and_moved(model, q, x, scale) for _, x in modes]) if model.is_scene else None
        height = height_to_scale(*box, 0.85 * width / columns, 0.7) if box else 2.0
        new, axes = figure(width, rows * height + 0.25, nrows=rows, ncols=columns, squeeze=False)
        for (title, x), panel in zip(modes, axes.ravel()):
            draw(panel, model, q, x, title, scale, box)
        for panel in axes.ravel()[len(modes) :]:
            panel.set_visible(False)
        if box:
            new.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return new


def draw(axes, model, q, x, title, scale=1.0, box=None):
    """Draw the shape x: grey outlines in the state q, and the moved bodies. Models without bodies are shown as bars, one for each entry.

    The largest displacement is scale * AMPLITUDE of the scene's size. Complex shapes are drawn at the phase of their first large entry.
    box: two corners of what is shown, m.
    """
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.ticker import MaxNLocator

    axes.set_title(literal(title))
    if not model.is_scene:
        axes.bar(np.arange(len(x)), np.real(x), color=PALETTE[0])
        axes.axhline(0.0, color=INK, linewidth=0.6)
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(xlabel="coordinate", ylabel="shape", ylim=1.1 * np.array([-1, 1]) * np.abs(x).max())
        return
    rest, moved = _rest_and_moved(model, q, x, scale)
    axes.plot([], [], color=REST, label="at rest")
    axes.plot([], [], color=INK, label="in the mode, not to scale")
    if model.drawn:
        lines = curves(model)
        cells = lines.polygons(moved[0])
        fine = len(cells) > MAX_EDGES
        style = {"edgecolors": MOVED, "linewidths": 0.1} if fine else {"edgecolors": PALETTE[0], "linewidths": 0.3}
        axes.add_collection(PolyCollection(cells, facecolors=MOVED, rasterized=fine, **style))
        axes.add_collection(LineCollection(lines.outlines(rest[0]), colors=REST, linewidths=0.8))
        axes.add_collection(LineCollection(lines.outlines(moved[0]), colors=INK, linewidths=0.7))
    draw_sticks(axes, rest[1], REST, linewidths=0.8, linestyles="--")
    draw_sticks(axes, moved[1], linewidths=1.6)
    show_to_scale(axes, *(box or _box([(rest, moved)])))


def response(frequencies, values, name, outputs):
    """Figure of amplitude, logarithmic, and phase, degrees, of complex values (k, outputs) at frequencies (k,), Hz."""
    with settings():
        width = figure_width(6.4)
        new, (upper, lower) = figure(width, 4.2 if width > ONE_COLUMN else 3.2, nrows=2, sharex=True, height_ratios=[1.6, 1])
        size = np.abs(np.where(np.isfinite(values), values, np.nan))
        visible = size > ROUND_OFF * np.nanmax(size, initial=0.0)
        for i, label in enumerate(outputs):
            label = literal(label) if visible[:, i].any() else f"{literal(label)} (none)"
            upper.plot(frequencies, np.where(visible[:, i], size[:, i], np.nan), label=label, **line_style(i))
            lower.plot(frequencies, np.where(visible[:, i], np.degrees(np.angle(values[:, i])), np.nan), **line_style(i))
        if visible.any():
            upper.set_yscale("log")
        upper.set(ylabel=f"output over {literal(name)}")
        lower.set(xlabel="frequency, Hz", ylabel="phase, degrees", ylim=(-190, 190), yticks=[-180, -90, 0, 90, 180])
        legend_above(new, upper)
        return new


def _positions(model, q):
    """(nodes that are drawn, (nodes, 2); segments of bodies without a mesh, (segments, 2, 2)), m."""
    return model.drawn_points + model.nodal(q), model.sticks(q)


def _points(positions):
    """All points of `_positions`, nodes and ends of segments, as one array (points, 2), m."""
    return np.concatenate([positions[0], positions[1].reshape(-1, 2)])


def _rest_and_moved(model, q, x, scale):
    """Positions in the state q, and moved by a visible multiple of the shape x."""
    rest = _positions(model, q)
    x = np.real(x) * (PROBE * model.extent / np.abs(x).max())
    largest = np.hypot(*(_points(_positions(model, q + x)) - _points(rest)).T).max() or 1.0
    size = float(np.linalg.norm(np.ptp(_points(rest), axis=0))) or 1.0
    return rest, _positions(model, q + scale * AMPLITUDE * size / largest * x)


def _box(pairs):
    """Corners of the smallest box around all that is drawn in pairs of positions (rest, moved)."""
    return bounds(np.concatenate([_points(positions) for pair in pairs for positions in pair]))
