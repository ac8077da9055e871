"""What a model depends on, by name: parameters of a scene's parts, whose slopes have formulas or are differences, and of a user's model."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial, reduce
from typing import Any

import numpy as np

from polyida.adjoint.parameter import AdjointMultipliers, OfPart, Parameter, Shared, changed, entries_of, total, values_of, with_part
from polyida.adjoint.profile_parameters import drive_works, element_work, in_time, of_profiles, over
from polyida.assembly.factors import mass_work, stiffness_work
from polyida.assembly.motion import motion_of, motion_slopes, moves_at
from polyida.assembly.own_forces import OwnForce
from polyida.assembly.placement import gravity_at
from polyida.body.body import Body
from polyida.body.plate import Plate
from polyida.body.rigid_body import FieldBody, PointMass
from polyida.errors import InputError
from polyida.force.force_element import ForceElement
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.joint.formula import rows_of
from polyida.joint.joint import Joint
from polyida.model import NEARBY
from polyida.model.differences import EVERYWHERE, along
from polyida.model.guarded import guard, unguarded, writes
from polyida.validation import complex_of_pairs, floats, read_only

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

    def starts(t, q, bar):  # {plate: slope of the start's velocities in its cells' masses}, or None
        if (found := slopes(t, q, bar)) is None:
            return None
        both = ((found.right, found.left), (found.centres_right, found.centres_left))
        return mass_work(model, *(np.stack(each) for each in zip(*both)))

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


POSITIVE = (0.0, float("inf"))
PLACING = ("origin", "angle", "velocity", "spin")  # of bodies: where they are and how they start
MATERIAL = ("nu", "viscosity", "mass_damping")
OF_REDUCED = ("E", "rho", *MATERIAL)
SHAPES = "nu"  # of numbers of a material the one that changes the modes of a plate: E and rho change their frequencies only


class OfField(OfPart):
    """A number in a field of a part, or of what stands in a field."""

    asked = True

    @property
    def changes_coordinates(self):
        """Of bodies."""
        return isinstance(self.model.parts[self.part], Body)

    @property
    def room(self):
        """Of what is not negative."""
        return POSITIVE if self.value == 0.0 else EVERYWHERE

    def slope(self, work):
        """By differences of fourth order, which for the zero of what is not negative look ahead only."""
        part = self.model.parts[self.part]
        if isinstance(part, ForceElement):
            own = OwnForce(self.part, part, self.model)
            return self._slope(lambda value: element_work(own, self._part(value), work).sum())
        return self._slope(lambda value: total(self.replaced(value), work))

    def start(self, t, q, bar):
        """The same, where the scene begins in motion, which is changed in the metric of M."""
        if isinstance(self.model.parts[self.part], ForceElement) or not moves_at(self.model, t, q):
            return None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that they are, which the run has told
            return self._slope(lambda value: bar @ self.replaced(value).initial_velocity(t, q))

    def of_model(self, function):
        """By differences."""
        return self._slope(lambda value: function(self.replaced(value)))

    def _slope(self, function):
        return float(along(lambda s: function(self.value + s), abs(self.value) or 1.0, self.room))

    def _part(self, value):
        """The part of another number; a reduced plate with the fields that it has, or, where these change with it, with those nearest to
        them in the new span: in it the motion is the same whatever its fields are.
        """
        part: Any = self.model.parts[self.part]
        placed = next((placed for placed in self.model.few if placed.user is part), None)
        made = part.fields_to_store(placed.body) if placed else {}
        if made and self.path[-1] == SHAPES:
            anew = with_part(self.model, self.part, changed(replace(part, **dict.fromkeys(made)), self.path, value))
            made = part.fields_to_store(next(other for other in anew.few if other.name == placed.name).body, placed.body)
        return changed(replace(part, **made), self.path, value)

    def replaced(self, value):
        """The scene with the part of another number."""
        return with_part(self.model, self.part, self._part(value))


def of_fields(model):
    """The parameters of the numbers of all parts but loads, point masses, and what the drawing must agree with."""
    for name, part in model.parts.items():
        for path, value in _numbers(part):
            yield OfField(f"{name}.{path[-1]}", value, model, name, path)


def _numbers(part):
    """(names of fields, number) of a part."""
    if isinstance(part, Plate):
        yield from _inner(part, ("material",), MATERIAL)
        yield from _inner(part, (), ("tau",) if part.element == "virtual" else ())
    elif isinstance(part, FieldBody):
        yield from _inner(part, ("plate", "material"), OF_REDUCED)
        yield from _inner(part, ("plate",), ("thickness",))
    elif isinstance(part, (Body, ForceElement)) or isinstance(part, Joint) and all(row.driven for row in rows_of(part.facing().rows())):
        known = [field.name for field in fields(part) if field.init and isinstance(getattr(part, field.name), float)]
        yield from _inner(part, (), [key for key in known if not (isinstance(part, Body) and key in PLACING)])


def _inner(part, path, keys):
    for key in keys:
        yield (*path, key), reduce(getattr, (*path, key), part)


class OfOwnModel(Parameter):
    """An attribute of a model, a number or an array."""

    @cached_property
    def _values(self):
        """{value: `values_of` the copy of the model that has it}."""
        return {}

    def slope(self, work):
        """By the model's residual_p and phi_p as far as it writes these; by differences of copies of the model."""
        result, own = np.zeros(np.shape(self.value)), unguarded(self.model)
        if writes(own, "residual_p"):
            result = result + self._written("residual_p", work.w, *work[:5])
            work = work._replace(w=np.zeros_like(work.w))
        if writes(own, "phi_p") and work.mu is not None:
            result = result + self._written("phi_p", work.mu, *work[:2])
            work = work._replace(mu=None)
        near = work.t if writes(own, "kinks") else np.zeros(0)
        for t in np.unique(near).tolist():
            result = result + self._by_differences(entries_of(work, near == t), t)
        result = result if len(near) else result + self._by_differences(work, None)
        return result if result.ndim else float(result)

    def _written(self, function, factors, times, *states):
        """Of entries with these factors, by a function that the model writes: it is guarded only if its results are wrong."""
        which = np.flatnonzero(factors.any(axis=1))
        at = list(zip(times[which].tolist(), *(read_only(x[which]) for x in states)))
        shape, own = (len(which), factors.shape[1], *np.shape(self.value)), unguarded(self.model)
        found = floats([getattr(own, function)(self.name, *state) for state in at])
        if found is None or found.shape != shape:
            found = np.array([getattr(guard(self.model), function)(self.name, *state) for state in at]).reshape(shape)
        return np.tensordot(factors[which], found, 2)

    def _by_differences(self, work, t):
        """Of entries that no kink that moves with the number passes; t: their time, or None if the model has no kinks."""
        work = AdjointMultipliers(*work[:6], *(None if x is None or not x.any() else x for x in work[6:]))
        work = work if work.w.any() else work._replace(w=np.zeros((0, work.w.shape[1])))
        weights = np.concatenate([x.ravel() for x in work[5:] if x is not None])
        if not weights.any():
            return 0.0

        def values(model):
            key = np.asarray(model.parameter(self.name), float).tobytes()
            found = self._values.get(key) or values_of(guard(model))
            if t is None:  # the same few values for all entries
                self._values[key] = found
            return found(work)

        return np.tensordot(weights, self.model.slope_p(self.name, values, t), 1)

    def of_model(self, function):
        """By differences of copies of the model."""
        slope = self.model.slope_p(self.name, lambda model: np.array([function(model)]))[0]
        return slope if np.ndim(slope) else float(slope)

    def replaced(self, value):
        """The model with the attribute changed."""
        return self.model.replaced(self.name, value)

    def start(self, t, q, bar):
        """By differences of the velocities that the model gives."""
        found = bar @ self.model.slope_p(self.name, lambda model: model.initial_velocity(t, q))
        return found if found.any() else None

    def kinks(self, t0, t1):
        """By differences of the model's kinks."""
        if np.ndim(self.value):
            return {}
        step = NEARBY * (abs(self.value) or 1.0)
        near = [self.replaced(self.value + s).kinks(t0, t1) for s in (-step, step)]
        known = self.model.kinks(t0, t1)
        if not len(near[0]) == len(near[1]) == len(known):
            raise InputError(f"{self.name}: the model's kinks between {t0:g} and {t1:g} s come and go where it changes a little")
        moved = np.subtract(near[1], near[0]) / (2 * step)
        return {kink: speed for kink, speed in zip(known, moved.tolist()) if speed}


