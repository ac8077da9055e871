"""Energies and powers of a scene: strain energy, potential of gravity, energies of force elements, and the power of all that is no energy."""

import numpy as np

from polyida.assembly import equilibrium as compiled
from polyida.assembly.own_forces import NEAR
from polyida.assembly.own_laws import energies_and_powers
from polyida.assembly.powers import Powers
from polyida.assembly.relaxation import relaxation_energies
from polyida.assembly.scene_bodies import SceneBodies
from polyida.model.differences import FIRST_ORDER_STEP


class SceneEnergies(SceneBodies):
    """The part of SceneModel with its energies, J, and powers, W, at q (n,) and v (n,); v matters for energies that depend on states."""

    def potential(self, q):
        """Strain energy, energy of force elements and potential of gravity, J, relative to the reference configuration."""
        return sum(self.potentials(q))

    def potentials(self, q, v=None):
        """(potential of gravity and force elements, strain energy), J; v is needed if energies depend on states."""
        energies = self.element_energies(q, v)
        elements = sum((energy for own, energy in zip(self.own_forces, energies) if not own.strain), 0.0)
        return self.gravity_potential(q) + elements, self.strain_energy(q, v, energies)

    def element_energies(self, q, v=None):
        """Energies, J, of the force elements and elastic forces in `own_forces`; v is needed if they depend on states."""
        if not self.own_forces:
            return ()
        v = np.zeros(self.n) if v is None else v
        known = self.compiled_energies(0.0, q, v)
        return [own.energy(own.places(q), own.velocities(v)) for own in self.own_forces] if known is None else known[:, 0].tolist()

    def compiled_energies(self, t, q, v):
        """(energy, J, work beyond it, W) of each of `own_forces`, (., 2), from compiled code; None if one is Python or gives nan."""
        if any(one.addresses for one in self.callbacks):
            return None
        result = np.empty((len(self.own_forces), 2))
        nodal = self._nodal(np.array(q, float)), self._nodal(np.array(v, float))
        energies_and_powers(self.laws, self.arrays.links, self.drives(t), *nodal, FIRST_ORDER_STEP * NEAR, result)
        return result if np.isfinite(result).all() else None

    def strain_energy(self, q, v=None, energies=None):
        """Elastic energy of all bodies, J; of viscoelastic plates with the states in v, which are zero by default.

        energies: those of `element_energies`, if they are known.
        """
        energies = self.element_energies(q) if energies is None else energies
        energy = compiled.strain_energy(self.arrays, self._nodal(q)) + sum(e for own, e in zip(self.own_forces, energies) if own.strain)
        if self.strains:
            energy += relaxation_energies(self.arrays, self._nodal(q), self._nodal(np.zeros(self.n) if v is None else v))[0]
        return energy

    def gravity_potential(self, q):
        """Potential of steady gravity on bodies and masses, J, zero at q = 0. Gravity that follows a profile does work instead."""
        at_points = self.arrays.links.point_mass @ (self.dz(q) @ self.arrays.links.gravity)
        return -float(np.sum(self.arrays.plates.weight * self._nodal(q)) + at_points)

    @property
    def dissipating(self):
        return self.once(Powers).dissipating

    def powers(self, t, q, v, lam):
        return self.once(Powers)(t, q, v, lam)
