"""The powers of a scene's parts that work on it from outside or without a potential."""

import numpy as np

from polyida.assembly.bodies.damping import add_damping
from polyida.assembly.loads import dead_loads
from polyida.joint.formula import Row, rows_of
from polyida.model.differences import along

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
        return found | (self._damping(q, v) if self._damped else {})

    def _damping(self, q, v):
        u, speeds = q.reshape(-1, 2).copy(), v.reshape(-1, 2).copy()
        force = np.zeros_like(u)
        add_damping(self.model.arrays, u, speeds, np.empty_like(u), force)
        if self.model.uneven_drag is not None:
            force += (self.model.uneven_drag @ v).reshape(force.shape)
        return {body.name: -float(np.vdot(force[body.pairs], speeds[body.pairs])) for body in self._damped}


def _driven(part):
    """Whether a profile drives one of the rows of a joint."""
    return any(row.driven for row in rows_of(part.rows()) if isinstance(row, Row))


def _beyond_energy(own, t, x, v):
    """`sum f . v + dE/dt` of a force element, W: zero where its forces are those of its energy E."""
    power, pace = float(np.vdot(own.forces(t, x, v), v)), float(np.abs(v / own.sizes).max())
    if not pace:
        return 0.0
    return power + pace * float(along(lambda s: own.energy(x + s / pace * v), NEAR))
