"""Loads, point masses and the motions with which bodies start as parameters."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from polyida.adjoint.parameters.driven.times import over
from polyida.adjoint.parameters.parameter import Parameter
from polyida.adjoint.parameters.rebuilt import changed, with_part
from polyida.assembly.bodies.motion import motion_of
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


@dataclass(frozen=True, eq=False)
class OfMotion(Parameter):
    """Velocity (2,), m/s, or spin, rad/s, that a body starts with.

    part: its name. path: the field of the part, or of its plate. place: among the motions of all bodies. slopes: of (t, q, bar), the
    MotionSlopes. asked: where the body was given no motion.
    """

    part: str
    path: tuple
    place: int | slice
    slopes: Callable
    asked: bool = False
    why = "the body was given no velocity and no spin"

    def work(self, work):
        """Nothing: no equation has it."""
        return np.zeros_like(self.value) if np.ndim(self.value) else 0.0

    def start(self, t, q, bar):
        """Of the velocities that the bodies' joints make of it."""
        return self.slopes(t, q, bar).motions[self.place]

    def replaced(self, value):
        """The scene with another motion of the body."""
        given = tuple(value) if np.ndim(value) else value
        return with_part(self.model, self.part, changed(self.model.parts[self.part], self.path, given))


def of_motions(model, slopes):
    """Velocity and spin of all bodies that can be given them."""
    for k, placed in enumerate((*model.bodies, *model.few)):
        part = model.parts[placed.name]
        held = getattr(part, "plate", None)
        velocity, spin = motion_of(part)
        known, inside = {field.name for field in fields(held or part)}, ("plate",) if held else ()
        each = ("velocity", np.array([velocity.real, velocity.imag]), slice(3 * k, 3 * k + 2)), ("spin", spin, 3 * k + 2)
        for key, value, place in each:
            if key in known:
                rests = not (velocity or spin)
                yield OfMotion(f"{placed.name}.{key}", value, model, placed.name, (*inside, key), place, slopes, rests)
