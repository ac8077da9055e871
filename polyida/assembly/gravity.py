"""Gravity whose components follow profiles of time: forces on all pairs of q, as of loads."""

from dataclasses import dataclass

import numpy as np

from polyida.body.point_mass import PointMass
from polyida.profile import Profile

NAME = "gravity"  # what its work is called


def steady(gravity):
    """(gx, gy), m/s^2, of numbers and profiles: zero for a profile."""
    return tuple(0.0 if isinstance(g, Profile) else float(g) for g in gravity)


def gravity_at(gravity, t):
    """(gx, gy), m/s^2, of numbers and profiles, at time t."""
    return tuple(float(g(t)) if isinstance(g, Profile) else float(g) for g in gravity)


def largest(gravity):
    """|g|, m/s^2, the largest of profiles at the start and at their kinks."""
    values = [max(abs(g(t)) for t in (0.0, *g.kinks)) if isinstance(g, Profile) else abs(g) for g in gravity]
    return float(np.hypot(*values))


@dataclass(frozen=True)
class Pull:
    """A component of gravity that follows a profile: forces (pairs, 2), N, of an acceleration of one along its axis."""

    profile: Profile
    forces: np.ndarray

    def power(self, t, v):
        """W, of velocities v (n,)."""
        return float(self.profile.value(t) * np.vdot(self.forces, v))


def pulls_of(gravity, parts, places):
    """The Pulls of the components that are profiles. places: {id of a body: its place}."""
    return [Pull(g, _pull(parts, places, axis)) for g, axis in zip(gravity, np.eye(2)) if isinstance(g, Profile)]


def _pull(parts, places, axis):
    forces = np.zeros((max(place.pairs.stop for place in places.values()), 2))
    for place in places.values():
        forces[place.pairs] += place.weight(axis)
    for mass in parts.values():
        if isinstance(mass, PointMass):
            pairs, values = places[id(mass.at.body)].loaded(mass.at, mass.at.share(mass.mass * axis))
            np.add.at(forces, pairs, values)
    return forces
