"""Rigid motions of bodies: velocities at the start, and plates that a run hardly deforms or whose modes leave much out."""

import warnings
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from polyida.assembly import compact
from polyida.assembly.placement import gravity_at
from polyida.errors import InputError
from polyida.validation import complex_of_pairs, is_number, pairs_of, vector2

NOTHING = 1e-12  # of the largest: masses and inertias of a motion that are none
CHANGED = 0.1  # of the root of the kinetic energy, by which joints may change a motion before it is told
TOLD = 3  # bodies that a warning names
MANY = 100  # rows from which on a sparse factor pays
INDEPENDENT = 1e-8  # smallest pivot of the Gram matrix of unit rows that proves that none depends on others
COMPARED = 16  # frames of a run whose strain energies are compared; the full plate is looked at where a body's is largest
ENOUGH = 2e-4  # of a plate's size: it is off by about as much as its modes leave out, where it bends far by more
LOOKS = 8  # frames of a run in which a full plate is compared with its best rigid motion
CLEAR = 1e-2  # of what a run resolves: as little as that is nothing, beyond doubt
RESOLVED = 1e-6  # of a plate's size, by a run without a tolerance
TRAVEL = 1e-3  # of its size: a plate that moves by less tells nothing, for it may only begin to move
NAMED = 3  # plates that are named, where there are more


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


def hint_of_left_out(model, t, frames, accelerations):
    """What is said of plates whose modes leave much out, of a run's t (frames,), q and a (frames, n); empty where there are none."""
    found = {name: left for name, left in left_out(model, t, frames, accelerations).items() if left[2] > ENOUGH}
    worst = sorted(found, key=lambda name: found[name][2], reverse=True)[:NAMED]
    told = ", ".join(f"{name!r} ({1e3 * found[name][1]:.2g} mm, {100 * found[name][0]:.2g} % of its strain energy)" for name in worst)
    return f"the modes of {told} leave much out: take more, or modes of a run of the full plate (pi.pod_modes)" if found else ""


def left_out(model, t, frames, accelerations):
    """{name: (share of its strain energy, m, m over its size)} that the modes of each reduced plate leave out, where that energy is largest.

    The residual `r = M x'' + f(x) - M g` of the full plate at the recovered motion, in the plate's frame, would move it by d, `K d + C^T l = -r`
    with what holds it kept, `C d = 0`: energy `-d^T r / 2`, of which no force of a joint is a part.
    """
    reduced = [(number, placed) for number, placed in enumerate(model.few) if placed.body.truncation_error is not None]
    if not (reduced and len(frames)):
        return {}
    chosen, found = np.unique(np.linspace(0, len(frames) - 1, COMPARED).astype(int)), {}
    pairs = np.array([frames[k] for k in chosen], float).reshape(len(chosen), -1, 2)
    energies = np.empty((len(chosen), len(model.few)))
    compact.energies(model.arrays.compact, pairs, energies)
    for number, placed in reduced:
        worst = int(np.argmax(energies[:, number]))
        k, whole = chosen[worst], energies[worst, number]
        if whole > 0:
            a = np.asarray(accelerations[k], float).reshape(-1, 2)
            moved, pulled = (complex_of_pairs(x[placed.pairs]) for x in (pairs[worst], a))
            energy, far = placed.body.truncation_error(moved, pulled, complex(*gravity_at(model.gravity, t[k])))
            found[placed.name] = energy / whole, far, far / float(np.linalg.norm(np.ptp(placed.body.points, axis=0)))
    return found


def hint_of_rigid(model, frames, rtol):
    """Name the full plates that move, and leave the best rigid motion by far less than a run resolves; empty if there are none.

    frames: the run's q (frames, n), of which LOOKS are looked at. rtol: the run's tolerance relative to a length; None: RESOLVED.
    """
    if not model.is_scene or not len(frames):
        return ""
    looks = [np.asarray(frames[k]).reshape(-1, 2) for k in np.unique(np.linspace(0, len(frames) - 1, LOOKS).astype(int))]
    names = []
    for body in model.bodies:
        moves = [frame[body.nodes] for frame in looks]
        size = float(np.linalg.norm(np.ptp(body.points, axis=0)))
        travels = max(float(np.abs(move - moves[0]).max()) for move in moves) > TRAVEL * size
        if travels and all(deformation(body.points, move) < CLEAR * (rtol or RESOLVED) * size for move in moves):
            names.append(body.name)
    plates = ", ".join(map(repr, names[:NAMED])) + f" and {len(names) - NAMED} more" * (len(names) > NAMED)
    deform = "deforms" if len(names) == 1 else "deform"
    return f"{plates} {deform} far less than the run resolves: such a plate may as well be rigid" if names else ""


def deformation(points, displacements):
    """Largest distance of nodes, m, from where the rigid motion with the least sum of squares takes them; both (nodes, 2)."""
    x, y = (z - z.mean() for z in (points @ (1, 1j), (points + displacements) @ (1, 1j)))
    turn = np.vdot(x, y)
    return float(np.abs(y - turn / abs(turn) * x).max()) if turn else np.inf
