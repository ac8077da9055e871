"""What a run says of its plates: reduced ones whose modes leave much out of the motion, and full ones that may as well be rigid."""

import numpy as np

from polyida.assembly import compact
from polyida.assembly.loads import gravity_at
from polyida.validation import complex_of_pairs

COMPARED = 16  # frames of a run whose strain energies are compared; the full plate is looked at where a body's is largest
ENOUGH = 2e-4  # of a plate's size: it is off by about as much as its modes leave out, where it bends far by more
LOOKS = 8  # frames of a run in which a full plate is compared with its best rigid motion
CLEAR = 1e-2  # of what a run resolves: as little as that is nothing, beyond doubt
RESOLVED = 1e-6  # of a plate's size, by a run without a tolerance
TRAVEL = 1e-3  # of its size: a plate that moves by less tells nothing, for it may only begin to move
NAMED = 3  # plates that are named, where there are more


def hint_of_left_out(model, t, frames, accelerations):
    """What is said of plates whose modes leave much out, of a run's t (frames,), q and a (frames, n); empty where there are none."""
    found = {name: left for name, left in left_out(model, t, frames, accelerations).items() if left[2] > ENOUGH}
    worst = sorted(found, key=lambda name: found[name][2], reverse=True)[:NAMED]
    told = ", ".join(f"{name!r} ({1e3 * found[name][1]:.2g} mm, {100 * found[name][0]:.2g} % of its strain energy)" for name in worst)
    return f"the modes of {told} leave much out: take more, or fields of a run of the full plate (pi.pod_modes)" if found else ""


def left_out(model, t, frames, accelerations):
    """{name: (share of its strain energy, m, m over its size)} that the modes of each reduced plate leave out, where that energy is largest.

    The residual `r = M x'' + f(x) - M g` of the full plate at the recovered motion, in the plate's frame, would move it by d, `K d + C^T l = -r`
    with what holds it kept, `C d = 0`: energy `-d^T r / 2`, of which no force of a joint is a part.
    """
    reduced = [(number, placed) for number, placed in enumerate(model.few) if placed.body.left_out is not None]
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
            energy, far = placed.body.left_out(moved, pulled, complex(*gravity_at(model.gravity, t[k])))
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
