"""Loads and point masses as parameters."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from polyida.adjoint.parameters.driven.times import over
from polyida.adjoint.parameters.parameter import Parameter
from polyida.adjoint.parameters.rebuilt import changed, with_part
from polyida.assembly.loads import gravity_at
from polyida.body.point_mass import PointMass
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.given import complex_of_pairs

FIELDS = {PointLoad: "force", EdgeTraction: "traction"}


def load_work(model, name, work, given=None):
    """`-w . F` of a load's forces F over all entries; given: another force or traction (2,) of it."""
    load = model.parts[name]
    part = load if given is None else replace(load, **{FIELDS[type(load)]: given})
    pairs, forces = model.places[id(load.at.body)].loaded(load.at, part.nodal())
    w = work.w.reshape(len(work.t), -1, 2)[:, pairs]
    return -float(over(load.profile, work.t) @ np.einsum("kie,ie->k", w, forces))


@dataclass(frozen=True, eq=False)
class OfLoad(Parameter):
    """The force, N, or traction, Pa, of a load, (2,)."""

    part: str

    def work(self, work):
        """Of a force of one along each axis."""
        return np.array([load_work(self.model, self.part, work, tuple(axis)) for axis in np.eye(2)])

    def replaced(self, value):
        """The scene with another force."""
        load = self.model.parts[self.part]
        return with_part(self.model, self.part, changed(load, (FIELDS[type(load)],), value))


@dataclass(frozen=True, eq=False)
class OfMass(Parameter):
    """A point mass, kg. slopes: of (t, q, bar), the MotionSlopes of the start."""

    part: str
    slopes: Callable

    def work(self, work):
        """`w_z . (a_z - gravity)` at its point z."""
        w, a = (self._at_point(x) for x in (work.w, work.a))
        pull = np.array([complex(*gravity_at(self.model.gravity, t)) for t in work.t.tolist()])
        return float(np.vdot(w, a - pull).real)

    def start(self, t, q, bar):
        """Where joints change the motions that bodies were given, in the metric of M."""
        slopes = self.slopes(t, q, bar)
        return slopes and float(np.vdot(self._at_point(slopes.left[None]), self._at_point(slopes.right[None])).real)

    def _at_point(self, x):
        pairs, weights = self.model.held(self.model.parts[self.part].at)
        return complex_of_pairs(x.reshape(len(x), -1, 2)[:, pairs]) @ weights

    def replaced(self, value):
        """The scene with another mass there."""
        return with_part(self.model, self.part, changed(self.model.parts[self.part], ("mass",), value))


def of_loads(model, slopes):
    """The parameters of the loads and point masses of a scene."""
    for name, part in model.parts.items():
        if type(part) in FIELDS:
            key = FIELDS[type(part)]
            yield OfLoad(f"{name}.{key}", np.array(getattr(part, key)), model, name)
        elif isinstance(part, PointMass):
            yield OfMass(f"{name}.mass", part.mass, model, name, slopes)
