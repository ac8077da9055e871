"""How far the rows of phi_q are from being linearly dependent, and which constraints would be it."""

from typing import NamedTuple

import numpy as np

from polyida.linear.lu import dense

MOST = 3  # constraints that a message names
FULL = 10_000  # numbers of phi_q up to which its zeros cost less than what tells them


class Rows(NamedTuple):
    """phi_q in the sizes of the coordinates, (m, n), the lengths of its rows, and the Gram matrix of the rows made of
    length one, (m, m), where they are above 0."""

    phi_q: object
    lengths: np.ndarray
    gram: np.ndarray


def coordinate_sizes(model, q):
    """`1 / sqrt(M_ii)`, (n,): what each coordinate is measured in, so that its unit does not matter; massless ones get the mean."""
    masses = np.abs(model.mass(q).diagonal())
    known = masses > 0
    return 1.0 / np.sqrt(np.where(known, masses, masses[known].mean() if known.any() else 1.0))


def rows_of(phi_q, sizes):
    """The Rows of a dense or sparse phi_q, its columns times the sizes (n,) of the coordinates."""
    if hasattr(phi_q, "toarray") and np.prod(phi_q.shape) > FULL:
        from scipy.sparse import diags_array

        phi_q = phi_q @ diags_array(sizes)
    else:
        phi_q = dense(phi_q) * sizes
    gram = dense(phi_q @ phi_q.T)
    lengths = np.sqrt(np.diag(gram))
    divisor = np.where(lengths > 0, lengths, 1.0)
    return Rows(phi_q, lengths, gram / np.outer(divisor, divisor))


def least(rows):
    """The smallest singular value of the unit rows, 0 to 1; nan where they are not finite."""
    if not np.isfinite(rows.gram).all():
        return float("nan")
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(rows.gram)[0])))


def involved(model, rows):
    """Names of the constraints, three at most, that weigh most in the nearest linear dependence, in their order: of joints, where
    rows by which bodies stay rigid are in it too."""
    weights = np.abs(np.linalg.eigh(rows.gram)[1][:, 0])
    of_joints = np.where([model.keeps_body(k) for k in range(len(weights))], 0.0, weights)
    weights = of_joints if of_joints.any() else weights
    heaviest = [int(k) for k in np.argsort(-weights)[:MOST] if weights[k] > 0.05 * weights.max()]
    return ", ".join(model.constraint_name(k) for k in sorted(heaviest))


def between(before, after):
    """The products of the unit rows of two Rows, (m, m)."""
    return dense(before.phi_q @ after.phi_q.T) / np.outer(before.lengths, after.lengths)


def way(products):
    """Frobenius norm of the change of the unit rows, from their products."""
    return float(np.sqrt(max(0.0, 2.0 * (len(products) - np.trace(products)))))


def cosine(before, after, products):
    """Of the angle by which the space of the rows has turned; -1 where a combination of them came back reversed."""
    (sign, size), sizes = np.linalg.slogdet(products), [np.linalg.slogdet(rows.gram)[1] for rows in (before, after)]
    return float(sign * np.exp(size - 0.5 * sum(sizes)))
