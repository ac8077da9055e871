"""Momentum of a scene: the same formula for every body, for all have coordinates that are points of the complex plane."""

import numpy as np

from polyida.given import complex_of_pairs


class Momenta:
    """`p = T^H M z'` and, about the origin, `L = Im(z^H M z')` of the pairs z (complex) of all bodies, masses at points included.

    T tells how much each pair moves with a translation of the whole: by one for nodes, `translation()` for other bodies.
    """

    def __init__(self, model):
        self.mass, self.rest, self.translation = model.mass(), model.reference, model.translation

    def __call__(self, q, v):
        z, momentum = (complex_of_pairs(x.reshape(-1, 2)) for x in (self.rest.ravel() + q, self.mass @ v))
        p = np.vdot(self.translation, momentum)
        return np.array([p.real, p.imag, np.vdot(z, momentum).imag])
