"""What plates are made of as parameters: stiffness and mass of each polygon, and the numbers of the whole."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from polyida.adjoint.parameters.loads import load_work
from polyida.adjoint.parameters.parameter import Parameter, Shared
from polyida.adjoint.parameters.rebuilt import changed, with_part
from polyida.assembly.factors import mass_work, stiffness_work
from polyida.assembly.loads import gravity_at
from polyida.force.loads import EdgeTraction

PATHS = {"thickness": ("thickness",), "E": ("material", "E"), "rho": ("material", "rho")}


@dataclass(frozen=True, eq=False)
class OfCells(Parameter):
    """The factor of each polygon's stiffness or mass, (cells,).

    plate: its name. works: of a Work, {plate: slope in the factors (cells,)}. starts: of (t, q, bar), the same of the start's velocities,
    or None. second: whether it is the mass.
    """

    plate: str
    works: Callable[[Any], dict]
    starts: Callable
    second: bool = False

    def work(self, work):
        """`w_e . f_e` or `w_e^T M_e (a + drag v - gravity)` of each polygon e at factor 1."""
        return self.works(work)[self.plate]

    def start(self, t, q, bar):
        """Of the masses, where joints change the motions that bodies were given, or a spin is one about their centre."""
        found = self.starts(t, q, bar) if self.second else None
        return found and found[self.plate]

    def replaced(self, value):
        """The scene with other factors."""
        stiffness, mass = self.model.factors[self.plate]
        changed = (stiffness, value) if self.second else (value, mass)
        return self.model.with_factors(**{**self.model.factors, self.plate: changed})


@dataclass(frozen=True, eq=False)
class OfPlate(Parameter):
    """A number p of a plate with which forces grow alike: `slope = sum of their works / p`.

    plate: its name. works: of a Work, each its sum over the plate. starts: of (t, q, bar), the same of the start's velocities.
    """

    plate: str
    works: tuple
    starts: Callable

    def work(self, work):
        """Of those forces that grow with it."""
        return sum(each(work) for each in self.works) / self.value

    def start(self, t, q, bar):
        """As of the masses of all cells."""
        found = self.starts(t, q, bar)
        return found and float(self.model.factors[self.plate][1] @ found[self.plate]) / self.value

    def replaced(self, value):
        """The scene with the plate of another number."""
        key = self.name.rpartition(".")[2]
        return with_part(self.model, self.plate, changed(self.model.parts[self.plate], PATHS[key], value))


def of_plates(model, slopes):
    """The parameters of all full plates of a scene. slopes: of (t, q, bar), the MotionSlopes of the start."""
    stiffness, mass = Shared(_stiffness, model), Shared(_mass, model)
    starts = lambda t, q, bar: _starts(model, slopes(t, q, bar))  # noqa: E731
    loads = [(key, part) for key, part in model.parts.items() if isinstance(part, EdgeTraction)]  # which grow with the thickness
    for body in model.bodies:
        name, plate, factors = body.name, body.plate, model.factors[body.name]
        stiff, heavy = (_whole(name, *each) for each in zip(factors, (stiffness, mass)))
        pulls = [lambda work, key=key: load_work(model, key, work) for key, part in loads if part.at.body is plate]
        yield OfCells(f"{name}.stiffness", factors[0], model, name, stiffness, starts)
        yield OfCells(f"{name}.mass", factors[1], model, name, mass, starts, True)
        yield OfPlate(f"{name}.E", plate.material.E, model, name, (stiff,), lambda *_: None)
        yield OfPlate(f"{name}.thickness", plate.thickness, model, name, (stiff, heavy, *pulls), starts)
        yield OfPlate(f"{name}.rho", plate.material.rho, model, name, (heavy,), starts)


def _whole(name, factors, works):
    """Of a Work, the sum over the cells of a plate."""
    return lambda work: float(factors @ works(work)[name])


def _starts(model, slopes):
    """{plate: slope of the start's velocities in its cells' masses}, or None."""
    if slopes is None:
        return None
    both = ((slopes.right, slopes.left), (slopes.centres_right, slopes.centres_left))
    return mass_work(model, *(np.stack(each) for each in zip(*both)))


def _stiffness(model, work):
    return stiffness_work(model, work.q, work.v, work.w)


def _mass(model, work):
    """What M is multiplied by: accelerations, less gravity, and of a damped plate velocities times its drag."""
    b = work.a
    for body in model.bodies:
        if drag := body.plate.material.mass_damping:
            of_body, b = slice(2 * body.pairs.start, 2 * body.pairs.stop), np.array(b) if b is work.a else b
            b[:, of_body] += drag * work.v[:, of_body]
    return mass_work(model, b, work.w, np.array([gravity_at(model.gravity, t) for t in work.t.tolist()]).reshape(-1, 2))
