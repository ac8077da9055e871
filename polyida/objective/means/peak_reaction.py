"""How much a joint has to bear."""

from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.given import is_one_of, settle
from polyida.joint.joint import Joint
from polyida.keywords import named_keywords
from polyida.model.differences import along
from polyida.objective.means.bodies import named
from polyida.objective.means.time_mean import TimeMean, power
from polyida.objective.slopes import Slopes
from polyida.results.tables import quantity

UNITS = ("N", "N m")


@named_keywords
@dataclass(frozen=True, eq=False)
class PeakReaction(TimeMean):
    """`(time mean of |R|^p)^(1/p)`, R what a joint does to its side b, as `run.reaction` tells it, N or N m.

    It lies below the largest |R|, the nearer the larger p. joint: by name or itself. unit: "N" or "N m", the components that are meant of
    a joint that gives forces and a moment. Raises InputError for a p below 1 or an unknown unit, and of a run for what is no joint of its
    scene, for a joint of both units without `unit`, and for one whose reaction is not unique.
    """

    joint: Any
    p: float = 8.0
    unit: str | None = None
    _of_material = True

    def __post_init__(self):
        settle(self, p=power("PeakReaction", self.p))
        if not (self.unit is None or is_one_of(self.unit, UNITS)):
            raise InputError(f'PeakReaction: unit = {self.unit!r:.100} must be "N" or "N m", or None')

    def _seen(self, model, span):
        """|R|."""
        name = self._name(model)
        joint, columns = model.joints[name], model.rows[name]
        chosen = self._components(model, name)

        def look(frames):
            told = Told(model, joint, frames.q, frames.lam[:, columns], chosen)
            size = np.linalg.norm(told.reaction, axis=1)

            def back(factor):
                with np.errstate(divide="ignore", invalid="ignore"):
                    toward = np.where(size[:, None] > 0, (factor / size)[:, None] * told.reaction, 0.0)
                lam = np.zeros_like(frames.lam)
                lam[:, columns] = told.by_multipliers(toward)
                return Slopes(q=told.by_coordinates(toward), lam=lam)

            return lambda: size, back

        return look

    def _name(self, model):
        joints = {name: joint for name, joint in model.joints.items() if isinstance(joint, Joint)}
        name = named(model, self.joint)
        if not is_one_of(name, joints):
            raise InputError(f"PeakReaction: no joint is called {self.joint!r:.100}; known: {', '.join(map(repr, joints)) or 'none'}")
        if model.redundant is not None and not model.redundant.unique(name):
            raise InputError(f"PeakReaction: the reaction of {name!r} is not unique, constraints are redundant; it has no slopes")
        return name

    def named(self, model: Any) -> "PeakReaction":
        """By the joint's name."""
        return replace(self, joint=self._name(model))

    def _components(self, model, name):
        """Numbers of the components that are meant."""
        rows, joint = model.rows[name], model.joints[name]
        units = [quantity(model, name, k)[1] for k in range(len(joint.components) if joint.components else rows.stop - rows.start)]
        chosen = [k for k, unit in enumerate(units) if self.unit in (None, unit)]
        if not chosen or len({units[k] for k in chosen}) > 1:
            raise InputError(f"PeakReaction: the reaction of {name!r} is in {' and '.join(sorted(set(units)))}; give one of these as unit")
        return chosen


class Told:
    """The reaction of a joint over frames, (frames, chosen components), and the transposes of its slopes, by differences.

    It is a function of the multipliers and of the vectors that the joint asks for, in the order in which it does.
    """

    def __init__(self, model, joint, q, lam, chosen):
        self.model, self.joint, self.lam, self.chosen, self.vectors = model, joint, lam, chosen, []
        self.places = []

        def ask(vector):
            self.vectors.append(vector)
            self.places.append(model.values(vector, q))
            return self.places[-1]

        self.reaction = joint.reaction(lam, ask)[:, chosen]

    def by_multipliers(self, toward):
        """`dR/dlam^T toward`, (frames, rows)."""
        moved = lambda way: self.joint.reaction(self.lam + way, self._again())[:, self.chosen]  # noqa: E731
        return _against(moved, self.lam, toward)

    def by_coordinates(self, toward):
        """`dR/dq^T toward`, (frames, n)."""
        found = np.zeros((len(toward), self.model.n))
        for k, (vector, places) in enumerate(zip(self.vectors, self.places)):
            moved = lambda way, k=k: self.joint.reaction(self.lam, self._again(k, way))[:, self.chosen]  # noqa: E731
            found += self.model.pulled(vector, _against(moved, places, toward))
        return found

    def _again(self, number=-1, way=0.0):
        """What the joint asks for as it was, the vector of a number moved by `way`."""
        calls = count()
        return lambda vector: self.places[k] + way if (k := next(calls)) == number else self.places[k]


def _against(moved, x, toward):
    """`df/dx^T toward`, (frames, k), of f = moved(change of x (frames, k))."""
    ways = np.abs(x).max(axis=0, initial=0.0)
    ways = np.diag(np.where(ways > 0, ways, 1.0))
    return np.stack([np.sum(along(lambda s, way=way: moved(s * way)) * toward, axis=1) / way.max() for way in ways], axis=1)
