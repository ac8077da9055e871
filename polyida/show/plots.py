"""Figures of one run or of several beside each other, pictures on matplotlib axes as `run.plot` gives them, and a drawing for notebooks.

`runs` is a dictionary {label: Trajectory}. Lengths in m, times in s, forces in N, energies in J.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.results.motion import quantity, unbalanced
from polyida.show import plates
from polyida.show.style import (
    INK,
    PALETTE,
    STICK,
    box,
    colour_top,
    equal,
    figure,
    height_for,
    hollow,
    line,
    on_axes,
    plain,
    scaled,
    settings,
    stress_key,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DISTINCT = 20_000  # polygons in one picture, beyond which they are an image in a PDF: nobody can tell them apart
SHADES = {4: "#F3F7FA", 5: "#D5E5F0", 6: "#A9CBE2", 7: "#7DB1D4"}  # of a polygon with so many corners; fewer as 4, more as 7
ENERGIES = {"kinetic": "o", "potential": "^", "strain": "s", "total": "x"}  # and their markers: colours and dashes are of runs
LETTERS = 100  # of a legend that a figure's width takes, eight for each line that it explains
INTERVALS, LEAST = 30, 1e-17  # of a drift, the largest in each of so many; what is less is drawn there


def mesh(model):
    """The polygon meshes of all plates in the reference configuration. Raises InputError for a model without plates."""
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    if model is None or not model.drawn:
        raise InputError(f"{type(model).__name__} has no plates, whose meshes could be drawn")
    with settings():
        cells = plates.polygons(model, model.drawn_points)
        low, high = box(np.concatenate(cells))
        made, axes = figure(6.4, height_for(low, high, 6.4, 0.75))
        nodes, offsets = plates.connectivity(model)
        count = np.diff(offsets)
        shades = np.array(list(SHADES.values()))[np.clip(count, 4, 7) - 4]
        axes.add_collection(PolyCollection(cells, facecolors=shades, edgecolors=PALETTE[0], linewidths=0.4, label="mesh"))
        equal(axes, low, high)
        corners = " to ".join(map(str, np.unique([count.min(), count.max()])))
        axes.set_title(f"{len(cells)} polygons of {corners} corners, {nodes.max() + 1} nodes")
        kinds = np.unique(np.clip(count, 4, 7))
        ends = {4: f"{count.min()} or 4" if count.min() < 4 else "4", 7: f"7 to {count.max()}" if count.max() > 7 else "7"}
        key = [Patch(facecolor=SHADES[kind], edgecolor=PALETTE[0], label=f"{ends.get(kind, kind)} corners") for kind in kinds]
        made.legend(handles=key, loc="outside lower center", ncols=4)
        return made


def deformed(run, times=None, snapshots=6, width=6.4):
    """The plates at several times in one picture, coloured by von Mises stress in kPa with one colorbar; bodies without a mesh as sticks.

    times: at which to draw, s; by default `snapshots` times evenly spread over the run.
    """
    with settings():
        frames = snapshots_of(run, times, snapshots)
        made, axes, side = scaled(*_around(run, frames), width, bool(run.model.drawn))
        drawn = draw_plates(axes, run, frames)
        if run.model.drawn:
            stress_key(made, axes, drawn, side)
        return made


def snapshots_of(run, times, snapshots):
    """Indices of the frames nearest to `times`, or of as many frames evenly spread where these are None."""
    return plates.spread(run, snapshots) if times is None else plates.frames_at(run, times)


def _around(run, frames):
    return box(np.concatenate([plates.places(run, k) for k in frames]))


def draw_plates(axes, run, frames):
    """The plates in several frames on axes to scale, with their times; returns what a colorbar is made of, the last frame's stress in kPa."""
    from matplotlib.collections import LineCollection, PolyCollection

    shapes = [plates.polygons(run.model, run.node_positions(k)) for k in frames]
    stress = [run.von_mises(k) / 1e3 for k in frames]
    fine = sum(map(len, shapes)) > DISTINCT
    look = {"cmap": "viridis", "clim": (0, colour_top(stress)), "edgecolors": "face", "linewidths": 0.2, "rasterized": fine}
    for k, cells, values in zip(frames, shapes, stress):
        drawn = PolyCollection(cells, array=values, label=f"t = {run.t[k]:.6g} s", **look)
        axes.add_collection(drawn)
        axes.add_patch(_outline(plates.outlines(run.model, run.node_positions(k)), rasterized=fine))
    for k in frames:
        label = f"sticks, t = {run.t[k]:.6g} s"
        axes.add_collection(LineCollection(plates.sticks(run, k), colors=STICK, linewidths=1.6, capstyle="round", label=label))
    low, high = _around(run, frames)
    _label_times(axes, run, frames, 0.05 * (high - low).max())
    equal(axes, low, high, margin=0.09)
    return drawn