def of_own(model: Any) -> list[Parameter]:
    """A Parameter for each name that a model lists. Raises InputError for one that is no number or array of numbers."""
    if isinstance(model.parameters, str):
        raise InputError(f"{model!r}: parameters = {model.parameters!r} must be a tuple of names, such as ({model.parameters!r},)")
    return [OfOwnModel(name, _value(model, name), model) for name in model.parameters]


def _value(model, name):
    value = floats(model.parameter(name))
    if value is None:
        raise InputError(f"{model!r}: its parameter {name!r} must be an attribute that is a number or an array of numbers")
    return value if value.ndim else float(value)


__all__ = ["Parameter", "in_time", "parameters_of"]


def parameters_of(model: Any) -> dict[str, Parameter]:
    """{name: Parameter} of a model: of a scene those of its parts, of a model of one's own those that its `parameters` names."""
    found = _of_scene(model) if model.is_scene else of_own(model)
    return {parameter.name: parameter for parameter in found}


def _of_scene(model):
    def slopes(t, q, bar):
        return motion_slopes(model, t, q, bar)

    def changes(t, q, bar):
        return slopes(t, q, bar) if moves_at(model, t, q) else None

    yield from of_fields(model)
    yield from of_plates(model, changes)
    yield from of_loads(model, changes)
    yield from of_motions(model, slopes)
    yield from of_profiles(model, Shared(drive_works, model), changes)
