"""Momentum of a scene: the same formula for every body, for all have coordinates that are points of the complex plane."""

import numpy as np


class Momenta:
    """`p = T^H M z'` and, about the origin, `L = Im(z^H M z')` of the pairs z (complex) of all bodies, masses at points included.

    T tells how much each pair moves with a translation of the whole: by one for nodes, `translation()` for other bodies.
    """

    def __init__(self, model):
        own = [body.translation for body in model.own_bodies]
        n_plates = model.n_nodes - sum(map(len, own))
        self.mass, self.rest = model.mass(), model.reference
        self.translation = np.concatenate([np.ones(n_plates), *own])

    def __call__(self, q, v):
        z, momentum = _complex(self.rest.ravel() + q), _complex(self.mass @ v)
        p = self.translation.conj() @ momentum
        return np.array([p.real, p.imag, np.vdot(z, momentum).imag])


def _complex(pairs):
    return pairs[0::2] + 1j * pairs[1::2]
