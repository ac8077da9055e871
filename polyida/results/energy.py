"""Energies of a run over time, work of its parts and dissipation.

Work is the time integral of powers over a motion that is known at its frames. Between two frames, and kinks of profiles there, powers
are evaluated at the three Gauss points of the cubic Hermite motion through q and v. If it leaves driven constraints, it is put on these,
and parts of that time get points of their own. With an error e of that motion, which is zero at both ends, a force misses
`int F . e' = -int F' . e`: fourth order in the time between frames, and nothing where F is constant.
"""

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.assembly.placement import dead_loads
from polyida.body.body import writes
from polyida.errors import InputError
from polyida.force.force_element import ForceElement
from polyida.io.frames import each
from polyida.model.differences import beside, cubic
from polyida.reprs import brief
from polyida.results.motion import Motion

GAUSS = tuple(zip(0.5 + 0.5 * np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0]), np.array([5.0, 8.0, 5.0]) / 18.0))  # (place, weight)
FINE, HALVINGS = 1e-6, 8  # of works between two frames, of a motion that is put on its drives
NEAR = 1e-3  # of the time between the frames beside them: two frames that are closer have one slope
SAME = 1e-12  # of the times' size: a kink that is nearer to a frame is at it


def works(motions, settled):
    """{name: work since the first frame, (frames,), J} over consecutive Motions. settled: function that puts a state on its drives."""
    each_one, ends = [_works_of(motion, settled) for motion in motions], np.cumsum([0, *(len(motion.t) for motion in motions)])
    gained = {name: np.zeros(ends[-1]) for one in each_one for name in one}
    for one, first, end in zip(each_one, ends, ends[1:]):
        for name, work in one.items():
            gained[name][first:end] += work
            gained[name][end:] += work[-1]
    return gained


def _works_of(motion, settled):
    """{name: work since the first frame, (frames,), J} of one Motion, for all that its model names in `powers` at the first frame."""
    t = np.asarray(motion.t, float)
    powers = _Powers(motion) if len(t) else None
    if not (powers and powers.names):
        return {}
    kinks, gained = _Kinks(motion.model, t), np.zeros((len(t), len(powers.names)))
    behind = {k: _behind(motion, powers, k) for k in kinks.frames}
    # multipliers and their slopes at both ends of every interval between frames, slopes from neighbours in the same smooth piece
    lam, multipliers = np.asarray(motion.lam, float), []
    for first, last in pairwise(kinks.ends):
        values = lam[first : last + 1].copy()
        if first in behind:
            values[0] = behind[first][1]
        slopes = _slopes(values, t[first : last + 1])
        multipliers += zip(values[:-1], slopes[:-1], values[1:], slopes[1:])
    for k, ((q0, v0), (q1, v1)) in enumerate(pairwise(zip(each(motion.q), each(motion.v)))):
        h = t[k + 1] - t[k]
        if k in behind:
            v0, _, gained[k + 1] = behind[k]
        gained[k + 1] += _Interval(motion.model, powers, settled, t[k], h, (q0, v0, q1, v1), multipliers[k]).work(kinks.within(k))
    return dict(zip(powers.names, np.cumsum(gained, axis=0).T))


def _slopes(values, t):
    """Slopes of values (frames, m). A frame much nearer to the one before than to others has its slope: a difference there is round-off."""
    h = np.diff(t)
    beside_it = np.maximum(np.append(0.0, h[:-1]), np.append(h[1:], 0.0))
    apart = np.append(True, h >= NEAR * beside_it)
    slopes = np.gradient(values[apart], t[apart], axis=0, edge_order=min(2, apart.sum() - 1))
    return slopes[np.cumsum(apart) - 1]


class _Powers:
    """A model's powers as an array, in the order of their names at a motion's first frame."""

    def __init__(self, motion):
        """Take the model of a motion, and the names of its powers at the first frame."""
        self.model = motion.model
        self.names = list(self.model.powers(float(motion.t[0]), *(np.asarray(x[0], float) for x in (motion.q, motion.v, motion.lam))))

    def __call__(self, t, q, v, lam):
        """Powers of the model at a state, W, in the order of self.names, (names,); 0 for a name that has none there."""
        powers = self.model.powers(t, q, v, lam)
        return np.array([powers.get(name, 0.0) for name in self.names])