def _outline(edges, **look):
    """Edges (edges, 2, 2) as one artist, which is drawn in a tenth of the time that as many lines take."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path

    codes = np.tile([Path.MOVETO, Path.LINETO], len(edges))
    return PathPatch(Path(edges.reshape(-1, 2), codes), fill=False, edgecolor=INK, linewidth=0.4, capstyle="round", **look)


def tip(runs, point="tip"):
    """Path of a named point in the first run, and what its coordinates in the others are away from there against time.

    Between its frames the first run is the cubic with its places and velocities. With one run, the coordinates themselves.
    """
    from scipy.interpolate import CubicHermiteSpline

    with settings():
        (base, first), *others = runs.items()
        made, axes = figure(6.4, 3.7, nrows=2, ncols=2, width_ratios=[1.15, 1])
        grid = axes[0, 0].get_gridspec()  # one panel over both rows on the left and two on the right
        for panel in axes[:, 0]:
            panel.remove()
        axes[1, 1].sharex(axes[0, 1])
        path, history = made.add_subplot(grid[:, 0]), axes[:, 1]
        path.plot(*first.position(point).T, label=plain(base), **line(0))
        path.set(xlabel="x, m", ylabel="y, m", title=f"path of {plain(point)}, {_first(base)}")
        path.set_aspect("equal", adjustable="datalim")
        t, kept = np.unique(first.t, return_index=True)
        velocity = first.model.position(point, first.v) - first.model.position(point, np.zeros((1, first.v.shape[1])))
        between = CubicHermiteSpline(t, first.position(point)[kept], velocity[kept], extrapolate=False)
        for i, (label, run) in enumerate(others or [(base, first)], start=bool(others)):
            found = run.position(point) - between(run.t) if others else run.position(point)
            for axis, values in zip(history, found.T):
                axis.plot(run.t, values, label=plain(label), **line(i))
        delta, title = ("Δ", f"difference from {_first(base)}") if others else ("", f"{plain(point)} against time")
        history[0].set(ylabel=f"{delta}x, m", title=title)
        history[1].set(xlabel="t, s", ylabel=f"{delta}y, m")
        _legend(made, [path, *history])
        return made


def reactions(runs, names, limit=8):
    """What joints do against time: one panel a joint and component, `limit` panels at most, one line a run."""
    with settings():
        first = next(iter(runs.values()))
        panels = [(name, k) for name in names for k in range(first.reaction(name).shape[1])][:limit]
        columns = 2 if len(panels) > 1 else 1
        rows = -(-len(panels) // columns)
        made, axes = figure(6.4, 1.75 * rows + 0.4, nrows=rows, ncols=columns, squeeze=False, sharex=True)
        for (name, k), axis in zip(panels, axes.ravel()):
            for i, (label, run) in enumerate(runs.items()):
                axis.plot(run.t, run.reaction(name)[:, k], label=plain(label), **line(i))
            axis.set(title=plain(name), ylabel=", ".join(filter(None, quantity(first.model, name, k))))
        for axis in axes.ravel()[len(panels) :]:
            axis.set_visible(False)
        for axis in axes.ravel()[max(len(panels) - columns, 0) : len(panels)]:
            axis.set_xlabel("t, s")
            axis.tick_params(labelbottom=True)
        _legend(made, axes[0, 0])
        return made


def energy(runs):
    """Kinetic, potential, strain and total energy of the first run, a marker each, and what every run has gained or lost beside the work
    of parts and what they dissipate. A colour is a run.
    """
    with settings():
        made, axes = figure(6.4, 3.2, ncols=2, width_ratios=[1.25, 1])
        first_label, first = next(iter(runs.items()))
        for i, (part, marker) in enumerate(ENERGIES.items()):
            look = {"marker": marker, "markersize": 4, "markerfacecolor": "none", "markevery": (0.02 + 0.03 * i, 0.12)}
            values = getattr(first.energy, part)
            if part == "kinetic" or np.nan_to_num(values).any():
                axes[0].plot(first.t, values, label=part, **line(0) | {"linewidth": 0.8} | look)
        axes[0].set(xlabel="t, s", ylabel="energy, J", title=f"energies of {_first(first_label)}")
        low, high = axes[0].get_ylim()
        axes[0].set_ylim(low, high + 0.14 * (high - low))  # for the legend
        axes[0].legend(loc="upper center", ncols=4, columnspacing=0.8, handlelength=1.4, handletextpad=0.4, borderpad=0.1)
        for i, (label, run) in enumerate(runs.items()):
            axes[1].plot(run.t, unbalanced(run), label=plain(label), **line(i))
        axes[1].set(xlabel="t, s", ylabel="change of total less work, J")
        axes[1].set_title("gained or lost", loc="right")
        _legend(made, axes[1:])
        return made


def coordinates(runs, limit=6):
    """The first coordinates of a model of one's own against time, one panel each, one line a run."""
    with settings():
        count = min(limit, next(iter(runs.values())).q.shape[1])
        made, axes = figure(6.4, 1.6 * -(-count // 2) + 0.5, nrows=-(-count // 2), ncols=2, squeeze=False, sharex=True)
        for k, axis in enumerate(axes.ravel()):
            axis.set_visible(k < count)
            for i, (label, run) in enumerate(runs.items() if k < count else ()):
                axis.plot(run.t, run.q[:, k], label=plain(label), **line(i))
            axis.set(ylabel=f"q[{k}]", xlabel="t, s" if k >= count - 2 else None)
        _legend(made, axes[0, 0])
        return made


def errors(series, unit="m"):
    """Distance from the refined run against time on a logarithmic axis; series: {label: (t, distance)}."""
    with settings():
        made, axes = figure(6.4, 2.6)
        largest = max([1e-14, *(np.nanmax(distance, initial=0.0) for _, distance in series.values())])
        for i, (label, (t, distance)) in enumerate(series.items()):
            axes.semilogy(t, np.maximum(distance, 1e-18), label=plain(label), **line(i))
        axes.set_ylim(1e-6 * largest, 3 * largest)
        axes.set(xlabel="t, s", ylabel=f"distance, {unit}" if unit else "distance")
        _legend(made, axes)
        return made


def drift(runs):
    """Largest violation of the constraints and of their time derivative in each of INTERVALS intervals of time, on logarithmic axes."""
    with settings():
        made, axes = figure(6.4, 2.9, ncols=2)
        for axis, kind, title in zip(axes, ("drift", "velocity_drift"), ("position", "velocity")):
            for i, (label, run) in enumerate(runs.items()):
                axis.semilogy(*largest(run.t, getattr(run, kind)), label=plain(label), **line(i) | hollow(i, len(runs)))
            axis.set(xlabel="t, s", title=f"{title} constraints, largest violation")
        axes[0].set_ylabel("max|φ|")
        axes[1].set_ylabel("max|dφ/dt|")
        _legend(made, axes)
        return made


def largest(t, values):
    """(times, the largest of `values` in each interval that has frames), at the frame that has it."""
    interval = np.minimum(INTERVALS * (t - t[0]) / max(t[-1] - t[0], 1e-300), INTERVALS - 1).astype(int)
    order = np.lexsort((-np.nan_to_num(values, nan=-1.0), interval))
    top = order[np.unique(interval[order], return_index=True)[1]]
    return t[top], np.maximum(values[top], LEAST)


def _first(label):
    """What a title calls the first run: by its label, where that is short."""
    return plain(label) if len(label) <= 20 else "the first run"


def _legend(made, axes):
    """One legend above all panels, where it hides nothing; each label once, as many in a line as it takes."""
    known = {label: handle for axis in np.ravel(axes) for handle, label in zip(*axis.get_legend_handles_labels())}
    beside = LETTERS // (max(map(len, known)) + 8)
    made.legend(known.values(), known, loc="outside upper center", ncols=max(1, min(len(known), beside)))


def _label_times(axes, run, frames, apart):
    """Write each time beside the outermost place of the last body, on the side that it moves along; where places are less than `apart`, m,
    from each other, the last time alone.
    """
    last, labelled = plates.bodies(run.model)[-1:], []
    end = int(np.argmax(last[0].points[:, 0])) if last else -1
    for k in reversed(frames):
        positions = run.node_positions(k)[last[0].nodes] if last else plates.sticks(run, k).reshape(-1, 2)
        if any(np.hypot(*(positions[end] - other)) < apart for other in labelled):
            continue
        labelled.append(positions[end])
        along = positions[end] - positions.mean(axis=0)
        beyond = 12 * along / (np.hypot(*along) + 1e-300)
        axes.annotate(
            f"{run.t[k]:.3g} s",
            positions[end],
            xytext=beyond,
            textcoords="offset points",
            fontsize=7.5,
            ha="center",
            va="center",
            annotation_clip=False,
            color=INK,
        )


WIDTH, HEIGHTS, MOST = 320, (60, 240), 20_000  # pixels of a drawing; segments beyond which there is none
DIGITS = 1000  # places in a drawing, from side to side


class RunPlots:
    """What `run.plot` has. Each draws into matplotlib axes, new ones where None are given, and returns them.

    Names are those of masses, loads and joints. Raises InputError for what the run does not have.
    """

    def __init__(self, run: Any) -> None:
        self._run = run

    def __repr__(self):
        return "run.plot: energy(), position(name), tip(name), reactions(*names), drift(), deformed(times)"

    def energy(self, axes: "Axes | None" = None) -> "Axes":
        """Kinetic, potential, strain and total energy, J, against time; those that are none are left out."""
        found = {part: getattr(self._run.energy, part) for part in ENERGIES}
        shown = {part: values for part, values in found.items() if part == "kinetic" or np.nan_to_num(values).any()}
        return self._against_time(shown, "energy, J", axes)

    def position(self, name: object = "tip", axes: "Axes | None" = None) -> "Axes":
        """x and y of a named point, m, against time."""
        x, y = self._run.position(name).T
        return self._against_time({"x": x, "y": y}, f"place of {plain(name)}, m", axes)

    def tip(self, name: object = "tip", axes: "Axes | None" = None) -> "Axes":
        """The path of a named point in the plane, to scale."""
        path = self._run.position(name)
        with on_axes(axes) as axis:
            axis.plot(*path.T, label=plain(name), **line(0))
            axis.set(xlabel="x, m", ylabel="y, m", title=f"path of {plain(name)}")
            axis.set_aspect("equal", adjustable="datalim")
            return axis

    def reactions(self, *names: str, axes: "Axes | None" = None) -> "Axes":
        """What joints do to their side b, N and N m, against time; of all joints where no name is given."""
        self._run.known_model("run.plot.reactions")
        model = self._run.model
        names = names or tuple(model.joints)
        if not names:
            raise InputError(f"run.plot.reactions: {type(model).__name__} has no joints")
        lines = {}
        for name in names:
            for k, values in enumerate(self._run.reaction(name).T):
                lines[f"{plain(name)}: {', '.join(filter(None, quantity(model, name, k)))}"] = values
        return self._against_time(lines, "reaction", axes)

    def drift(self, axes: "Axes | None" = None) -> "Axes":
        """The largest violation of the constraints and of their time derivative in intervals of time, on a logarithmic axis."""
        with on_axes(axes) as axis:
            for i, (kind, label) in enumerate((("drift", "max|φ|"), ("velocity_drift", "max|dφ/dt|"))):
                axis.semilogy(*largest(self._run.t, getattr(self._run, kind)), label=label, marker=".", **line(i))
            return _finished(axis, "violation of the constraints")

    def deformed(self, times: ArrayLike | None = None, snapshots: int = 6, axes: "Axes | None" = None) -> "Axes":
        """The bodies at times, s, or at as many evenly spread, plates coloured by von Mises stress, kPa."""
        frames = snapshots_of(self._run, times, snapshots)
        with on_axes(axes) as axis:
            drawn = draw_plates(axis, self._run, frames)
            if axes is None and self._run.model.drawn:
                axis.figure.colorbar(drawn, ax=axis, extend="max", shrink=0.8, label="von Mises stress, kPa")
            return axis

    def _against_time(self, lines, heading, axes):
        with on_axes(axes) as axis:
            for i, (label, values) in enumerate(lines.items()):
                axis.plot(self._run.t, values, label=label, **line(i))
            return _finished(axis, heading)


def _finished(axis, heading):
    axis.set(xlabel="t, s", ylabel=heading)
    axis.legend(loc="best")
    return axis


def drawing(run):
    """The last frame of a scene as a small inline SVG; empty where there is nothing to draw, or too much."""
    if not len(run) or not plates.drawable(run.model):
        return ""
    last = len(run) - 1
    edges, sticks = plates.outlines(run.model, run.node_positions(last)), plates.sticks(run, last)
    if len(edges) + len(sticks) > MOST or not (np.isfinite(edges).all() and np.isfinite(sticks).all()):
        return ""
    low, high = box(np.concatenate([edges, sticks]).reshape(-1, 2))
    size = max((high - low).max(), 1e-300)
    width, height = np.maximum((high - low) / size, 1e-3) * DIGITS
    place = lambda segments: np.stack([segments[..., 0] - low[0], high[1] - segments[..., 1]], axis=-1) / size * DIGITS  # noqa: E731
    pixels = np.clip(WIDTH * height / width, *HEIGHTS)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="last frame, t = {run.t[-1]:.6g} s" width="{WIDTH}" '
        f'height="{pixels:.0f}" viewBox="-20 -20 {width + 40:.0f} {height + 40:.0f}" fill="none" stroke-linecap="round">'
        f'<path stroke="currentColor" stroke-width="1" vector-effect="non-scaling-stroke" d="{_path(place(edges))}"/>'
        f'<path stroke="{STICK}" stroke-width="2" vector-effect="non-scaling-stroke" d="{_path(place(sticks))}"/></svg>'
    )


def _path(segments):
    return "".join(f"M{a:.0f} {b:.0f}L{c:.0f} {d:.0f}" for (a, b), (c, d) in segments)
