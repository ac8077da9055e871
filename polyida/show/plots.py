"""Figures of one or several runs, the pictures of `run.plot`, and the drawing of a run in a notebook.

Lengths are in m, times in s, forces in N, energies in J. `runs` is a dictionary {label: Trajectory}.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.reprs import cut
from polyida.results.curves import curves_of_mesh
from polyida.results.motion import quantity, unbalanced
from polyida.show import plates
from polyida.show.axes import finish, place_labels
from polyida.show.styles import (
    FAILED,
    INK,
    MARK,
    PALETTE,
    STICK,
    bounds,
    colour_limit,
    figure,
    figure_to_scale,
    height_to_scale,
    hollow_markers,
    legend_above,
    line_style,
    literal,
    on_axes,
    settings,
    show_to_scale,
    stress_colorbar,
)
from polyida.validation import vector

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAX_VECTOR_POLYGONS = 20_000  # more polygons in one picture are an image in a PDF
CORNER_COLOURS = {4: "#F3F7FA", 5: "#D5E5F0", 6: "#A9CBE2", 7: "#7DB1D4"}  # by number of corners: 4 or fewer, 5, 6, 7 or more
ENERGY_MARKERS = {"kinetic": "o", "potential": "^", "strain": "s", "total": "x"}
NAMED_EVENTS, NAME_DISTANCE, SHORT_MARK = 20, 0.04, 0.04  # names of events at most; their least distance and a short mark, of the axes
INTERVALS, SMALLEST_DRIFT = 30, 1e-17  # a drift is drawn by its maximum in each interval of time; smaller values are drawn at the bound
DRIFTS = {  # attribute: constraints, axis label, unit in a scene
    "drift": ("position", "max|φ|", "m or rad"),
    "velocity_drift": ("velocity", "max|dφ/dt|", "m/s or rad/s"),
}
LONGEST_NAME = 48  # characters of a name in a picture


def mesh(model):
    """Figure of the mesh of the body with the most polygons, as drawn; the title counts those of all bodies. Raises InputError without plates."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    if model is None or not model.drawn:
        raise InputError(f"{type(model).__name__} has no plates, so there is no mesh to draw")
    with settings():
        shown = max(model.drawn, key=lambda body: body.mesh.n_cells)
        cells = curves_of_mesh(shown.mesh).polygons(shown.points)
        low, high = bounds(np.concatenate(cells))
        new, axes = figure(6.4, height_to_scale(low, high, 6.4, 0.75))
        nodes, offsets = plates.connectivity(model)
        count = np.diff(offsets) // np.concatenate([np.full(body.mesh.n_cells, body.mesh.order) for body in model.drawn])
        own = np.diff(shown.mesh.offsets) // shown.mesh.order
        colours = np.array(list(CORNER_COLOURS.values()))[np.clip(own, 4, 7) - 4]
        axes.add_collection(PolyCollection(cells, facecolors=colours, edgecolors=PALETTE[0], linewidths=0.4, label="mesh"))
        show_to_scale(axes, low, high)
        corners = " to ".join(map(str, np.unique([count.min(), count.max()])))
        whole = f"{len(count)} polygons of {corners} corners, {nodes.max() + 1} nodes"
        axes.set_title(f"{len(cells)} of {whole}" if len(cells) < len(count) else whole)
        names = {4: f"{own.min()} or 4" if own.min() < 4 else "4", 7: f"7 to {own.max()}" if own.max() > 7 else "7"}
        kinds = np.unique(np.clip(own, 4, 7))
        key = [Patch(facecolor=CORNER_COLOURS[kind], edgecolor=PALETTE[0], label=f"{names.get(kind, kind)} corners") for kind in kinds]
        new.legend(handles=key, loc="outside lower center", ncols=4)
        return new


def deformed(run, times=None, snapshots=6, width=6.4):
    """Figure of the bodies at `times`, s, or at `snapshots` times spread over the run; plates coloured by von Mises stress."""
    with settings():
        frames = _frames(run, times, snapshots)
        _, low, high = plates.symbols_of(run, frames)
        new, axes, side = figure_to_scale(low, high, width, bool(run.model.drawn))
        cells = draw_frames(axes, run, frames)
        if run.model.drawn:
            stress_colorbar(new, axes, cells, side)
        label_times(axes, run, frames)
        return new


