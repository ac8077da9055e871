"""Bodies that can be placed anew: what gives them their place, their size, and how they move in it while all hold on to them."""

from functools import cached_property

import numpy as np

from polyida.body.body import BodyPoint, points_of
from polyida.body.plate import Plate
from polyida.errors import InputError
from polyida.given import complex_of_pairs, settle

MISPLACED = 1e-9  # of a body's size and distance, by which its points may miss the place that its origin and angle give them


class Placed:
    """A body in its place: centre, complex, m, the mean of its nodes or named points; size, m, their root mean square from there.

    A body without `origin` and `angle`, of its own or of the plate that it is made of, cannot be moved: `part` is None.
    """

    def __init__(self, name, body, extent):
        self.name, self.body, self.part = name, body, _placing(body)
        places = places_of(body)
        self.centre = places.mean()
        self.size = float(np.sqrt(np.mean(np.abs(places - self.centre) ** 2))) or extent

    def arm(self, side, part):
        """(how far it goes with a shift by one, its arm in a turn, complex) of an attachment's "point" or "direction", which only turns.

        Directions at named points of a body made of a plate do not: they are given in the axes of the drawing.
        """
        if part == "point":
            return 1.0, complex(*side.point) - self.centre
        return 0.0, 0j if self.part is not self.body and isinstance(side, BodyPoint) else complex(*side.direction)

    def move(self, shift, turn):
        """Move it by `shift`, complex, m, and turn it about its centre by `turn`, rad, in place; the longest way of a point, m."""
        before = places_of(self.body)
        rotation = np.exp(1j * turn)
        origin = complex(rotation * (complex(*self.part.origin) - self.centre) + self.centre + shift)
        self.settle((origin.real, origin.imag), float(self.part.angle + turn))
        wanted = rotation * (before - self.centre) + self.centre + shift
        if np.abs(places_of(self.body) - wanted).max() > MISPLACED * (self.size + np.abs(wanted).max()):
            raise InputError(
                f"Scene.assemble: {self.body.label} has origin and angle, but its points do not follow them; let its "
                "coordinates() be those of angle 0 at (0, 0), turned by the angle and moved to the origin"
            )
        return float(np.abs(wanted - before).max())

    @property
    def placement(self):
        """(origin, angle) as they are now."""
        return self.part.origin, self.part.angle

    def settle(self, origin, angle):
        """Give it an origin and an angle, and forget what was derived from others."""
        settle(self.part, origin=origin, angle=angle)
        for part in (self.part, self.body):
            for name in _derived(type(part)):
                part.__dict__.pop(name, None)


def _placing(body):
    """What has the origin and angle of a body: itself or its plate; None where nothing has."""
    return next((part for part in (body, getattr(body, "plate", None)) if hasattr(part, "origin") and hasattr(part, "angle")), None)


def places_of(body):
    """Nodes of a plate or of that which a body is made of, named points of another, (k,) complex, m."""
    plate = body if isinstance(body, Plate) else body.plate
    points = np.array([point.point for point in points_of(body)]) if plate is None else plate.points
    return complex_of_pairs(points)


def _derived(kind):
    return [name for base in kind.__mro__ for name, value in vars(base).items() if isinstance(value, cached_property)]
