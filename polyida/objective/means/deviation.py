"""How far a point is from where it is to be."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import complex_of_pairs, floats
from polyida.joint.attachment import Attachment
from polyida.keywords import named_keywords
from polyida.model.differences import along
from polyida.objective.means.time_mean import TimeMean, named, rates
from polyida.objective.objective import asked
from polyida.objective.slopes import Slopes


@named_keywords
@dataclass(frozen=True, eq=False)
class Deviation(TimeMean):
    """Time mean of `|x(t) - path(t)|^2`, m2, of a point x.

    point: what `run.position` takes: the name of a mass, load or joint, the part itself, or an attachment. path: a function of time that
    gives (x, y), m, or a constant pair. Raises InputError for a path that is neither, and of a run for a point that is not in its model.
    """

    point: Any
    path: Callable[[float], ArrayLike] | ArrayLike
    _of_material = True

    def __post_init__(self):
        if not callable(self.path):
            self._place(self.path)

    def named(self, model: Any) -> "Deviation":
        """By the name of its part, or of the body that an attachment is of."""
        body = named(model, self.point.body) if isinstance(self.point, Attachment) else None
        return replace(self, point=OnBody(body, self.point) if isinstance(body, str) else named(model, self.point))

    def _seen(self, model, span):
        """The squared distance."""
        point = self.point.on(model) if isinstance(self.point, OnBody) else self.point
        pull = _pull(model, point)

        def look(frames):
            gap = model.position(point, frames.q) - [self._at(t) for t in frames.t.tolist()]

            def back(factor):
                toward = 2.0 * factor[:, None] * gap
                return Slopes(q=pull(frames.q, toward), t=lambda: -np.sum(toward * rates(model, self._at, frames.t, span), axis=1))

            return lambda: np.sum(gap**2, axis=1), back

        return look

    def _at(self, t):
        advice = "; it must be a function of time"
        return self._place(asked(f"Deviation: path({t:.6g})", self.path, t, advice=advice) if callable(self.path) else self.path)

    def _place(self, given):
        pair = floats(given)
        if pair is None or pair.shape != (2,):
            raise InputError(
                f"Deviation: path = {given!r:.100} must be two finite numbers (x, y), m, or a function of time that gives them"
            )
        return pair


class OnBody(NamedTuple):
    """An attachment, and the name of its body."""

    body: str
    side: Attachment

    def on(self, model):
        """The attachment on the body of that name."""
        return self.side.on(model.parts[self.body])


def _pull(model, point):
    """A function (q (frames, n), forces (frames, 2) on the point) that gives what acts on each coordinate, (frames, n)."""
    if model.is_scene:
        return lambda q, forces: model.pulled((model.side(point), "point"), complex_of_pairs(forces))
    return lambda q, forces: np.einsum("fxk,fx->fk", _slopes(model, point, q), forces)


def _slopes(model, point, q):
    """d position/dq of a model of one's own, (frames, 2, n), by differences."""
    sizes = np.maximum(1.0, np.abs(q).max(axis=0, initial=0.0))
    ways = sizes[:, None] * np.eye(model.n)
    found = [along(lambda s, way=way: model.position(point, q + s * way)) / size for size, way in zip(sizes, ways)]
    return np.stack(found, axis=2)