def _frames(run, times, snapshots):
    """Indices of the frames nearest to the user's times, s, or of `snapshots` frames spread over the run."""
    if times is None:
        return plates.spread(run, snapshots)
    times = vector("deformed", "times", times)
    if not len(times):
        raise InputError("deformed: times = [] has no time; give one, or leave it out")
    return plates.frames_at(run, times)


def draw_frames(axes, run, frames):
    """Draw the bodies of several frames to scale, and joints and forces of the last; returns its cells, which a colorbar explains."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    positions = [run.node_positions(k) for k in frames]
    lines = plates.curves(run.model)
    shapes = [lines.polygons(at) for at in positions]
    stress = [run.von_mises(k) / 1e3 for k in frames]
    raster = sum(map(len, shapes)) > MAX_VECTOR_POLYGONS
    style = {"cmap": "viridis", "clim": (0, colour_limit(stress)), "edgecolors": "face", "linewidths": 0.2, "rasterized": raster}
    for k, at, cells, values in zip(frames, positions, shapes, stress):
        drawn = axes.add_collection(PolyCollection(cells, array=values, label=f"t = {run.t[k]:.6g} s", **style))
        edges = lines.outlines(at)
        outline = Path(edges.reshape(-1, 2), np.tile([Path.MOVETO, Path.LINETO], len(edges)))  # one artist draws ten times as fast as lines
        axes.add_patch(PathPatch(outline, fill=False, edgecolor=INK, linewidth=0.4, capstyle="round", rasterized=raster))
    for k in frames:
        plates.draw_sticks(axes, plates.sticks(run, k), linewidths=1.6, label=f"sticks, t = {run.t[k]:.6g} s")
    symbols, low, high = plates.symbols_of(run, frames)
    plates.draw_symbols(axes, symbols, -1)
    show_to_scale(axes, low, high, margin=0.12)
    return drawn


def label_times(axes, run, frames):
    """Write each time beside the last body's point of largest x; of times that have no room beside each other the later ones stay."""
    last, labels = plates.bodies(run.model)[-1:], []
    end = int(np.argmax(last[0].points[:, 0])) if last else -1
    for k in reversed(frames):
        positions = run.node_positions(k)[last[0].nodes] if last else plates.sticks(run, k).reshape(-1, 2)
        labels.append((positions[end], f"{run.t[k]:.3g} s", positions[end] - positions.mean(axis=0)))
    place_labels(axes, labels, required=False)


def tip(runs, point="tip"):
    """Figure of the path of a named point in the first run, and the differences of the other runs from it against time.

    The first run is interpolated by the cubic through its positions and velocities. A single run shows its coordinates.
    """
    from scipy.interpolate import CubicHermiteSpline

    with settings():
        (base, first), *others = runs.items()
        new, axes = figure(6.4, 3.7, nrows=2, ncols=2, width_ratios=[1.15, 1])
        grid = axes[0, 0].get_gridspec()  # the left panel takes both rows
        for panel in axes[:, 0]:
            panel.remove()
        axes[1, 1].sharex(axes[0, 1])
        path, history = new.add_subplot(grid[:, 0]), axes[:, 1]
        RunPlots(first).tip(point, path)
        path.get_lines()[0].set_label(label_of(base, first))
        path.set_title(f"path of {_name(point)}, {_name_of_first(base)}")
        path.set_title("", loc="right")  # the legend says how the run ended
        t, frames = np.unique(first.t, return_index=True)
        velocity = first.model.position(point, first.v) - first.model.position(point, np.zeros((1, first.v.shape[1])))
        interpolated = CubicHermiteSpline(t, first.position(point)[frames], velocity[frames], extrapolate=False)
        for axis in history:
            mark_events(axis, first)
            for run in runs.values():
                mark_end(axis, run)
        for i, (label, run) in enumerate(others or [(base, first)], start=bool(others)):
            difference = run.position(point) - interpolated(run.t) if others else run.position(point)
            for axis, values in zip(history, difference.T):
                axis.plot(run.t, values, label=label_of(label, run), **line_style(i))
        delta, title = ("Δ", f"difference from {_name_of_first(base)}") if others else ("", f"{_name(point)} against time")
        history[0].set(ylabel=f"{delta}x, m", title=title)
        history[1].set(xlabel="t, s", ylabel=f"{delta}y, m")
        legend_above(new, [path, *history])
        return new


