"""Loads in their scene, and gravity whose components follow profiles of time: forces on pairs of q."""

from dataclasses import dataclass

import numpy as np

from polyida.body.rigid_body import PointMass
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.profile import Profile

GRAVITY = "gravity"  # what its work is called


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
class Dead:
    """Forces (k, 2), N, on pairs of q, times a profile."""

    name: str
    profile: Profile
    pairs: np.ndarray
    forces: np.ndarray

    def power(self, t, v):
        """W, of velocities v (n,)."""
        return float(self.profile.value(t) * np.vdot(self.forces, v.reshape(-1, 2)[self.pairs]))


def dead_loads(parts, gravity, places):
    """The loads among the parts, and gravity's components that are profiles, all as Dead. places: {id of a body: its place}."""
    loads = [(name, part) for name, part in parts.items() if isinstance(part, (PointLoad, EdgeTraction))]
    found = [Dead(name, load.profile, *places[id(load.at.body)].loaded(load.at, load.nodal())) for name, load in loads]
    return found + [_pull(g, parts, places, axis) for g, axis in zip(gravity, np.eye(2)) if isinstance(g, Profile)]


def _pull(profile, parts, places, axis):
    """An acceleration of one along an axis, on all that has mass."""
    forces = np.zeros((max(place.pairs.stop for place in places.values()), 2))
    for place in places.values():
        forces[place.pairs] += place.weight(axis)
    for mass in parts.values():
        if isinstance(mass, PointMass):
            pairs, values = places[id(mass.at.body)].loaded(mass.at, mass.at.share(mass.mass * axis))
            np.add.at(forces, pairs, values)
    return Dead(GRAVITY, profile, np.arange(len(forces)), forces)
