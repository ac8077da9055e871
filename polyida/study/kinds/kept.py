"""What energy and drift share: one run an integrator, its rows and histories of what it should keep."""

import numpy as np

from polyida.errors import InputError
from polyida.given import is_one_of, is_whole
from polyida.show.style import on_axes, plain
from polyida.study.drawing import look
from polyida.study.result import Result
from polyida.study.subject import setting

FLOOR = 1e-17  # what is zero on a logarithmic axis


class Kept(Result):
    """Rows of whole runs, and the histories of what they should keep.

    quantities: {name of a history: (label of its axis, whether the axis is logarithmic)}, the first one the main picture.
    """

    quantities: dict = {}

    def __init__(self, name, rows, notes, histories):
        super().__init__(rows, notes, histories)
        self.title = f"{self.title}: {name}"

    def plot(self, quantity: str | None = None, axes=None):
        """Draw the history of a quantity, a line an integrator; returns the axes. Raises InputError for one that there is not."""
        known = self._there()
        quantity = known[0] if quantity is None else quantity
        if not is_one_of(quantity, known):
            raise InputError(f"plot: quantity = {quantity!r} must be one of {', '.join(known)}")
        label, logarithmic = self.quantities[quantity]
        with on_axes(axes) as axis:
            for i, (name, found) in enumerate(self.histories.items()):
                values = np.maximum(np.abs(found[quantity]), FLOOR) if logarithmic else found[quantity]
                axis.plot(found["t"], values, label=plain(name), **_marked(i, len(self.histories), len(values)))
            axis.set(xlabel="t, s", ylabel=label, title=plain(self.title), yscale="log" if logarithmic else "linear")
            axis.legend(loc="best")
            return axis

    def pictures(self) -> dict:
        """The history of each quantity."""
        return {
            name.replace("_", "-"): (f"{self.quantities[name][0]} against time.", lambda axes, name=name: self.plot(name, axes))
            for name in self._there()
        }

    def _there(self):
        """The quantities that some run has, not all of them NaN."""
        return [name for name in self.quantities if any(np.isfinite(found[name]).any() for found in self.histories.values())]


def kept(study, given, known, frames, every, measure, tell):
    """(rows, notes, histories) of one run for each of {label: [integrator]}; measure(run, frames) gives (row, history). every: as solve's."""
    if not is_whole(frames, 2):
        raise InputError(f"{study}: frames = {frames!r} must be a whole number of at least 2")
    rows, notes, histories = [], [], {}
    for label, (integrator,) in known.items():
        tell(len(rows), len(known), label)
        given.warm_up(integrator)
        run = given.run(integrator, every=every)
        row, histories[label] = measure(run, spread(run, frames))
        work = {"steps": run.counts.steps, "cpu_s": float(run.cpu_seconds), "status": run.status, "message": run.message}
        rows.append({"integrator": label, "setting": setting(integrator, [])} | row | work)
        notes += [] if run.success else [f"{label}: {run.message}"]
    tell(len(known), len(known), "")
    return rows, notes, histories


def spread(run, frames):
    """Indices of at most so many frames of a run, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, len(run.t) - 1, min(frames, len(run.t))).astype(int))


def _marked(i, lines, points):
    """Look of a line among several that may lie on each other: a marker now and then, each line's at places of its own."""
    every = max(1, points // 12)
    return look(i) | {"markevery": (i * every // max(1, lines), every), "markerfacecolor": "none", "markersize": 4}
