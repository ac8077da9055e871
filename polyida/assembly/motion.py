"""How bodies move at the start: as rigid, by the velocity and spin that they were given, as far as their joints let them; slopes of that."""

import warnings
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from polyida.errors import InputError
from polyida.validation import complex_of_pairs, is_number, pairs_of, vector2

NOTHING = 1e-12  # of the largest: masses and inertias of a motion that are none
CHANGED = 0.1  # of the root of the kinetic energy, by which joints may change a motion before it is told
TOLD = 3  # bodies that a warning names
MANY = 100  # rows from which on a sparse factor pays
INDEPENDENT = 1e-8  # smallest pivot of the Gram matrix of unit rows that proves that none depends on others


def motion_of(body):
    """(velocity, complex, m/s, spin, rad/s) that a body was given, or the plate that it is made of. Raises InputError."""
    given = getattr(body, "plate", None) or body
    if not is_number(given.spin):
        raise InputError(f"{given.label}: spin = {given.spin!r} must be a finite number of rad/s")
    return complex(*vector2(given.label, "velocity", given.velocity)), float(given.spin)


def velocity_at(model, t, q):
    """Velocities (n,) of a scene at (t, q) whose bodies move as they were given, changed by what joints ask of bodies that stay rigid.

    The change has the least kinetic energy, `min (w - w_0)^T R^T M R (w - w_0)`, `phi_q R w + phi_t = 0`: R (n, 3 bodies), w velocity and
    spin of each; where these rows contradict each other they are met in the least-squares sense. A warning says where it is large. Bodies
    that were given no motion follow joints that move at t by the same rule, so that the start is continuous in what they are given.
    """
    if not moves_at(model, t, q):
        return np.zeros(model.n)
    wanted, R = motions_given(model), rigid_motions(model, q)
    changed = wanted + _change(model, t, q, R, wanted)
    _warn_of_change(model, [placed.name for placed in (*model.bodies, *model.few)], R, wanted, changed)
    return R @ changed


def moves_at(model, t, q):
    """Whether a scene that begins at (t, q) moves: bodies were given motions, or joints move then."""
    return bool(motions_given(model).any() or (model.m and model.phi_t(t, q).any()))


def motions_given(model):
    """Velocity along x and y, m/s, and spin, rad/s, that each body was given, (3 bodies,)."""
    given = (motion_of(getattr(placed, "plate", None) or placed.user) for placed in (*model.bodies, *model.few))
    return np.array([[v.real, v.imag, spin] for v, spin in given]).ravel()


def rigid_motions(model, q):
    """R, (n, 3 bodies), sparse: the velocities of q for a unit of velocity along x, along y, and of spin, of each body.

    Coordinates z of one rigid body move by `T V + i spin (z - T x_G)`, V that of its centre of mass, `x_G = T^H M z / T^H M T`, zero of a
    body without mass.
    """
    from scipy.sparse import block_diag

    z = complex_of_pairs(model.reference + q.reshape(-1, 2))
    columns = []
    for placed in (*model.bodies, *model.few):
        T, here = placed.translation, z[placed.pairs]
        centre = np.vdot(placed.pull, here) / (np.vdot(placed.pull, T) or 1.0)
        units = [T * velocity + 1j * spin * (here - T * centre) for velocity, spin in ((1.0, 0.0), (1j, 0.0), (0.0, 1.0))]
        columns.append(np.stack([pairs_of(unit).ravel() for unit in units], axis=1))
    return block_diag(columns, format="csr")


