"""Mass of a scene: Hermitian on the pairs of q as complex numbers, constant, factored once."""

from functools import cached_property

import numpy as np

from polyida.assembly.arrays import concatenated
from polyida.assembly.drawn import Drawn
from polyida.given import on_pairs
from polyida.linear.lu import LU


class Masses(Drawn):
    """M of a scene with `bodies`, `few`, `arrays`, `pattern`, and `uneven_mass` where x and y of pairs carry different ones."""

    def mass(self, q=None):
        """Mass matrix, constant, (n, n) sparse."""
        return self._mass

    @cached_property
    def _mass(self):
        even = on_pairs(self._even_mass).tocsc()
        return even if self.uneven_mass is None else even + self.uneven_mass

    @cached_property
    def _even_mass(self):
        """The mass that x and y of pairs carry alike, Hermitian, (pairs, pairs); real where it can be."""
        from scipy.sparse import csr_array, diags_array

        (indptr, indices), s = self.pattern, self.arrays
        values = [body.operator.mass * density for body, density in zip(self.bodies, s.plates.body_density)]
        values = np.concatenate([concatenated(values, float), s.compact.mass @ (1, 1j)])
        weights = self.point_weights
        mass = csr_array((values, indices, indptr), shape=(self.n_nodes, self.n_nodes))
        mass = (mass + weights.conj().T @ diags_array(s.links.point_mass) @ weights).tocsc()
        if not mass.data.imag.any():
            mass.data = mass.data.real.copy()
        return mass

    def mass_inverse(self, b):
        """M^-1 b, b (n,) or (n, k), of a `solid` scene; M is factored once."""
        pairs = b.reshape(self.n_nodes, 2, -1)
        if np.isrealobj(self._even_mass.data):
            return self._mass_factor.solve(np.ascontiguousarray(pairs.reshape(self.n_nodes, -1))).reshape(b.shape)
        found = self._mass_factor.solve(pairs[:, 0] + 1j * pairs[:, 1])
        return np.stack([found.real, found.imag], axis=1).reshape(b.shape)

    @cached_property
    def _mass_factor(self):
        return LU(self._even_mass)

    @cached_property
    def translation(self):
        """By how much each pair of q moves where all bodies move by one, (pairs,), complex."""
        return np.concatenate([np.zeros(0, complex), *(placed.translation for placed in (*self.bodies, *self.few))])

    @property
    def lightest(self):
        """Mass of its lightest body, kg."""
        return min(placed.whole_mass for placed in (*self.bodies, *self.few))
