"""Rigid motions of bodies: velocities at the start and their sensitivities; plates that a run hardly deforms, or whose modes leave much out."""

import warnings
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from polyida.assembly import reduced_kernels
from polyida.assembly.placement import gravity_at
from polyida.errors import InputError
from polyida.validation import complex_of_pairs, is_number, pairs_of, vector2

NO_MASS = 1e-12  # relative size of a mass or inertia of a motion that counts as zero
CHANGED = 0.1  # relative change of the root of the kinetic energy at the start that gives a warning
NAMED = 3  # bodies that a message names
MANY = 100  # rows above which a sparse factor is faster
INDEPENDENT = 1e-8  # smallest pivot of the Gram matrix of unit rows that proves independence
COMPARED = 16  # frames of a run whose strain energies are compared
ENOUGH = 2e-4  # of a plate's size: left out motion above which a reduced plate is named
LOOKS = 8  # frames of a run in which a full plate is compared with its best rigid motion
CLEAR = 1e-2  # of the tolerance of a run: deformations below it are insignificant
RESOLVED = 1e-6  # of a plate's size: resolution of a run without a tolerance
TRAVEL = 1e-3  # of its size: a plate that travels less is not judged, because it may only begin to move


def motion_of(body):
    """(velocity, complex, m/s, spin, rad/s) that the user gave to a body, or to the plate that it is made of. Raises InputError."""
    user = getattr(body, "plate", None) or body
    if not is_number(user.spin):
        raise InputError(f"{user.label}: spin = {user.spin!r} must be a finite number of rad/s")
    return complex(*vector2(user.label, "velocity", user.velocity)), float(user.spin)


def velocity_at(model, t, q):
    """Velocities (n,) of a scene at (t, q): the motions that the user gave to the bodies, changed as the joints demand of rigid bodies.

    The change w - w_0 has the least kinetic energy, `min (w - w_0)^T R^T M R (w - w_0)`, `phi_q R w + phi_t = 0`: R (n, 3 bodies), w
    velocity and spin of each body. Rows that contradict each other hold in the least-squares sense. A large change gives a warning. Bodies
    without a given motion follow moving joints by the same rule, so that the start depends continuously on the given motions.
    """
    if not moves_at(model, t, q):
        return np.zeros(model.n)
    prescribed, R = motions_given(model), rigid_motions(model, q)
    change = np.zeros_like(prescribed)
    if model.m:
        rows, roots = rows_of_motions(model, t, q, R)
        change = -roots @ _least_solution(rows @ roots, rows @ prescribed + model.phi_t(t, q))
    _warn_of_change(model, R, prescribed, change)
    return R @ (prescribed + change)


def moves_at(model, t, q):
    """True if the model of a scene prescribes motion from (t, q) on: bodies have given motions, or phi_t is not zero."""
    return bool(motions_given(model).any() or (model.m and model.phi_t(t, q).any()))


def motions_given(model):
    """Velocity along x and y, m/s, and spin, rad/s, that the user gave to each body, (3 bodies,)."""
    motions = (motion_of(placed.user) for placed in model.all_bodies)
    return np.array([[v.real, v.imag, spin] for v, spin in motions]).ravel()


def rigid_motions(model, q):
    """R, (n, 3 bodies), sparse: the velocities of q for unit velocities along x and y, and unit spin, of each body.

    Coordinates z of a rigid body move by `T V + i spin (z - T x_G)`: V is the velocity of its centre of mass, `x_G = T^H M z / T^H M T`,
    zero for a body without mass.
    """
    from scipy.sparse import block_diag, coo_array

    z = complex_of_pairs(model.reference + q.reshape(-1, 2))
    columns = []
    for placed in model.all_bodies:
        T, own = placed.translation, z[placed.pairs]
        centre = np.vdot(placed.translation_momentum, own) / (np.vdot(placed.translation_momentum, T) or 1.0)
        units = [T * velocity + 1j * spin * (own - T * centre) for velocity, spin in ((1.0, 0.0), (1j, 0.0), (0.0, 1.0))]
        columns.append(np.stack([pairs_of(unit).ravel() for unit in units], axis=1))
    columns += [np.zeros((2 * len(placed.rest), 0)) for placed in (*model.states.values(), *model.strains.values())]
    return block_diag([coo_array(one) for one in columns], format="csr")