def _change(model, t, q, R, wanted):
    """The least change of the motions that `phi_q R w + phi_t = 0` asks for, (3 bodies,)."""
    if not model.m:
        return np.zeros_like(wanted)
    rows, roots = asked_of_motions(model, t, q, R)
    A, b = rows @ roots, rows @ wanted + model.phi_t(t, q)
    if A.shape[0] > MANY:  # independent rows: by their Gram matrix, refined once
        from scipy.sparse.linalg import splu

        lengths = np.sqrt(A.multiply(A).sum(axis=1))
        some = np.flatnonzero(lengths > NOTHING * lengths.max())  # others keep bodies rigid
        rows, right = A[some] / lengths[some, None], b[some] / lengths[some]
        with suppress(RuntimeError):  # of a singular matrix
            gram = splu((rows @ rows.T).tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            if gram.U.diagonal().min() > INDEPENDENT:
                x = rows.T @ gram.solve(right)
                return -roots @ (x + rows.T @ gram.solve(right - rows @ x))
    return -roots @ np.linalg.lstsq(A.toarray(), b, rcond=NOTHING)[0]


def asked_of_motions(model, t, q, R):
    """`phi_q R` (m, 3 bodies), and roots with `roots roots^T` the inverse of the metric `R^T M R`, without motions that have no mass; sparse."""
    from scipy.sparse import block_diag, csr_array

    metric = csr_array(R.T @ model.mass(q) @ R)
    diagonal, blocks = metric.diagonal(), metric.tobsr((3, 3))  # a body's motions are coupled with each other alone
    units = (1.0 / np.sqrt(np.maximum(diagonal, NOTHING * diagonal.max()))).reshape(-1, 3)
    by_body = np.zeros((len(units), 3, 3))
    by_body[blocks.indices] = blocks.data
    sizes, axes = np.linalg.eigh(units[:, :, None] * by_body * units[:, None])
    roots = [unit[:, None] * axis[:, size > NOTHING] / np.sqrt(size[size > NOTHING]) for unit, size, axis in zip(units, sizes, axes)]
    return csr_array(model.phi_q(t, q) @ R), block_diag(roots, format="csr")


def _warn_of_change(model, names, R, wanted, changed):
    """Warn where joints change the motion that bodies were given by much; one far below what joints that move make of it counts as none."""
    M, change = model.mass(np.zeros(model.n)), changed - wanted

    def energy(w):
        return (R @ w) @ (M @ (R @ w))

    if not energy(change) > CHANGED**2 * energy(wanted) > CHANGED**4 * energy(changed):
        return
    share, told = np.sqrt(energy(change) / energy(wanted)), []
    energies = [energy(alone * change) for alone in np.eye(len(names)).repeat(3, axis=1)]
    for k in np.argsort(energies)[::-1][:TOLD]:
        (vx, vy, spin), (ux, uy, turn) = wanted[3 * k : 3 * k + 3], changed[3 * k : 3 * k + 3]
        told.append(f"{names[k]!r} from ({vx:.3g}, {vy:.3g}) m/s, {spin:.3g} rad/s to ({ux:.3g}, {uy:.3g}) m/s, {turn:.3g} rad/s")
    warnings.warn(
        f"the joints do not let the bodies move as given: they change the start by {100 * share:.0f} % (root of its kinetic energy), "
        f"{'; '.join(told)}; velocity is that of the centre of mass",
        stacklevel=2,
    )


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
    least = np.linalg.pinv((rows @ roots).toarray(), rcond=NOTHING)
    pushed, rate = R.T @ bar, rows @ wanted + model.phi_t(t, q)
    kappa = least.T @ (roots.T @ pushed)
    motions, change = pushed - rows.T @ kappa, -roots @ (least @ rate)
    g = roots @ (roots.T @ motions)
    left, right = np.zeros((2, model.n_nodes), complex)
    z = complex_of_pairs(model.reference + q.reshape(-1, 2))
    for k, placed in enumerate((*model.bodies, *model.few)):
        mass = np.vdot(placed.pull, placed.translation).real or 1.0
        centre = np.vdot(placed.pull, z[placed.pairs]) / mass
        slope, spin = complex(*motions[3 * k : 3 * k + 2]), wanted[3 * k + 2]
        left[placed.pairs] = slope * 1j * spin / mass * placed.translation
        right[placed.pairs] = z[placed.pairs] - placed.translation * centre
    centres = pairs_of(left).ravel(), pairs_of(right).ravel()
    return MotionSlopes(motions, -(R @ g), R @ change, *centres, R @ (wanted + change), least.T @ (least @ rate), -kappa)
