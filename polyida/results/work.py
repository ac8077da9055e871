"""Work from powers: integrals in time over a motion that is known at its frames.

Between two frames, and kinks of profiles there, powers are taken at the two Gauss points of the cubic Hermite motion through q and v.
With an error e of that motion, which is zero at both ends, a force misses `int F . e' = -int F' . e`: fourth order in the time between
frames, and nothing where F is constant.
"""

from itertools import pairwise

import numpy as np

from polyida.integrate.kinks import beside
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import cubic
from polyida.io.frames import each

GAUSS = 0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)
SAME = 1e-12  # of the times' size: a kink as near to a frame is at it


def works(motion):
    """{name: work since the first frame, (frames,), J} of all that the motion's model names in `powers` at the first frame."""
    t = np.asarray(motion.t, float)
    powers = _Powers(motion) if len(t) else None
    if not (powers and powers.names):
        return {}
    kinks, gained = _Kinks(motion.model, t), np.zeros((len(t), len(powers.names)))
    behind = {k: _behind(motion, powers, k) for k in kinks.frames}
    multipliers = _multipliers(t, np.asarray(motion.lam, float), behind, kinks.ends)
    for k, ((q0, v0), (q1, v1)) in enumerate(pairwise(zip(each(motion.q), each(motion.v)))):
        h = t[k + 1] - t[k]
        if k in behind:
            v0, _, gained[k + 1] = behind[k]
        for s, part in kinks.points(k):
            q, v = cubic(q0, v0, q1, v1, h, s)
            lam, _ = cubic(*multipliers[k], h, s)
            gained[k + 1] += part * h * powers(t[k] + s * h, q, v, lam)
    return dict(zip(powers.names, np.cumsum(gained, axis=0).T))


class _Powers:
    """A model's powers as an array, in the order of their names at a motion's first frame."""

    def __init__(self, motion):
        self.model = motion.model
        self.names = list(self.model.powers(float(motion.t[0]), *(np.asarray(x[0], float) for x in (motion.q, motion.v, motion.lam))))

    def __call__(self, t, q, v, lam):
        found = self.model.powers(t, q, v, lam)
        return np.array([found.get(name, 0.0) for name in self.names])


class _Kinks:
    """Kinks of a model's profiles among the times of frames.

    frames: the frames at one, but the last; ends: frames at which a smooth piece of motion ends, those on both sides of a kink too.
    """

    def __init__(self, model, t):
        times = np.array(model.kinks(beside(t[0], -1.0), t[-1]), float)
        after = np.searchsorted(t, times)
        nearest = np.where(np.abs(t[after] - times) < np.abs(t[after - 1] - times), after, after - 1) if len(times) else after
        at = np.abs(t[nearest] - times) <= SAME * np.abs(t).max(initial=0.0)
        self.frames = sorted({*nearest[at].tolist()} - {len(t) - 1})
        self._within = {}
        for k, time in zip(after[~at].tolist(), times[~at]):
            self._within.setdefault(k - 1, []).append((time - t[k - 1]) / (t[k] - t[k - 1]))
        self.ends = sorted({0, len(t) - 1, *self.frames, *self._within, *(k + 1 for k in self._within)})

    def points(self, k):
        """(place, weight) of Gauss points between frame k and the next, in parts of the time between them."""
        for first, last in pairwise((0.0, *self._within.get(k, ()), 1.0)):
            yield from ((first + s * (last - first), 0.5 * (last - first)) for s in GAUSS)


def _behind(motion, powers, k):
    """(v, lam, works of the blow) behind a kink at frame k, where a motor's speed and forces may have jumped."""
    model, t, q, v = motion.model, float(motion.t[k]), np.asarray(motion.q[k], float), np.asarray(motion.v[k], float)
    after, none = beside(t, 1.0), np.zeros(model.m)
    jump, impulse = model.mass_system(after, q).solve(np.zeros(model.n), model.phi_rate(after, q, v)) if model.m else (0.0, none)
    v = v + jump
    blow = sum(0.5 * (powers(time, q, v, impulse) - powers(time, q, v, none)) for time in (beside(t, -1.0), after))
    return v, consistent_acceleration(model, after, q, v)[1], blow


def _multipliers(t, lam, behind, ends):
    """(value, slope, value, slope) at both ends of every interval between frames, slopes from neighbours in the same smooth piece."""
    found = []
    for first, last in pairwise(ends):
        values = lam[first : last + 1].copy()
        if first in behind:
            values[0] = behind[first][1]
        slopes = np.gradient(values, t[first : last + 1], axis=0, edge_order=min(2, last - first))
        found += zip(values[:-1], slopes[:-1], values[1:], slopes[1:])
    return found
