"""Slopes of the velocities with which a run starts in the motions that bodies were given and in their masses."""

from typing import NamedTuple

import numpy as np

from polyida.assembly.bodies.motion import NOTHING, asked_of_motions, motions_given, rigid_motions
from polyida.given import complex_of_pairs, pairs_of


class MotionSlopes(NamedTuple):
    """Of `bar . velocity_at(model, t, q)`.

    motions (3 bodies,): in velocity along x and y, and spin, that each body was given. left, right: in masses, `left^T dM right` of M's
    change dM, (n,) each. centres_left, centres_right: likewise, of the change of the bodies' own M alone, which moves their centres.
    """

    motions: np.ndarray
    left: np.ndarray
    right: np.ndarray
    centres_left: np.ndarray
    centres_right: np.ndarray


def motion_slopes(model, t, q, bar):
    """The MotionSlopes, with P = I - G^-1 Y^T (Y G^-1 Y^T)^+ Y, Y = phi_q R, G = R^T M R, and the change c of the motions w.

    Motions: `P^T R^T bar = s`. Metric: `-(R G^-1 s)^T dM R c`. A centre that moves by dx turns the velocity v that is meant into
    `v - i spin dx`, `dx = T^H dM (z - T x_G) / m`.
    """
    wanted, R = motions_given(model), rigid_motions(model, q)
    rows, roots = asked_of_motions(model, t, q, R) if model.m else (np.zeros((0, len(wanted))), np.zeros((len(wanted), 0)))
    least = roots @ np.linalg.pinv(rows @ roots, rcond=NOTHING) if model.m else np.zeros((len(wanted), 0))
    pushed = R.T @ bar
    motions = pushed - rows.T @ (least.T @ pushed)
    change = -least @ (rows @ wanted + model.phi_t(t, q))
    left, right = np.zeros((2, model.n_nodes), complex)
    z = complex_of_pairs(model.reference + q.reshape(-1, 2))
    for k, placed in enumerate((*model.bodies, *model.few)):
        mass = np.vdot(placed.pull, placed.translation).real or 1.0
        centre = np.vdot(placed.pull, z[placed.pairs]) / mass
        slope, spin = complex(*motions[3 * k : 3 * k + 2]), wanted[3 * k + 2]
        left[placed.pairs] = slope * 1j * spin / mass * placed.translation
        right[placed.pairs] = z[placed.pairs] - placed.translation * centre
    flat = lambda x: pairs_of(x).ravel()  # noqa: E731
    return MotionSlopes(motions, -(R @ (roots @ (roots.T @ motions))), R @ change, flat(left), flat(right))