class _Kinks:
    """Kinks of a model's profiles among the times of frames.

    frames: the frames at one, but the last; ends: frames at which a smooth piece of motion ends, those on both sides of a kink too.
    """

    def __init__(self, model, t):
        """Take the model, functions for powers and settled states, begin and length of the time, s, and the states at its ends."""
        times = np.array(model.kinks(beside(t[0], -1.0), t[-1]), float)
        after = np.searchsorted(t, times)
        nearest = np.where(np.abs(t[after] - times) < np.abs(t[after - 1] - times), after, after - 1) if len(times) else after
        at = np.abs(t[nearest] - times) <= SAME * np.abs(t).max(initial=0.0)
        self.frames = sorted({*nearest[at].tolist()} - {len(t) - 1})
        self._within = {}
        for k, time in zip(after[~at].tolist(), times[~at]):
            self._within.setdefault(k - 1, []).append((time - t[k - 1]) / (t[k] - t[k - 1]))
        self.ends = sorted({0, len(t) - 1, *self.frames, *self._within, *(k + 1 for k in self._within)})

    def within(self, k):
        """Places of kinks between frame k and the next, in parts of the time between them."""
        return self._within.get(k, ())


class _Interval:
    """The motion between two frames.

    ends: q and v at both; multipliers: lam and its slopes there. Where it leaves its drives, all of it is put on these, and its work is
    computed over halves, quarters, ... of the time, until it changes by less than FINE of the powers' size, HALVINGS times at most.
    """

    def __init__(self, model, powers, settled, t, h, ends, multipliers):
        """Take the model, functions for powers and settled states, start t and length h, s, and the values at both ends."""
        self.model, self.powers, self.settled = model, powers, settled
        self.t, self.h = t, h
        self.ends, self.multipliers = ends, multipliers

    def work(self, kinks):
        """Works, J. kinks: their places, in parts of the time."""
        return sum(self._work(*part) for part in pairwise((0.0, *kinks, 1.0)))

    def _work(self, first, last):
        """Works, J, between two shares of the interval, 0 to 1; by halves where the motion leaves its drives."""
        works, _, leaves = self._gauss(first, last)
        return self._halved(first, last, *self._gauss(first, last, gap=0.0)[:2], HALVINGS) if leaves else works

    def _halved(self, first, last, works, size, halvings):
        """Works of a part of the time: `works`, or the sum of those of its halves if these differ by more than FINE of `size`."""
        middle = 0.5 * (first + last)
        halves = [(*part, *self._gauss(*part, gap=0.0)[:2]) for part in ((first, middle), (middle, last))]
        both = halves[0][2] + halves[1][2]
        if not halvings or (np.abs(both - works) <= FINE * size).all():
            return both
        return sum(self._halved(*half, halvings - 1) for half in halves)

    def _gauss(self, first, last, **gap):
        """Works and their sizes by three Gauss points, and True if the motion was put on its drives at one of them."""
        works, size, leaves = 0.0, 0.0, False
        for place, weight in GAUSS:
            s, part = first + place * (last - first), weight * (last - first) * self.h
            q, v = cubic(*self.ends, self.h, s)
            lam, _ = cubic(*self.multipliers, self.h, s)
            state = self.settled(self.model, self.t + s * self.h, q, v, lam, **gap)
            power = part * self.powers(self.t + s * self.h, *state)
            works, size, leaves = works + power, size + np.abs(power), leaves or state[0] is not q
        return works, size, leaves