def reactions(runs, names, limit=8):
    """Figure of joint reactions against time: a panel for each joint and component, at most `limit` panels, a line for each run."""
    first = next(iter(runs.values()))
    panels = [(name, k) for name in names for k in range(first.reaction(name).shape[1])][:limit]
    kinds = [quantity(first.model, name, k) for name, k in panels]
    titles = [(", ".join([_name(name), kind[0]]), ", ".join(filter(None, kind))) for (name, _), kind in zip(panels, kinds)]
    return _history_panels(runs, titles, [lambda run, name=name, k=k: run.reaction(name)[:, k] for name, k in panels], 1.75, 0.4)


def coordinates(runs, limit=6):
    """Figure of the first coordinates against time: a panel for each, a line for each run."""
    count = min(limit, next(iter(runs.values())).q.shape[1])
    return _history_panels(runs, [("", f"q[{k}]") for k in range(count)], [lambda run, k=k: run.q[:, k] for k in range(count)], 1.6, 0.5)


def _history_panels(runs, titles, functions, height, margin):
    """Figure with a panel for each function(run) -> (frames,), in two columns; titles: (title, axis label)."""
    with settings():
        columns = min(2, len(functions))
        rows = -(-len(functions) // columns)
        new, axes = figure(6.4, height * rows + margin, nrows=rows, ncols=columns, squeeze=False, sharex=True)
        for k, axis in enumerate(axes.ravel()):
            axis.set_visible(k < len(functions))
            for i, (label, run) in enumerate(runs.items() if k < len(functions) else ()):
                axis.plot(run.t, functions[k](run), label=label_of(label, run), **line_style(i))
                mark_end(axis, run)
                axis.set(title=titles[k][0], ylabel=titles[k][1])
            if k < len(functions):
                mark_events(axis, next(iter(runs.values())), names=k < columns)
            if k + columns >= len(functions):
                axis.set_xlabel("t, s")
                axis.tick_params(labelbottom=True)
        legend_above(new, axes[0, 0])
        return new


def energy(runs):
    """Figure of the energies of the first run, and of each run's change of total energy less external work and dissipation."""
    with settings():
        new, axes = figure(6.4, 3.2, ncols=2, width_ratios=[1.25, 1])
        first_label, first = next(iter(runs.items()))
        for i, (part, values) in enumerate(_energies(first).items()):
            markers = {"marker": ENERGY_MARKERS[part], "markersize": 4, "markerfacecolor": "none", "markevery": (0.02 + 0.03 * i, 0.12)}
            axes[0].plot(first.t, values, label=part, **line_style(0) | {"linewidth": 0.8} | markers)
        for axis in axes:
            mark_events(axis, first)
        mark_end(axes[0], first)
        axes[0].set(xlabel="t, s", ylabel="energy, J", title=f"energies of {_name_of_first(first_label)}")
        low, high = axes[0].get_ylim()
        axes[0].set_ylim(low, high + 0.14 * (high - low))  # space for the legend
        axes[0].legend(loc="upper center", ncols=4, columnspacing=0.8, handlelength=1.4, handletextpad=0.4, borderpad=0.1)
        for i, (label, run) in enumerate(runs.items()):
            axes[1].plot(run.t, unbalanced(run), label=label_of(label, run), **line_style(i))
            mark_end(axes[1], run)
        axes[1].set(xlabel="t, s", ylabel="change of total less work, J")
        axes[1].set_title("energy error", loc="right")
        legend_above(new, axes[1:])
        return new


def _energies(run):
    """{name: (frames,), J} of a run's energies, without those that are zero or unknown."""
    energies = {part: getattr(run.energy, part) for part in ENERGY_MARKERS}
    return {part: values for part, values in energies.items() if part == "kinetic" or np.nan_to_num(values).any()}


def errors(series, unit="m"):
    """Figure of the distance from the reference run against time; series: {label: (t, distance)}."""
    with settings():
        new, axes = figure(6.4, 2.6)
        top = max([1e-14, *(np.nanmax(distance, initial=0.0) for _, distance in series.values())])
        for i, (label, (t, distance)) in enumerate(series.items()):
            axes.semilogy(t, np.maximum(distance, 1e-6 * top), label=literal(cut(label, LONGEST_NAME)), **line_style(i))
        axes.set_ylim(0.7e-6 * top, 3 * top)  # what is less, and zero, lies along the lower edge
        axes.set(xlabel="t, s", ylabel=f"distance, {unit}" if unit else "distance")
        legend_above(new, axes)
        return new


def drift(runs):
    """Figure of the largest violation of the constraints and of their time derivative in INTERVALS intervals of time."""
    with settings():
        new, axes = figure(6.4, 2.9, ncols=2)
        for axis, (name, (kind, *_)) in zip(axes, DRIFTS.items()):
            for i, (run_label, run) in enumerate(runs.items()):
                style = line_style(i) | hollow_markers(i, len(runs))
                axis.semilogy(*interval_maxima(run.t, getattr(run, name)), label=label_of(run_label, run), **style)
                mark_end(axis, run)
            axis.set(xlabel="t, s", ylabel=_drift_label(next(iter(runs.values())), name), title=f"{kind} constraints, largest violation")
        legend_above(new, axes)
        return new


def _drift_label(run, name):
    """Label of the axis of a drift, such as |phi|, of a run; with the unit only if the run is of a scene."""
    _, label, unit = DRIFTS[name]
    return f"{label}, {unit}" if run.model.is_scene else label


def label_of(label, run):
    """The text of a run in a legend: its label, shortened, and in brackets how it ended if it failed, with the time."""
    ended = ending(run)
    return literal(cut(label, LONGEST_NAME) + (f" ({ended})" if ended else ""))


def ending(run):
    """How a run ended that did not reach its end; empty for one that did."""
    return "" if run.success or not len(run) else f"{run.status} at t = {run.t[-1]:.4g} s"


def mark_end(axes, run):
    """Draw a line at the last frame of a run that did not reach its end."""
    if ending(run):
        axes.axvline(run.t[-1], color=FAILED, linewidth=0.9, linestyle=(0, (2, 2)), zorder=0.6, label="_end")


def interval_maxima(t, values):
    """(times, largest value of each interval of time), at the frame that has it."""
    interval = np.minimum(INTERVALS * (t - t[0]) / max(t[-1] - t[0], 1e-300), INTERVALS - 1).astype(int)
    order = np.lexsort((-np.nan_to_num(values, nan=-1.0), interval))
    top = order[np.unique(interval[order], return_index=True)[1]]
    return t[top], np.maximum(values[top], SMALLEST_DRIFT)


def mark_events(axes, run, names=True):
    """Draw thin vertical lines at the events of a run, short ones of many, with up to NAMED_EVENTS names that do not overlap."""
    from matplotlib.collections import LineCollection

    if not run.events:
        return
    height = 1.0 if len(run.events) <= 2 * NAMED_EVENTS else SHORT_MARK
    marks = [[(t, 0.0), (t, height)] for t in np.unique(run.events.t)]
    style = {"colors": MARK, "linewidths": 0.5, "alpha": 0.6, "zorder": 0.5, "label": "_events"}
    axes.add_collection(LineCollection(marks, transform=axes.get_xaxis_transform(), **style), autolim=False)
    last, count, distance = -np.inf, 0, NAME_DISTANCE * (run.t[-1] - run.t[0])
    for event in run.events if names else ():
        if count < NAMED_EVENTS and event.t - last > distance:
            place = {"transform": axes.get_xaxis_transform(), "rotation": 90, "ha": "right", "va": "bottom", "clip_on": True}
            axes.text(event.t, SHORT_MARK, literal(cut(event.name, 20)), fontsize=6, color=MARK, **place)
            last, count = event.t, count + 1


def _name(name):
    """A name as text of a figure, cut at LONGEST_NAME, without formulas."""
    return literal(cut(str(name), LONGEST_NAME))


def _name_of_first(label):
    """The label of the first run as text of a figure; "the first run" if it has more than 20 characters."""
    return literal(label) if len(label) <= 20 else "the first run"


class RunPlots:
    """The pictures of one run, `run.plot`.

    Parameters
    ----------
    run : Trajectory
        The run to draw.

    Notes
    -----
    Each method draws into matplotlib axes, into new pyplot axes if None, and returns them. It raises InputError if the run lacks the quantity.
    Histories have thin vertical lines at the events of the run, with the names of up to 20.
    """

    def __init__(self, run: Any) -> None:
        """Take the run whose pictures are drawn."""
        self._run = run

    def __repr__(self):
        """One line with the names and arguments of the pictures."""
        return "run.plot: energy(), position(name), tip(name), reactions(*names), expressions(*given), drift(), deformed(times)"

    def energy(self, axes: Axes | None = None) -> Axes:
        """Draw kinetic, potential, strain and total energy, J, against time, without those that are zero.

        Parameters
        ----------
        axes : Axes, optional

        Returns
        -------
        axes : Axes
        """
        return self._draw_histories(_energies(self._run), "energy, J", axes)

    def position(self, name: object = "tip", axes: Axes | None = None) -> Axes:
        """Draw x and y of a point, m, against time.

        Parameters
        ----------
        name : str or attachment
            A mass, load or joint.
        axes : Axes, optional

        Returns
        -------
        axes : Axes
        """
        x, y = self._run.position(name).T
        return self._draw_histories({"x": x, "y": y}, f"position of {_name(name)}, m", axes)

    def tip(self, name: object = "tip", axes: Axes | None = None) -> Axes:
        """Draw the path of a point in the plane to scale.

        Parameters
        ----------
        name : str or attachment
            A mass, load or joint.
        axes : Axes, optional

        Returns
        -------
        axes : Axes
        """
        path = self._run.position(name)
        with on_axes(axes) as axis:
            axis.plot(*path.T, label=_name(name), **line_style(0))
            axis.set(xlabel="x, m", ylabel="y, m")
            if ended := ending(self._run):
                axis.plot(*path[-1], color=FAILED, marker="x", linestyle="none", label="_end")
                axis.set_title(literal(ended), color=FAILED, loc="right")
            axis.set_aspect("equal", adjustable="datalim")
            return axis

    def reactions(self, *names: str, axes: Axes | None = None) -> Axes:
        """Draw the forces, N, and torques, N m, of joints on their side b against time.

        Parameters
        ----------
        *names : str
            Joints; all joints if none is named.
        axes : Axes, optional

        Returns
        -------
        axes : Axes
        """
        self._run.known_model("run.plot.reactions")
        model = self._run.model
        names = names or tuple(model.joints)
        if not names:
            raise InputError(f"run.plot.reactions: {type(model).__name__} has no joints")
        histories = {}
        for name in names:
            for k, values in enumerate(self._run.reaction(name).T):
                histories[f"{_name(name)}: {', '.join(filter(None, quantity(model, name, k)))}"] = values
        return self._draw_histories(histories, "reaction", axes)

    def expressions(self, *given: Any, axes: Axes | None = None) -> Axes:
        """Draw expressions of sympy against time, of a run of a model of `pi.symbolic`.

        Parameters
        ----------
        *given : expression of sympy
            As of `SymbolicModel.evaluate`.
        axes : Axes, optional

        Returns
        -------
        axes : Axes
        """
        self._run.known_model("run.plot.expressions")
        model = self._run.model
        if not hasattr(model, "evaluate"):
            raise InputError(f"run.plot.expressions: {type(model).__name__} is no model of polyida.symbolic")
        if not given:
            raise InputError("run.plot.expressions: give an expression of sympy")
        histories = {literal(cut(str(one), LONGEST_NAME)): model.evaluate(self._run, one) for one in given}
        return self._draw_histories(histories, "" if len(given) > 1 else next(iter(histories)), axes)

    def drift(self, axes: Axes | None = None) -> Axes:
        """Draw the largest violation of the constraints and of their time derivative on a logarithmic axis.

        Parameters
        ----------
        axes : Axes, optional

        Returns
        -------
        axes : Axes
        """
        with on_axes(axes) as axis:
            for i, name in enumerate(DRIFTS):
                label = _drift_label(self._run, name)
                axis.semilogy(*interval_maxima(self._run.t, getattr(self._run, name)), label=label, marker=".", **line_style(i))
            axis.set(xlabel="t, s", ylabel="violation of φ")
            self._explain(axis)
            return axis

    def deformed(self, times: ArrayLike | None = None, snapshots: int = 6, axes: Axes | None = None) -> Axes:
        """Draw the bodies at several times, plates coloured by von Mises stress, kPa.

        Parameters
        ----------
        times : (k,) float, s, optional
            The nearest frames are drawn.
        snapshots : int
            Number of times spread over the run if `times` is None.
        axes : Axes, optional

        Returns
        -------
        axes : Axes
        """
        frames = _frames(self._run, times, snapshots)
        with on_axes(axes) as axis:
            cells = draw_frames(axis, self._run, frames)
            if ended := ending(self._run):
                axis.set_title(literal(ended), color=FAILED, loc="right")
            if axes is None and self._run.model.drawn:
                axis.figure.colorbar(cells, ax=axis, extend="max", shrink=0.8, label="von Mises stress, kPa")
            label_times(axis, self._run, frames)
            return axis

    def _draw_histories(self, histories, heading, axes):
        """Draw each of {label: (frames,) values} against time into the axes and return them."""
        with on_axes(axes) as axis:
            for i, (label, values) in enumerate(histories.items()):
                axis.plot(self._run.t, values, label=label, **line_style(i))
            axis.set(xlabel="t, s", ylabel=heading)
            self._explain(axis)
            return axis

    def _explain(self, axis):
        """Mark events and the end of a failed run; the legend is above the axes, where it covers nothing."""
        mark_events(axis, self._run)
        mark_end(axis, self._run)
        finish(axis, ending=ending(self._run))


WIDTH, HEIGHTS, MAX_SEGMENTS, UNITS = 320, (60, 240), 20_000, 1000  # of a drawing: pixels, limit of segments, coordinates from side to side


def drawing(run):
    """The last frame of a scene as inline SVG; empty if there is nothing to draw or too much."""
    if not len(run) or not plates.drawable(run.model):
        return ""
    last = len(run) - 1
    edges, sticks = plates.curves(run.model).outlines(run.node_positions(last)), plates.sticks(run, last)
    if len(edges) + len(sticks) > MAX_SEGMENTS or not (np.isfinite(edges).all() and np.isfinite(sticks).all()):
        return ""
    low, high = bounds(np.concatenate([edges, sticks]).reshape(-1, 2))
    size = max((high - low).max(), 1e-300)
    width, height = np.maximum((high - low) / size, 1e-3) * UNITS

    def path(segments):
        """The path data of an SVG for segments (k, 2, 2), m: y downwards, in whole units."""
        points = np.stack([segments[..., 0] - low[0], high[1] - segments[..., 1]], axis=-1) / size * UNITS
        return "".join(f"M{a:.0f} {b:.0f}L{c:.0f} {d:.0f}" for (a, b), (c, d) in points)

    pixels = np.clip(WIDTH * height / width, *HEIGHTS)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="last frame, t = {run.t[-1]:.6g} s" width="{WIDTH}" '
        f'height="{pixels:.0f}" viewBox="-20 -20 {width + 40:.0f} {height + 40:.0f}" fill="none" stroke-linecap="round">'
        f'<path stroke="currentColor" stroke-width="1" vector-effect="non-scaling-stroke" d="{path(edges)}"/>'
        f'<path stroke="{STICK}" stroke-width="2" vector-effect="non-scaling-stroke" d="{path(sticks)}"/></svg>'
    )
