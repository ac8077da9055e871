"""Plates that may as well be rigid: how far their nodes leave the best rigid motion, beside what a run resolves."""

import numpy as np

LOOKS = 8  # frames of a run that are looked at
CLEAR = 1e-2  # of what a run resolves: as little as that is nothing, beyond doubt
RESOLVED = 1e-6  # of a plate's size, by a run without a tolerance
TRAVEL = 1e-3  # of its size: a plate that moves by less tells nothing, for it may only begin to move
NAMED = 3  # plates that are named, where there are more


def hint(model, frames, integrator):
    """What a summary says of such plates, of a run's q (frames, n); a run resolves its integrator's rtol, or RESOLVED with constant steps."""
    if not model.is_scene or not len(frames):
        return ""
    rtol = getattr(integrator, "rtol", None) if getattr(integrator, "adaptive", True) else None
    names = as_good_as_rigid(model, frames, rtol or RESOLVED)
    plates = ", ".join(map(repr, names[:NAMED])) + f" and {len(names) - NAMED} more" * (len(names) > NAMED)
    deform = "deforms" if len(names) == 1 else "deform"
    return f"{plates} {deform} far less than the run resolves: such a plate may as well be rigid" if names else ""


def as_good_as_rigid(model, frames, tolerance=RESOLVED):
    """Names of the plates that move, by TRAVEL of their size, and leave the best rigid motion by less than `CLEAR tolerance` of it.

    frames: a run's q (frames, n), of which LOOKS are looked at. tolerance: of the run, relative to a length.
    """
    looks = [np.asarray(frames[k]).reshape(-1, 2) for k in np.unique(np.linspace(0, len(frames) - 1, LOOKS).astype(int))]
    found = []
    for body in model.bodies:
        moves = [frame[body.nodes] for frame in looks]
        size = float(np.linalg.norm(np.ptp(body.points, axis=0)))
        travels = max(float(np.abs(move - moves[0]).max()) for move in moves) > TRAVEL * size
        if travels and all(deformation(body.points, move) < CLEAR * tolerance * size for move in moves):
            found.append(body.name)
    return found


def deformation(points, displacements):
    """Largest distance of nodes, m, from where the rigid motion with the least sum of squares takes them; both (nodes, 2)."""
    x, y = (z - z.mean() for z in (points @ (1, 1j), (points + displacements) @ (1, 1j)))
    turn = np.vdot(x, y)
    return float(np.abs(y - turn / abs(turn) * x).max()) if turn else np.inf
