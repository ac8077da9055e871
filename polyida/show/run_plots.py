"""Pictures of one run on matplotlib axes, as `run.plot` gives them, and a drawing of its last frame for notebooks."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.results.tables import ENERGIES, quantity
from polyida.show import plates
from polyida.show.plots import draw_plates, largest, snapshots_of
from polyida.show.style import STICK, box, line, on_axes, plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
