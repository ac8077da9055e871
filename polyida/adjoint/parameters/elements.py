"""Forces of one force element over the states of a run."""

import numpy as np

from polyida.adjoint.parameters.driven.times import over
from polyida.force.force_element import numbers_of
from polyida.profile import Profile


def at_sides(own, x):
    """What x (k, n) is at the sides of an OwnForce, (k, sides, 2)."""
    return (own.A @ x.T).T.reshape(len(x), -1, 2)


def element_work(own, element, work):
    """`-w . A^T f` of each entry, (k,), of an element on the sides of an OwnForce, which is of one like it."""
    x, v = own.rest + at_sides(own, work.q), at_sides(own, work.v)
    forces = (_by_law if element.compiled_law else _in_python)(element, work.t, x, v)
    return -np.einsum("kie,kie->k", at_sides(own, work.w), forces)


def _by_law(element, t, x, v):
    law, forces, given = element.compiled_law, np.full(x.shape, np.nan), numbers_of(element)
    data = np.empty((len(t), len(given)))
    for i, number in enumerate(given):
        data[:, i] = over(number, t) if isinstance(number, Profile) else number
    for k, at in enumerate(t.tolist()):
        law(at, x[k], v[k], data[k], forces[k])
    return forces


def _in_python(element, t, x, v):
    return np.array([element.forces(*state) for state in zip(t.tolist(), x, v)]).reshape(x.shape)
