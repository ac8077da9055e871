"""How far a point is from where it is to be."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import floats
from polyida.keywords import named_keywords
from polyida.model.differences import along, around
from polyida.objective.slopes import Slopes
from polyida.objective.time_mean import TimeMean

FRAMES_WIDE = 10.0  # times between frames in which a path varies, about: its rate is taken over a hundredth of that


@named_keywords
@dataclass(frozen=True, eq=False)
class Deviation(TimeMean):
    """Time mean of `|x(t) - path(t)|^2`, m2, of a point x.

    point: what `run.position` takes: the name of a mass, load or joint, the part itself, or an attachment. path: a function of time that
    gives (x, y), m, or a constant pair. Raises InputError for a path that is neither, and of a run for a point that is not in its model.
    """

    point: Any
    path: Callable[[float], ArrayLike] | ArrayLike

    def __post_init__(self):
        if not callable(self.path):
            self._place(self.path)

    def seen(self, model, span):
        """The squared distance."""
        pull = _pull(model, self.point)

        def look(frames):
            gap = model.position(self.point, frames.q) - self._places(frames.t)
            rates = lambda factor: -2.0 * factor * np.sum(gap * self._rates(model, frames.t, span), axis=1)  # noqa: E731
            return np.sum(gap**2, axis=1), lambda factor: Slopes(q=pull(frames.q, 2.0 * factor[:, None] * gap), t=rates(factor))

        return look

    def _places(self, t):
        return np.array([self._place(self.path(float(at)) if callable(self.path) else self.path) for at in t]).reshape(-1, 2)

    def _place(self, given):
        pair = floats(given)
        if pair is None or pair.shape != (2,):
            raise InputError(
                f"Deviation: path = {given!r:.100} must be two finite numbers (x, y), m, or a function of time that gives them"
            )
        return pair

    def _rates(self, model, t, span):
        """d path/dt at the times, (count, 2), by differences that end at the model's kinks."""
        if not callable(self.path):
            return np.zeros((len(t), 2))
        wide = FRAMES_WIDE * (span or 1.0)
        rooms = [around(model.kinks(at - wide, at + wide), at) for at in t]
        return np.array([along(lambda s, at=at: self._place(self.path(float(at + s))), wide, room) for at, room in zip(t, rooms)])


def _pull(model, point):
    """A function (q (frames, n), forces (frames, 2) on the point) that gives what acts on each coordinate, (frames, n)."""
    if model.is_scene:
        return lambda q, forces: model.pulled(model.side(point).x, forces)
    return lambda q, forces: np.einsum("fxk,fx->fk", _slopes(model, point, q), forces)


def _slopes(model, point, q):
    """d position/dq of a model of one's own, (frames, 2, n), by differences."""
    sizes = np.maximum(1.0, np.abs(q).max(axis=0, initial=0.0))
    ways = sizes[:, None] * np.eye(model.n)
    found = [along(lambda s, way=way: model.position(point, q + s * way)) / size for size, way in zip(sizes, ways)]
    return np.stack(found, axis=2)
