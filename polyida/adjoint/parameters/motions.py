"""The motions with which bodies start as parameters."""

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np

from polyida.adjoint.parameters.parameter import Parameter
from polyida.adjoint.parameters.rebuilt import changed, with_part
from polyida.assembly.bodies.motion import motion_of


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
