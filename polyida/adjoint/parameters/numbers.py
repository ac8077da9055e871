"""Numbers whose slopes are differences: every other number of a scene's parts, and the attributes that a user's model names."""

import warnings
from dataclasses import fields, replace
from functools import partial, reduce
from typing import Any

import numpy as np

from polyida.adjoint.parameters.drives import element_work
from polyida.adjoint.parameters.parameter import OfPart, Parameter, changed, total, with_part
from polyida.assembly.bodies.motion import moves_at
from polyida.assembly.own.forces import OwnForce
from polyida.body.body import Body
from polyida.body.field_body import FieldBody
from polyida.body.plate import Plate
from polyida.errors import InputError
from polyida.force.force_element import ForceElement
from polyida.given import floats
from polyida.joint.formula import rows_of
from polyida.joint.joint import Joint
from polyida.model import NEARBY
from polyida.model.differences import EVERYWHERE, along
from polyida.model.guarded import guard

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
        return self._slope(lambda value: self._total(value, work))

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

    def _total(self, value, work):
        part = self.model.parts[self.part]
        if isinstance(part, ForceElement):
            return element_work(OwnForce(self.part, part, self.model), self._part(value), work).sum()
        return total(self.replaced(value), work)

    def _part(self, value):
        """The part of another number; a reduced plate with the fields that it has, or, where these change with it, with those nearest to
        them in the new span: in it the motion is the same whatever its fields are.
        """
        part: Any = self.model.parts[self.part]
        placed = next((placed for placed in self.model.few if placed.user is part), None)
        made = part.made_fields(placed.body) if placed else {}
        if made and self.path[-1] == SHAPES:
            anew = with_part(self.model, self.part, changed(replace(part, **dict.fromkeys(made)), self.path, value))
            made = part.made_fields(next(other for other in anew.few if other.name == placed.name).body, placed.body)
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

    def slope(self, work):
        """By the model's residual_p and phi_p; the slopes of rate and bias by differences."""
        result, model = np.zeros(np.shape(self.value)), guard(self.model)
        phi = lambda t, q, v: self.model.phi_p(self.name, t, q)  # noqa: E731
        rate, bias = (partial(self._slope, function) for function in ("phi_rate", "phi_bias"))
        for k, state in enumerate(zip(work.t.tolist(), work.q, work.v, work.a, work.lam)):
            result = result + work.w[k] @ model.residual_p(self.name, *state)
            for given, slope in ((work.mu, phi), (work.kappa, rate), (work.nu, bias)):
                if given is not None and given[k].any():
                    result = result + given[k] @ slope(*state[:3])
        return result if result.ndim else float(result)

    def _slope(self, function, t, q, v):
        return self.model.slope_p(self.name, lambda model: getattr(model, function)(t, q, v), t)

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