def motions_as_a_whole(model, q):
    """Velocities of places q (k, n) in the three motions of a scene as one rigid body, (k, n, 3)."""
    z, T = complex_of_pairs(model.reference + q.reshape(len(q), -1, 2)), np.zeros(model.n // 2, complex)
    turned = np.zeros_like(z)
    for one in model.all_bodies:
        T[one.pairs] = one.translation
        turned[:, one.pairs] = 1j * z[:, one.pairs]
    units = (np.broadcast_to(T, z.shape), np.broadcast_to(1j * T, z.shape), turned)
    return np.stack([pairs_of(unit).reshape(len(q), -1) for unit in units], axis=2)


def moves_as_a_whole(model, t, q):
    """True if no constraint prevents any of the three motions of a scene as one rigid body."""
    if not model.m:
        return True
    motions, B = motions_as_a_whole(model, q[None])[0], model.phi_q(t, q)
    return bool(np.abs(B @ motions).max() <= NO_MASS * np.asarray(abs(B) @ abs(motions)).max())


def rows_of_motions(model, t, q, R):
    """`phi_q R` (m, 3 bodies), and roots with `roots roots^T` the inverse of the metric `R^T M R`, without motions that have no mass; sparse."""
    from scipy.sparse import block_diag, coo_array, csr_array

    metric = csr_array(R.T @ model.mass(q) @ R)
    diagonal, blocks = metric.diagonal(), metric.tobsr((3, 3))  # only the motions of one body are coupled
    units = (1.0 / np.sqrt(np.maximum(diagonal, NO_MASS * diagonal.max()))).reshape(-1, 3)
    by_body = np.zeros((len(units), 3, 3))
    by_body[blocks.indices] = blocks.data
    sizes, axes = np.linalg.eigh(units[:, :, None] * by_body * units[:, None])
    roots = [unit[:, None] * axis[:, size > NO_MASS] / np.sqrt(size[size > NO_MASS]) for unit, size, axis in zip(units, sizes, axes)]
    B = csr_array(model.phi_q(t, q))
    rows = B @ R
    resolved = abs(rows) > NO_MASS * (abs(B) @ abs(R))  # rows that keep bodies rigid are round-off here, which must not count
    return csr_array(rows.multiply(resolved)), block_diag([coo_array(root) for root in roots], format="csr")


def _least_solution(A, b):
    """The least x with `A x = b`, A sparse, in the least-squares sense."""
    lengths = np.sqrt(A.multiply(A).sum(axis=1))
    some = np.flatnonzero(lengths)  # other rows keep bodies rigid
    A, b = A[some], b[some]
    if len(some) > MANY:  # try the Gram matrix of independent rows, with one step of refinement
        from scipy.sparse.linalg import splu

        rows, right = A / lengths[some, None], b / lengths[some]
        with suppress(RuntimeError):  # of a singular matrix
            gram = splu((rows @ rows.T).tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
            if gram.U.diagonal().min() > INDEPENDENT:
                x = rows.T @ gram.solve(right)
                return x + rows.T @ gram.solve(right - rows @ x)
    return np.linalg.lstsq(A.toarray(), b, rcond=NO_MASS)[0]


def _warn_of_change(model, R, prescribed, change):
    """Warn if joints change the given motions by much. Given motions far below those of moving joints count as none."""
    M, changed, bodies = model.mass(np.zeros(model.n)), prescribed + change, model.all_bodies

    def energy(w):
        """Twice the kinetic energy, J, of rigid motions w, (3 bodies,), with the velocities R w."""
        return (R @ w) @ (M @ (R @ w))

    if not energy(change) > CHANGED**2 * energy(prescribed) > CHANGED**4 * energy(changed):
        return
    share, changes = np.sqrt(energy(change) / energy(prescribed)), []
    energies = [energy(alone * change) for alone in np.eye(len(bodies)).repeat(3, axis=1)]
    for k in np.argsort(energies)[::-1][:NAMED]:
        motions = np.array([prescribed[3 * k : 3 * k + 3], changed[3 * k : 3 * k + 3]])
        (vx, vy, spin), (ux, uy, turn) = np.where(np.abs(motions) > NO_MASS * np.abs(motions).max(), motions, 0.0)
        changes.append(f"{bodies[k].name!r} from ({vx:.3g}, {vy:.3g}) m/s, {spin:.3g} rad/s to ({ux:.3g}, {uy:.3g}) m/s, {turn:.3g} rad/s")
    warnings.warn(
        f"the joints do not let the bodies move as given: they change the start by {100 * share:.0f} % (root of its kinetic energy), "
        f"{'; '.join(changes)}; velocity is that of the centre of mass",
        stacklevel=2,
    )


class MotionSlopes(NamedTuple):
    """Derivatives of `bar . velocity_at(model, t, q)`."""

    motions: np.ndarray  # (3 bodies,) in the given velocity along x and y, and spin, of each body
    left: np.ndarray  # (n,): in masses, `left^T dM right` for the change dM of M
    right: np.ndarray
    centres_left: np.ndarray  # (n,): likewise for the change of the bodies' own M, which moves their centres
    centres_right: np.ndarray
    v: np.ndarray  # (n,); lam, kappa (m,): in profiles, `v . d(phi_q^T lam) + kappa . d(phi_q v + phi_t)`
    lam: np.ndarray
    kappa: np.ndarray


def motion_slopes(model, t, q, bar):
    """The MotionSlopes. The motions w and their change c satisfy `G c + Y^T lam = 0`, `Y (w + c) + phi_t = 0`, Y = phi_q R, G = R^T M R.

    The adjoint system is `G g + Y^T kappa = R^T bar`, `Y g = 0`: the derivative in w is `s = R^T bar - Y^T kappa`, in G `-g^T dG c`, in
    the rows `-g^T dY^T lam - kappa^T (dY (w + c) + dphi_t)`. If a centre moves by dx, the velocity v of the body becomes
    `v - i spin dx`, `dx = T^H dM (z - T x_G) / m`.
    """
    prescribed, R = motions_given(model), rigid_motions(model, q)
    rows, roots = rows_of_motions(model, t, q, R)
    least = np.linalg.pinv((rows @ roots).toarray(), rcond=NO_MASS)
    bar_of_motions, rate = R.T @ bar, rows @ prescribed + model.phi_t(t, q)
    kappa = least.T @ (roots.T @ bar_of_motions)
    motions, change = bar_of_motions - rows.T @ kappa, -roots @ (least @ rate)
    g = roots @ (roots.T @ motions)
    left, right = np.zeros((2, model.n_nodes), complex)
    z = complex_of_pairs(model.reference + q.reshape(-1, 2))
    for k, placed in enumerate(model.all_bodies):
        mass = np.vdot(placed.translation_momentum, placed.translation).real or 1.0
        centre = np.vdot(placed.translation_momentum, z[placed.pairs]) / mass
        slope, spin = complex(*motions[3 * k : 3 * k + 2]), prescribed[3 * k + 2]
        left[placed.pairs] = slope * 1j * spin / mass * placed.translation
        right[placed.pairs] = z[placed.pairs] - placed.translation * centre
    centres = pairs_of(left).ravel(), pairs_of(right).ravel()
    return MotionSlopes(motions, -(R @ g), R @ change, *centres, R @ (prescribed + change), least.T @ (least @ rate), -kappa)


def hint_of_left_out(model, t, frames, accelerations):
    """A note on plates whose modes leave much out, for a run's t (frames,), q and a (frames, n); empty if there are none."""
    errors = {name: error for name, error in left_out(model, t, frames, accelerations).items() if error[2] > ENOUGH}
    worst = sorted(errors, key=lambda name: errors[name][2], reverse=True)[:NAMED]
    plates = ", ".join(f"{name!r} ({1e3 * errors[name][1]:.2g} mm, {100 * errors[name][0]:.2g} % of its strain energy)" for name in worst)
    return f"the modes of {plates} leave much out: take more, or modes of a run of the full plate (pi.pod_modes)" if errors else ""


def left_out(model, t, frames, accelerations):
    """{name: (share of its strain energy, m, m over its size)} that the modes of each reduced plate leave out, in its frame of largest energy.

    The residual `r = M x'' + f(x) - M g` of the full plate at the recovered motion, in the plate's frame, would move it by d, `K d + C^T l = -r`
    with its supports fixed, `C d = 0`: energy `-d^T r / 2`. Forces of joints have no part in it. Not of viscoelastic plates, whose f depends on the past.
    """
    has_error = lambda placed: placed.body.truncation_error is not None and placed.name not in model.strains  # noqa: E731
    reduced = [(number, placed) for number, placed in enumerate(model.reduced_bodies) if has_error(placed)]
    if not (reduced and len(frames)):
        return {}
    chosen, errors = np.unique(np.linspace(0, len(frames) - 1, COMPARED).astype(int)), {}
    pairs = np.array([frames[k] for k in chosen], float).reshape(len(chosen), -1, 2)
    energies = np.empty((len(chosen), len(model.arrays.reduced.drag)))
    reduced_kernels.energies(model.arrays.reduced, pairs, energies)
    for number, placed in reduced:
        worst = int(np.argmax(energies[:, number]))
        k, whole = chosen[worst], energies[worst, number]
        if whole > 0:
            a = np.asarray(accelerations[k], float).reshape(-1, 2)
            displacement, acceleration = (complex_of_pairs(x[placed.pairs]) for x in (pairs[worst], a))
            energy, distance = placed.body.truncation_error(displacement, acceleration, complex(*gravity_at(model.gravity, t[k])))
            errors[placed.name] = energy / whole, distance, distance / float(np.linalg.norm(np.ptp(placed.body.points, axis=0)))
    return errors


def hint_of_rigid(model, frames, rtol):
    """A note that names full plates that move, and deform far less than a run resolves; empty if there are none.

    frames: q of the run (frames, n), of which LOOKS are examined. rtol: relative tolerance of the run in lengths; None: RESOLVED.
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
    """Largest distance, m, of nodes from their best rigid motion in the least-squares sense; both arguments (nodes, 2)."""
    x, y = (z - z.mean() for z in (points @ (1, 1j), (points + displacements) @ (1, 1j)))
    turn = np.vdot(x, y)
    return float(np.abs(y - turn / abs(turn) * x).max()) if turn else np.inf
