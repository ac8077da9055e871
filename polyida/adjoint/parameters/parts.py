"""Parameters of a scene's parts whose slopes have formulas: plates and their cells, loads, point masses, motions that bodies start with."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from polyida.adjoint.parameters.drives import over
from polyida.adjoint.parameters.parameter import OfPart, Shared
from polyida.assembly.bodies.motion import motion_of
from polyida.assembly.factors import mass_work, stiffness_work
from polyida.assembly.loads import gravity_at
from polyida.body.rigid_body import PointMass
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.given import complex_of_pairs

FIELDS = {PointLoad: "force", EdgeTraction: "traction"}


@dataclass(frozen=True, eq=False)
class OfCells(OfPart):
    """The factor of each polygon's stiffness or mass, (cells,).

    path: ("stiffness",) or ("mass",). by_cell: of AdjointMultipliers, {plate: slope in the factors (cells,)}. starts: of (t, q, bar), the
    same of the start's velocities, or None.
    """

    by_cell: Callable[[Any], dict]
    starts: Callable

    def slope(self, work):
        """`w_e . f_e` or `w_e^T M_e (a + drag v - gravity)` of each polygon e at factor 1."""
        return self.by_cell(work)[self.part]

    def start(self, t, q, bar):
        """Of the masses, where joints change the motions that bodies were given, or a spin is one about their centre."""
        found = self.starts(t, q, bar) if self.path == ("mass",) else None
        return found and found[self.part]

    def replaced(self, value):
        """The scene with other factors."""
        stiffness, mass = self.model.factors[self.part]
        changed = (stiffness, value) if self.path == ("mass",) else (value, mass)
        return self.model.with_factors(**{**self.model.factors, self.part: changed})


@dataclass(frozen=True, eq=False)
class OfPlate(OfPart):
    """A number p of a plate with which forces grow alike: the slope is the sum of their works over p.

    works: of AdjointMultipliers, each the sum over the plate of one kind of force. starts: of (t, q, bar), the same of the start's velocities.
    """

    works: tuple
    starts: Callable

    def slope(self, work):
        """Of the forces that grow with it."""
        return sum(each(work) for each in self.works) / self.value

    def start(self, t, q, bar):
        """As of the masses of all cells."""
        found = self.starts(t, q, bar)
        return found and float(self.model.factors[self.part][1] @ found[self.part]) / self.value


def of_plates(model, slopes):
    """The parameters of all full plates of a scene. slopes: of (t, q, bar), the MotionSlopes of the start."""
    stiffness, mass = Shared(lambda model, work: stiffness_work(model, work.q, work.v, work.w), model), Shared(_mass, model)
    starts = lambda t, q, bar: _starts(model, slopes(t, q, bar))  # noqa: E731
    loads = [(key, part) for key, part in model.parts.items() if isinstance(part, EdgeTraction)]  # which grow with the thickness
    for body in model.bodies:
        name, plate, factors = body.name, body.plate, model.factors[body.name]
        stiff, heavy = (partial(_whole, name, *each) for each in zip(factors, (stiffness, mass)))
        pulls = [lambda work, key=key: load_work(model, key, work) for key, part in loads if part.at.body is plate]
        yield OfCells(f"{name}.stiffness", factors[0], model, name, ("stiffness",), stiffness, starts)
        yield OfCells(f"{name}.mass", factors[1], model, name, ("mass",), mass, starts)
        yield OfPlate(f"{name}.E", plate.material.E, model, name, ("material", "E"), (stiff,), lambda *_: None)
        yield OfPlate(f"{name}.thickness", plate.thickness, model, name, ("thickness",), (stiff, heavy, *pulls), starts)
        yield OfPlate(f"{name}.rho", plate.material.rho, model, name, ("material", "rho"), (heavy,), starts)


def _whole(name, factors, by_cell, work):
    """The sum over the cells of a plate."""
    return float(factors @ by_cell(work)[name])


def _starts(model, slopes):
    """{plate: slope of the start's velocities in its cells' masses}, or None."""
    if slopes is None:
        return None
    both = ((slopes.right, slopes.left), (slopes.centres_right, slopes.centres_left))
    return mass_work(model, *(np.stack(each) for each in zip(*both)))


def _mass(model, work):
    """What M is multiplied by: accelerations, less gravity, and of a damped plate velocities times its drag."""
    b = work.a
    for body in model.bodies:
        if drag := body.plate.material.mass_damping:
            of_body, b = slice(2 * body.pairs.start, 2 * body.pairs.stop), np.array(b) if b is work.a else b
            b[:, of_body] += drag * work.v[:, of_body]
    return mass_work(model, b, work.w, np.array([gravity_at(model.gravity, t) for t in work.t.tolist()]).reshape(-1, 2))


def load_work(model, name, work, given=None):
    """`-w . F` of a load's forces F over all entries; given: another force or traction (2,) of it."""
    load = model.parts[name]
    part = load if given is None else replace(load, **{FIELDS[type(load)]: given})
    pairs, forces = model.places[id(load.at.body)].loaded(load.at, part.nodal())
    w = work.w.reshape(len(work.t), -1, 2)[:, pairs]
    return -float(over(load.profile, work.t) @ np.einsum("kie,ie->k", w, forces))


class OfLoad(OfPart):
    """The force, N, or traction, Pa, of a load, (2,)."""

    def slope(self, work):
        """Of a force of one along each axis."""
        return np.array([load_work(self.model, self.part, work, tuple(axis)) for axis in np.eye(2)])


@dataclass(frozen=True, eq=False)
class OfMass(OfPart):
    """A point mass, kg. slopes: of (t, q, bar), the MotionSlopes of the start."""

    slopes: Callable

    def slope(self, work):
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


def of_loads(model, slopes):
    """The parameters of the loads and point masses of a scene."""
    for name, part in model.parts.items():
        if type(part) in FIELDS:
            key = FIELDS[type(part)]
            yield OfLoad(f"{name}.{key}", np.array(getattr(part, key)), model, name, (key,))
        elif isinstance(part, PointMass):
            yield OfMass(f"{name}.mass", part.mass, model, name, ("mass",), slopes)


@dataclass(frozen=True, eq=False)
class OfMotion(OfPart):
    """Velocity (2,), m/s, or spin, rad/s, that a body starts with.

    place: among the motions of all bodies. slopes: of (t, q, bar), the MotionSlopes. asked: where the body was given no motion.
    """

    place: int | slice
    slopes: Callable
    asked: bool = False
    why = "the body was given no velocity and no spin"

    def slope(self, work):
        """Nothing: no equation has it."""
        return np.zeros_like(self.value) if np.ndim(self.value) else 0.0

    def start(self, t, q, bar):
        """Of the velocities that the bodies' joints make of it."""
        return self.slopes(t, q, bar).motions[self.place]


def of_motions(model, slopes):
    """Velocity and spin of all bodies that can be given them."""
    for k, placed in enumerate((*model.bodies, *model.few)):
        part, (velocity, spin) = model.parts[placed.name], motion_of(model.parts[placed.name])
        inside = ("plate",) if "plate" in (field.name for field in fields(part)) else ()
        known = {field.name for field in fields(part.plate if inside else part)}
        each = ("velocity", np.array([velocity.real, velocity.imag]), slice(3 * k, 3 * k + 2)), ("spin", spin, 3 * k + 2)
        for key, value, place in each:
            if key in known:
                rests = not (velocity or spin)
                yield OfMotion(f"{placed.name}.{key}", value, model, placed.name, (*inside, key), place, slopes, rests)
