"""Loads in their scene, gravity whose components follow profiles of time, and the powers of the parts that work on a scene."""

from dataclasses import dataclass

import numpy as np

from polyida.assembly.equilibrium import add_damping
from polyida.body.rigid_body import PointMass
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.joint.formula import Row, rows_of
from polyida.model.differences import along
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


NEAR = 1e-3  # of the size of its sides' places, over which an element's energy is differentiated: contacts are that shallow


class Powers:
    """{name: W} at an instant, of loads, of joints whose rows a profile drives, of force elements beyond their energy, of damping.

    A load gives `f . v`, alike gravity that follows a profile, a joint `lam . phi_t` of its rows (the force `-phi_q^T lam` on `v`, and
    `phi_q v = -phi_t`), an element `sum f . v + dE/dt`, a plate minus what its damping takes. dissipating: names of those that only take.
    """

    def __init__(self, model):
        self.model = model
        self._loads = dead_loads(model.parts, model.gravity, model.places)
        self._driven = {name: model.rows[name] for name, part in model.joints.items() if _driven(part)}
        self._elements = [own for own in model.own_forces.each if not own.strain]
        self._damped = [placed for placed in (*model.bodies, *model.few) if placed.damped]
        self.dissipating = (*(own.name for own in self._elements if own.element.dissipates), *(body.name for body in self._damped))

    def __call__(self, t, q, v, lam):
        found = {}
        for load in self._loads:
            found[load.name] = found.get(load.name, 0.0) + load.power(t, v)
        if self._driven:
            power = lam * self.model.phi_t(t, q)
            found |= {name: float(power[rows].sum()) for name, rows in self._driven.items()}
        found |= {own.name: _beyond_energy(own, t, own.places(q), own.velocities(v)) for own in self._elements}
        if not self._damped:
            return found
        u, speeds = q.reshape(-1, 2).copy(), v.reshape(-1, 2).copy()
        force = np.zeros_like(u)
        add_damping(self.model.arrays, u, speeds, np.empty_like(u), force)
        if self.model.uneven_drag is not None:
            force += (self.model.uneven_drag @ v).reshape(force.shape)
        return found | {body.name: -float(np.vdot(force[body.pairs], speeds[body.pairs])) for body in self._damped}


def _driven(part):
    """Whether a profile drives one of the rows of a joint."""
    return any(row.driven for row in rows_of(part.rows()) if isinstance(row, Row))


def _beyond_energy(own, t, x, v):
    """`sum f . v + dE/dt` of a force element, W: zero where its forces are those of its energy E."""
    power, pace = float(np.vdot(own.forces(t, x, v), v)), float(np.abs(v / own.sizes).max())
    if not pace:
        return 0.0
    return power + pace * float(along(lambda s: own.energy(x + s / pace * v), NEAR))