def _behind(motion, powers, k):
    """(v, lam, works of the impulse) after a kink at frame k, where a motor's speed and forces may have jumped.

    Of a model with laws, whose contacts may be open, lam is that of the next frame.
    """
    model, t, q, v = motion.model, float(motion.t[k]), np.asarray(motion.q[k], float), np.asarray(motion.v[k], float)
    after, none, impulse = beside(t, 1.0), np.zeros(model.m), np.zeros(model.m)
    rows = np.setdiff1d(np.arange(model.m), [law.row for law in model.row_laws])
    if len(rows):
        base = model.with_rows(rows) if model.row_laws else model
        jump, impulse[rows] = base.mass_system(after, q).solve(np.zeros(model.n), base.phi_rate(after, q, v))
        v = v + jump
    impulse_work = sum(0.5 * (powers(time, q, v, impulse) - powers(time, q, v, none)) for time in (beside(t, -1.0), after))
    if model.row_laws:
        return v, np.asarray(motion.lam[k + 1], float), impulse_work
    bias = model.phi_bias(after, q, v) if model.m else none
    return v, model.mass_system(after, q).solve(model.force(after, q, v), bias)[1], impulse_work


UNSEEN = 0.1  # of the largest work or kinetic energy: change of works from every second frame that says that frames are too far apart
SEEN = 0.01  # the same, where the works do not balance the energy by UNSEEN: steps too long for the energy change works by less
GROWN, LOOKS = 1e-2, 32  # of the largest kinetic energy: more growth is reported; number of frames checked
AT_REST = 1e-12  # of the size of the scene: way that is round-off


@dataclass(frozen=True, eq=False)
class Energy:
    """Energies over time, (frames,), J; nan if the model has no potential. Work and dissipation are computed on request.

    Parameters
    ----------
    kinetic, potential, strain : (frames,) float, J
        Potential is that of gravity and force elements, strain that of bodies.
    """

    kinetic: NDArray
    potential: NDArray
    strain: NDArray
    _motions: Any = field(repr=False)  # the run's Motions between events
    _events: Any = field(default=(), repr=False)  # Events
    _settled: Any = field(
        default=None, repr=False
    )  # function (model, t, q, v, lam, gap) -> (q, v, lam) of an interpolated state on its constraints
    _thinned: bool = field(default=False, repr=False)  # True if not all steps are frames

    __repr__ = brief

    @property
    def total(self) -> NDArray:
        """Sum of kinetic, potential and strain energy, (frames,), J."""
        return self.kinetic + self.potential + self.strain

    @cached_property
    def gravity(self) -> NDArray:
        """Potential of gravity, J, zero in the reference configuration; nan for a model that is not a scene's."""
        if not self._motions[0].model.is_scene:
            return np.full(len(self.kinetic), np.nan)
        return np.array([one.model.gravity_potential(q) for one in self._motions for q in each(one.q)]).reshape(-1)

    @cached_property
    def elements(self) -> dict[str, NDArray]:
        """{name: potential energy of a force element that has one}, J; with `gravity` they add up to `potential`."""
        result: dict[str, NDArray] = {}
        first = 0
        for one in self._motions:
            forces = one.model.own_forces
            values = [one.model.element_energies(q, v) for q, v in zip(each(one.q), each(one.v))] if forces else []
            for own, energies in zip(forces, np.transpose(values)):
                if not own.strain and writes(own.element, ForceElement, "energy"):
                    result.setdefault(own.name, np.zeros(len(self.kinetic)))[first : first + len(one.t)] = energies
            first += len(one.t)
        return result

    @property
    def work(self) -> dict[str, NDArray]:
        """{name: work done on the system since the first frame, J} by loads, driven joints, and force elements beyond their `energy`.

        `total - total[0] = sum of work - sum of dissipated` for the exact motion. It is the integral over the cubic Hermite motion through
        q and v of the frames, by three Gauss points between them, and between the kinks of profiles: exact for constant loads and of fourth
        order in the time between frames: with `every=` or `output=` that is the time between the frames that are stored. Multipliers are
        interpolated with slopes from their neighbours. Driven rigid bodies are put on their drives between frames, with multipliers that are
        computed there, at as many points as their work needs. Vibrations between two frames are
        missed. The impulse of a motor whose speed jumps is included if a frame is at that kink. A user's model needs `powers`.

        Raises
        ------
        InputError
            If frames at `every=` or `output=` are too far apart: works from every second one of them would differ by more than a tenth of the largest
            work or kinetic energy, or by a hundredth where works do not balance the energy.
        """
        return {name: work for name, work in self._works.items() if name not in self._dissipating}

    @property
    def dissipated(self) -> dict[str, NDArray]:
        """{name: energy dissipated since the first frame, J}, by force elements that declare `dissipates`, damped plates, and events."""
        lost = {name: -work for name, work in self._works.items() if name in self._dissipating}
        for one in self._events:
            lost[one.name] = lost.get(one.name, np.zeros(len(self.kinetic))) + one.energy_lost * (np.arange(len(self.kinetic)) >= one.frame)
        return lost

    @property
    def _dissipating(self):
        """Names of the parts that dissipate energy in any of the motions."""
        return {name for one in self._motions for name in one.model.dissipating}

    @cached_property
    def _works(self):
        """{part: work (frames,), J}. Raises InputError if the frames are too far apart for the works between them."""
        gained = works(self._motions, self._settled)
        if self._thinned:
            largest = max([float(self.kinetic.max(initial=0.0)), *(float(np.abs(work).max(initial=0.0)) for work in gained.values())])
            left = 0.0 if len(self._events) else np.abs(self.total - self.total[:1] - sum(gained.values())).max(initial=0.0)
            _require_seen(self._motions, self._settled, gained, largest, SEEN if left > UNSEEN * largest else UNSEEN)
        return gained


