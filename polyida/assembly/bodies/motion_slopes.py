"""Slopes of the velocities with which a run starts in the motions that bodies were given and in their masses."""

from typing import NamedTuple

import numpy as np

from polyida.assembly.bodies.motion import NOTHING, asked_of_motions, motions_given, rigid_motions
from polyida.given import complex_of_pairs, pairs_of


class MotionSlopes(NamedTuple):
    """Of `bar . velocity_at(model, t, q)`.

    motions (3 bodies,): in velocity along x and y, and spin, that each body was given. left, right: in masses, `left^T dM right` of M's
    change dM, (n,) each. centres_left, centres_right: likewise, of the change of the bodies' own M alone, which moves their centres.
    v (n,), lam, kappa (m,): in profiles, `left . d(phi_q^T lam) + kappa . d(phi_q v + phi_t)`.
    """

    motions: np.ndarray
    left: np.ndarray
    right: np.ndarray
    centres_left: np.ndarray
    centres_right: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    kappa: np.ndarray


def motion_slopes(model, t, q, bar):
    """The MotionSlopes, with the motions w and their change c, `G c + Y^T lam = 0`, `Y (w + c) + phi_t = 0`, Y = phi_q R, G = R^T M R.

    Adjoint to that, `G g + Y^T kappa = R^T bar`, `Y g = 0`: the slope in w is `s = R^T bar - Y^T kappa`, that in G `-g^T dG c`, that in
    the rows `-g^T dY^T lam - kappa^T (dY (w + c) + dphi_t)`. A centre that moves by dx turns the velocity v that is meant into
    `v - i spin dx`, `dx = T^H dM (z - T x_G) / m`.
    """
    wanted, R = motions_given(model), rigid_motions(model, q)
    rows, roots = asked_of_motions(model, t, q, R)
    least = np.linalg.pinv(rows @ roots, rcond=NOTHING)
    pushed, rate = R.T @ bar, rows @ wanted + model.phi_t(t, q)
    kappa = least.T @ (roots.T @ pushed)
    motions, change = pushed - rows.T @ kappa, -roots @ (least @ rate)
    g = roots @ (roots.T @ motions)
    centres = _centres(model, motions, wanted, q)
    return MotionSlopes(motions, -(R @ g), R @ change, *centres, R @ (wanted + change), least.T @ (least @ rate), -kappa)


def _centres(model, motions, wanted, q):
    """What dM is multiplied by from left and right where it moves the centres of bodies."""
    left, right = np.zeros((2, model.n_nodes), complex)
    z = complex_of_pairs(model.reference + q.reshape(-1, 2))
    for k, placed in enumerate((*model.bodies, *model.few)):
        mass = np.vdot(placed.pull, placed.translation).real or 1.0
        centre = np.vdot(placed.pull, z[placed.pairs]) / mass
        slope, spin = complex(*motions[3 * k : 3 * k + 2]), wanted[3 * k + 2]
        left[placed.pairs] = slope * 1j * spin / mass * placed.translation
        right[placed.pairs] = z[placed.pairs] - placed.translation * centre
    return pairs_of(left).ravel(), pairs_of(right).ravel()
