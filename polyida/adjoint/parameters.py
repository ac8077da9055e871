"""The parameters of a model by name: of a scene's parts, with slopes by formulas or differences, and of a user's model
(user_parameters.py).
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial, reduce
from typing import Any

import numpy as np

from polyida.adjoint.parameter import CachedByMultipliers, Parameter, PartParameter, SharedStates, total, with_field, with_part
from polyida.adjoint.profile_parameters import element_work, in_time, over, profile_parameters, profile_works
from polyida.adjoint.relaxation import relaxation_works, series_parameters
from polyida.adjoint.user_parameters import user_model_parameters
from polyida.assembly.factors import mass_work, stiffness_work
from polyida.assembly.motion import motion_of, motion_slopes, moves_at
from polyida.assembly.own_forces import OwnForce
from polyida.assembly.placement import gravity_over
from polyida.body.body import Body
from polyida.body.plate import Plate
from polyida.body.rigid_body import FieldBody, PointMass
from polyida.force.force_element import ForceElement
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.joint.formula import rows_of
from polyida.joint.joint import Joint
from polyida.model.differences import EVERYWHERE, along
from polyida.validation import complex_of_pairs, is_number

FIELDS = {PointLoad: "force", EdgeTraction: "traction"}


@dataclass(frozen=True, eq=False)
class CellFactors(PartParameter):
    """Factors of the stiffness or mass of each cell, (cells,).

    path: ("stiffness",) or ("mass",). by_cell: function of AdjointMultipliers -> {plate: slope (cells,)}. starts: function (t, q, adjoint)
    -> the same of the initial velocities, or None.
    """

    by_cell: CachedByMultipliers
    starts: Callable

    def prepare(self, works):
        """Compute the works of all cells of several AdjointMultipliers together."""
        self.by_cell.prepare(works)

    def slope(self, work):
        """`w_e . f_e` or `w_e^T M_e (a + drag v - gravity)` of each cell e at factor 1."""
        return self.by_cell(work)[self.part]

    def start(self, t, q, adjoint):
        """Slope by the masses, if joints change the given motions or a body has a spin about its centre of mass."""
        slopes = self.starts(t, q, adjoint) if self.path == ("mass",) else None
        return slopes and slopes[self.part]

    def replaced(self, value):
        """A copy of the scene with other factors."""
        stiffness, mass = self.model.factors[self.part]
        changed = (stiffness, value) if self.path == ("mass",) else (value, mass)
        return self.model.with_factors(**{**self.model.factors, self.part: changed})


@dataclass(frozen=True, eq=False)
class PlateNumber(PartParameter):
    """A number p of a plate to which forces are proportional: the slope is the sum of their works over p.

    works: functions of AdjointMultipliers, each the work of one kind of force on the plate. starts: as of CellFactors.
    """

    works: tuple
    starts: Callable

    def slope(self, work):
        """Sum of the works over p."""
        return sum(each(work) for each in self.works) / self.value

    def start(self, t, q, adjoint):
        """The slope of `adjoint . initial velocities` in p, by the masses of all cells; None if the start does not depend on them."""
        slopes = self.starts(t, q, adjoint)
        return slopes and float(self.model.factors[self.part][1] @ slopes[self.part]) / self.value


def plate_parameters(model, slopes, relaxing):
    """Yield the parameters of all full plates of a scene. slopes: function (t, q, adjoint) -> MotionSlopes of the start; relaxing: of
    AdjointMultipliers -> `relaxation_works`."""
    together = partial(_stiffness_works, relaxing), _mass_works
    stiffness, mass = (
        CachedByMultipliers(lambda model, work, each=each: each(model, SharedStates([work]))[0], model, each) for each in together
    )

    def starts(t, q, adjoint):  # {plate: slope of the start's velocities in its cells' masses}, or None
        """{plate: slopes of the start's velocities in the masses of its cells}, None if these do not matter."""
        if (motion := slopes(t, q, adjoint)) is None:
            return None
        both = ((motion.right, motion.left), (motion.centres_right, motion.centres_left))
        return mass_work(model, *(np.stack(each) for each in zip(*both)))

    loads = [(key, part) for key, part in model.parts.items() if isinstance(part, EdgeTraction)]  # which grow with the thickness
    for body in model.bodies:
        name, plate, factors = body.name, body.plate, model.factors[body.name]
        stiff, heavy = (partial(_plate_total, name, *each) for each in zip(factors, (stiffness, mass)))
        pulls = [lambda work, key=key: load_work(model, key, work) for key, part in loads if part.at.body is plate]
        yield CellFactors(f"{name}.stiffness", factors[0], model, name, ("stiffness",), stiffness, starts)
        yield CellFactors(f"{name}.mass", factors[1], model, name, ("mass",), mass, starts)
        yield PlateNumber(f"{name}.E", plate.material.E, model, name, ("material", "E"), (stiff,), lambda *_: None)
        yield PlateNumber(f"{name}.thickness", plate.thickness, model, name, ("thickness",), (stiff, heavy, *pulls), starts)
        yield PlateNumber(f"{name}.rho", plate.material.rho, model, name, ("material", "rho"), (heavy,), starts)


def _plate_total(name, factors, by_cell, work):
    """Sum over the cells of a plate: its factors times the slopes (cells,) by `by_cell` of AdjointMultipliers."""
    return float(factors @ by_cell(work)[name])


def _stiffness_works(relaxing, model, works):
    """[{plate: works of the elastic forces of its cells, and of those of relaxation in viscoelastic plates}] of SharedStates."""
    found = stiffness_work(model, works[0].q, works[0].v, works.w)
    relaxed = [relaxing(work)[1] if model.strains else {} for work in works]
    return [{name: each[c] + more.get(name, 0.0) for name, each in found.items()} for c, more in enumerate(relaxed)]


def _mass_works(model, works):
    """[{plate: works of M on accelerations less gravity, plus drag times velocities in a damped plate}] of SharedStates."""
    work, b = works[0], works[0].a
    for body in model.bodies:
        if drag := body.plate.material.mass_damping:
            of_body, b = slice(2 * body.pairs.start, 2 * body.pairs.stop), np.array(b) if b is work.a else b
            b[:, of_body] += drag * work.v[:, of_body]
    found = mass_work(model, b, works.w, gravity_over(model.gravity, work.t))
    return [{name: each[c] for name, each in found.items()} for c in range(len(works))]


def load_work(model, name, work, value=None):
    """Sum of `-w . F` over all entries, with the forces F of a load; value: another force or traction (2,) in its place."""
    load = model.parts[name]
    part = load if value is None else replace(load, **{FIELDS[type(load)]: value})
    pairs, forces = model.places[id(load.at.body)].loaded(load.at, part.nodal())
    w = work.w.reshape(len(work.t), -1, 2)[:, pairs]
    return -float(over(load.profile, work.t) @ np.einsum("kie,ie->k", w, forces))


class LoadForce(PartParameter):
    """The force, N, or traction, Pa, of a load, (2,)."""

    def slope(self, work):
        """Works of unit forces along both axes."""
        return np.array([load_work(self.model, self.part, work, tuple(axis)) for axis in np.eye(2)])


@dataclass(frozen=True, eq=False)
class PointMassNumber(PartParameter):
    """A point mass, kg. slopes: function (t, q, adjoint) -> MotionSlopes of the start."""

    slopes: Callable

    def slope(self, work):
        """`w_z . (a_z - gravity)` at its point z."""
        w, a = (self._at_point(x) for x in (work.w, work.a))
        return float(np.vdot(w, a - complex_of_pairs(gravity_over(self.model.gravity, work.t))).real)

    def start(self, t, q, adjoint):
        """Slope if joints change the given motions, in the metric of M."""
        slopes = self.slopes(t, q, adjoint)
        return slopes and float(np.vdot(self._at_point(slopes.left[None]), self._at_point(slopes.right[None])).real)

    def _at_point(self, x):
        """x (k, n) at the point, (k,) complex."""
        pairs, weights = self.model.pairs_and_weights(self.model.parts[self.part].at)
        return complex_of_pairs(x.reshape(len(x), -1, 2)[:, pairs]) @ weights


def load_parameters(model, slopes):
    """Yield the parameters of the loads and point masses of a scene."""
    for name, part in model.parts.items():
        if type(part) in FIELDS:
            key = FIELDS[type(part)]
            yield LoadForce(f"{name}.{key}", np.array(getattr(part, key)), model, name, (key,))
        elif isinstance(part, PointMass):
            yield PointMassNumber(f"{name}.mass", part.mass, model, name, ("mass",), slopes)


@dataclass(frozen=True, eq=False)
class InitialMotion(PartParameter):
    """Initial velocity (2,), m/s, or spin, rad/s, of a body.

    place: index in the motions of all bodies. slopes: function (t, q, adjoint) -> MotionSlopes. only_by_name: True if the body was given no
    motion.
    """

    place: int | slice
    slopes: Callable
    only_by_name: bool = False
    reason = "the body was given no velocity and no spin"

    def slope(self, work):
        """Zero: no equation depends on it."""
        return np.zeros_like(self.value) if np.ndim(self.value) else 0.0

    def start(self, t, q, adjoint):
        """Slope of the velocities that the joints make of the given motions."""
        return self.slopes(t, q, adjoint).motions[self.place]


def motion_parameters(model, slopes):
    """Yield velocity and spin of all bodies that have these fields."""
    for k, placed in enumerate(model.all_bodies):
        part, (velocity, spin) = model.parts[placed.name], motion_of(model.parts[placed.name])
        inside = ("plate",) if "plate" in (field.name for field in fields(part)) else ()
        known = {field.name for field in fields(part.plate if inside else part)}
        each = ("velocity", np.array([velocity.real, velocity.imag]), slice(3 * k, 3 * k + 2)), ("spin", spin, 3 * k + 2)
        for key, value, place in each:
            if key in known:
                rests = not (velocity or spin)
                yield InitialMotion(f"{placed.name}.{key}", value, model, placed.name, (*inside, key), place, slopes, rests)


POSITIVE = (0.0, float("inf"))
PLACING = ("origin", "angle", "velocity", "spin")  # of bodies: where they are and how they start
LAW = "friction"  # 0 in joints whose rows are all driven: another value adds a row
MATERIAL = ("nu", "viscosity", "mass_damping")
OF_REDUCED = ("E", "rho", *MATERIAL)
SHAPES = "nu"  # of numbers of a material the one that changes the modes of a plate: E and rho change their frequencies only


class FieldNumber(PartParameter):
    """A number in a field of a part, or in a nested field."""

    only_by_name = True

    @property
    def changes_coordinates(self):
        """True for fields of bodies: with another value the same q may be another position."""
        return isinstance(self.model.parts[self.part], Body)

    @property
    def bounds(self):
        """Values of at least 0 if the number is 0; else all."""
        return POSITIVE if self.value == 0.0 else EVERYWHERE

    def slope(self, work):
        """Differences of fourth order, one-sided at a bound."""
        part = self.model.parts[self.part]
        if isinstance(part, ForceElement):
            own = OwnForce(self.part, part, self.model)
            return self._slope(lambda value: element_work(own, self._part(value), work).sum())
        return self._slope(lambda value: total(self.replaced(value), work))

    def start(self, t, q, adjoint):
        """Differences of the initial velocities, if the scene starts in motion."""
        if isinstance(self.model.parts[self.part], ForceElement) or not moves_at(self.model, t, q):
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that they are, which the run has told
            return self._slope(lambda value: adjoint @ self.replaced(value).initial_velocity(t, q))

    def of_model(self, function):
        """The slope of a function of the model, by differences."""
        return self._slope(lambda value: function(self.replaced(value)))

    def _slope(self, function):
        """The derivative of a function of the number, one-sided at a bound."""
        return float(along(lambda s: function(self.value + s), abs(self.value) or 1.0, self.bounds))

    def _part(self, value):
        """A copy of the part with another number.

        A reduced plate keeps its fields; if they depend on the number (nu), it gets those of its new span that are nearest to the old ones,
        so that the motion does not depend on the choice.
        """
        part: Any = self.model.parts[self.part]
        placed = next((placed for placed in self.model.reduced_bodies if placed.user is part), None)
        stored = part.fields_to_store(placed.body) if placed else {}
        if stored and self.path[-1] == SHAPES:
            anew = with_part(self.model, self.part, with_field(replace(part, **dict.fromkeys(stored)), self.path, value))
            stored = part.fields_to_store(next(other for other in anew.reduced_bodies if other.name == placed.name).body, placed.body)
        return with_field(replace(part, **stored), self.path, value)

    def replaced(self, value):
        """A copy of the scene with another number in the part."""
        return with_part(self.model, self.part, self._part(value))


def field_parameters(model):
    """Yield the numbers in the fields of all parts, except loads, point masses and placements of bodies."""
    for name, part in model.parts.items():
        for path, value in _named_numbers(part):
            yield FieldNumber(f"{name}.{path[-1]}", value, model, name, path)


def _named_numbers(part):
    """Yield (names of the fields, number) of a part."""
    if isinstance(part, Plate):
        yield from _with_path(part, ("material",), MATERIAL)
        yield from _with_path(part, (), ("tau",) if part.element == "virtual" or part.order == 2 else ())
    elif isinstance(part, FieldBody):
        yield from _with_path(part, ("plate", "material"), OF_REDUCED)
        yield from _with_path(part, ("plate",), ("thickness",))
    elif isinstance(part, (Body, ForceElement, Joint)):
        numbers = {field.name: (getattr(part, field.name), field.type in (float, "float")) for field in fields(part) if field.init}
        known = [key for key, (value, is_float) in numbers.items() if isinstance(value, float) or is_float and is_number(value)]
        if known and (not isinstance(part, Joint) or all(row.driven for row in rows_of(part.facing().rows()))):
            omitted = PLACING if isinstance(part, Body) else (LAW,) if isinstance(part, Joint) else ()
            yield from _with_path(part, (), [key for key in known if key not in omitted])


def _with_path(part, path, keys):
    """Yield (names of the fields, number) of the fields with these keys."""
    for key in keys:
        yield (*path, key), reduce(getattr, (*path, key), part)


__all__ = ["Parameter", "in_time", "parameters_of"]


def parameters_of(model: Any) -> dict[str, Parameter]:
    """{name: Parameter} of a scene's parts, or of a user's model by its `parameters`."""
    parameters = _scene_parameters(model) if model.is_scene else user_model_parameters(model)
    return {parameter.name: parameter for parameter in parameters}


def _scene_parameters(model):
    """Yield the Parameters of all parts of a scene."""

    def slopes(t, q, adjoint):
        """The MotionSlopes of the scene's initial velocities at (t, q), for their adjoint (n,)."""
        return motion_slopes(model, t, q, adjoint)

    def changes(t, q, adjoint):
        """MotionSlopes of the start, None if no parameter of the scene changes it."""
        return slopes(t, q, adjoint) if moves_at(model, t, q) else None

    yield from field_parameters(model)
    relaxing = CachedByMultipliers(relaxation_works, model)
    yield from plate_parameters(model, changes, relaxing)
    yield from series_parameters(model, relaxing)
    yield from load_parameters(model, changes)
    yield from motion_parameters(model, slopes)
    if model.profiles:
        yield from profile_parameters(model, CachedByMultipliers(profile_works, model), changes)
