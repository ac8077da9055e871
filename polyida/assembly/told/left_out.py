"""What the modes of a reduced plate leave out of its motion: a residual of the full plate, turned into strain energy and a displacement."""

import numpy as np

from polyida.assembly.bodies import compact
from polyida.assembly.loads import gravity_at
from polyida.given import complex_of_pairs

LOOKS = 16  # frames of a run whose strain energies are compared; the full plate is looked at where a body's is largest
ENOUGH = 2e-4  # of a plate's size: it is off by about as much as its modes leave out, where it bends far by more
NAMED = 3


def hint(model, t, frames, accelerations):
    """What is said of plates whose modes leave much out, of a run's t (frames,), q and a (frames, n); empty where there are none."""
    found = {name: left for name, left in left_out(model, t, frames, accelerations).items() if left[2] > ENOUGH}
    worst = sorted(found, key=lambda name: found[name][2], reverse=True)[:NAMED]
    told = ", ".join(f"{name!r} ({1e3 * found[name][1]:.2g} mm, {100 * found[name][0]:.2g} % of its strain energy)" for name in worst)
    return f"the modes of {told} leave much out: take more, or fields of a run of the full plate (pi.fields_of)" if found else ""


def left_out(model, t, frames, accelerations):
    """{name: (share of its strain energy, m, m over its size)} that the modes of each reduced plate leave out, where that energy is largest.

    The residual `r = M x'' + f(x) - M g` of the full plate at the recovered motion, in the plate's frame, would move it by d, `K d + C^T l = -r`
    with what holds it kept, `C d = 0`: energy `-d^T r / 2`, of which no force of a joint is a part.
    """
    reduced = [(number, placed) for number, placed in enumerate(model.few) if placed.body.left_out is not None]
    if not (reduced and len(frames)):
        return {}
    chosen, found = np.unique(np.linspace(0, len(frames) - 1, LOOKS).astype(int)), {}
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
