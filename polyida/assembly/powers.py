"""Powers of a scene's parts at an instant."""

import numpy as np

from polyida.assembly.equilibrium import add_damping
from polyida.assembly.placement import dead_loads
from polyida.assembly.relaxation import relaxation_energies
from polyida.joint.formula import all_rows


class Powers:
    """{name: W} at an instant, of loads, of driven joints, of friction, of force elements beyond their energy, and of damping.

    A load has the power `f . v`, also gravity that follows a profile; a joint `lam . phi_t` of its rows (the force `-phi_q^T lam` on `v`, and
    `phi_q v = -phi_t`); an element `sum f . v + dE/dt`; damping of a plate a negative power. dissipating: names of those that only take energy.
    """

    def __init__(self, model):
        """Find the loads, driven rows, elements and damped bodies of a model that do work."""
        self.model = model
        self._loads, self._driven = dead_loads(model.parts, model.gravity, model.places), {}
        for name, part in model.joints.items():
            if any(row.driven for row in all_rows(part)):
                self._driven[name] = model.rows[name]
        self._elements = [own for own in model.own_forces if not own.strain]
        self._damped = [placed for placed in model.all_bodies if placed.damped]
        of_bodies = dict.fromkeys([*(body.name for body in self._damped), *model.strains])
        self._rubbing = {law.row: law.name for law in model.row_laws if not law.is_contact}
        elements = [own.name for own in self._elements if own.element.dissipates]
        self.dissipating = (*elements, *of_bodies, *dict.fromkeys(self._rubbing.values()))

    def __call__(self, t, q, v, lam):
        """{name: power, W} at a state, of loads, motors, friction, force elements and damping."""
        powers = {}
        for load in self._loads:
            powers[load.name] = powers.get(load.name, 0.0) + load.power(t, v)
        if self._driven:
            power = lam * self.model.phi_t(t, q)
            powers |= {name: float(power[rows].sum()) for name, rows in self._driven.items()}
        rates = self.model.phi_rate(t, q, v) if self._rubbing else ()
        for row, name in self._rubbing.items():
            powers[name] = powers.get(name, 0.0) - float(lam[row] * rates[row])
        known = self.model.compiled_energies(t, q, v) if self._elements else None
        for k, own in enumerate(self._elements):  # `sum f . v + dE/dt`, which is zero if its forces derive from its energy E
            powers[own.name] = own.power(t, q, v) if known is None else float(known[k, 1])
        if self.model.strains:
            at = q.reshape(-1, 2).copy(), v.reshape(-1, 2).copy()
            lost = relaxation_energies(self.model.arrays, *at)[1]
            powers |= {body.name: -power for body, power in zip(self.model.all_bodies, lost) if body.name in self.model.strains}
        if not self._damped:
            return powers
        u, speeds = q.reshape(-1, 2).copy(), v.reshape(-1, 2).copy()
        force = np.zeros_like(u)
        add_damping(self.model.arrays, u, speeds, np.empty_like(u), force)
        if self.model.uneven_drag is not None:
            force += (self.model.uneven_drag @ v).reshape(force.shape)
        for body in self._damped:
            powers[body.name] = powers.get(body.name, 0.0) - float(np.vdot(force[body.pairs], speeds[body.pairs]))
        return powers