def grown(motion):
    """A note on energy that grows by more than GROWN of the largest kinetic energy in LOOKS frames, although no part supplies any; or ""."""
    model, count = motion.model, len(motion.t)
    if count < 2 or not _passive(model):
        return ""
    looks = np.unique(np.linspace(0, count - 1, LOOKS).astype(int))
    seen = Motion(model, motion.t[looks], *(np.array([x[k] for k in looks], float) for x in motion[2:]))
    if np.abs(seen.v).max() * np.ptp(seen.t) <= AT_REST * model.extent:
        return ""
    energy = energy_of([seen])
    gains = energy.total - np.minimum.accumulate(energy.total)
    at, most = int(gains.argmax()), float(energy.kinetic.max())
    if not gains[at] > GROWN * most > 0.0:
        return ""
    return (
        f"the energy grows by {gains[at]:.2g} J up to t = {motion.t[looks[at]]:.4g} s, the largest kinetic energy being {most:.2g} J, "
        "and no part supplies it: take shorter steps or a tighter rtol; of an own force or body compare forces and energy by "
        "pi.check_derivatives(model)"
    )


def _passive(model):
    """True for a scene without load, profile and force element without an energy; False for other models."""
    if not model.is_scene or any(name for name, _ in model.named_profiles) or dead_loads(model.parts, model.gravity, model.places):
        return False
    return all(own.strain or writes(own.element, ForceElement, "energy") for own in model.own_forces)


def _require_seen(motions, settled, gained, largest, share):
    """Raise InputError unless works (frames,) by name from every second frame of each motion are the same up to a share of the largest energy."""
    first = 0
    for one in motions:
        count = len(one.t)
        if count > 2:
            coarse = works([Motion(one.model, *(x[::2] for x in one[1:]))], settled)
            for name, work in coarse.items():
                fine = gained[name][first : first + count : 2]
                off = float(np.abs(work - (fine - fine[0])).max())
                if off > share * largest:
                    raise InputError(
                        f"energy: the frames at every= or output= are too far apart for the work of {name!r}: from every second one it differs by "
                        f"{off:.3g} J of {largest:.3g} J; store more frames, or solve without every and output"
                    )
        first += count


def energy_of(motions, events=(), settled=None, thinned=False):
    """The Energy of consecutive Motions, and of the Events between them. thinned: True if not all steps are frames."""
    terms = []
    for model, q, v in ((one.model, q, v) for one in motions for q, v in zip(each(one.q), each(one.v))):
        moving = model.without_states(v)
        terms.append(
            (0.5 * moving @ (model.mass(q) @ moving), *(model.potentials(q, v) if model.k and model.is_scene else model.potentials(q)))
        )
    return Energy(*np.array(terms, float).reshape(-1, 3).T, motions, events, settled, thinned)
