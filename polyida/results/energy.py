"""Energies of a run over time: what it has, and what came in and went out."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.assembly.loads import dead_loads
from polyida.body.own_part import writes
from polyida.brief import brief
from polyida.force.force_element import ForceElement
from polyida.io.frames import each
from polyida.results.motion import Motion
from polyida.results.work import works

GROWN, LOOKS = 1e-2, 32  # of the largest kinetic energy: more is no error that a run may have; frames that are looked at


@dataclass(frozen=True, eq=False)
class Energy:
    """Energies over time, (frames,), J; nan where the model does not state its potential.

    kinetic; strain, of bodies; potential, of gravity and force elements. What follows is computed when it is asked for.
    """

    kinetic: NDArray
    potential: NDArray
    strain: NDArray
    _motion: Any = field(repr=False)  # the run's model, t, q, v, lam

    __repr__ = brief

    @property
    def total(self) -> NDArray:
        """kinetic + potential + strain."""
        return self.kinetic + self.potential + self.strain

    @cached_property
    def gravity(self) -> NDArray:
        """Potential of gravity, zero in the reference configuration; nan of a model that is no scene's."""
        model = self._motion.model
        if not model.is_scene:
            return np.full(len(self.kinetic), np.nan)
        return np.array([model.gravity_potential(q) for q in each(self._motion.q)]).reshape(-1)

    @cached_property
    def elements(self) -> dict[str, NDArray]:
        """{name: potential energy of a force element that has one}; with `gravity` they make up `potential`."""
        forces, q = self._motion.model.own_forces, self._motion.q
        found = [own for own in (forces.each if forces else ()) if not own.strain and writes(own.element, ForceElement, "energy")]
        return {own.name: np.array([own.energy(own.places(frame)) for frame in each(q)]) for own in found}

    @property
    def work(self) -> dict[str, NDArray]:
        """{name: work done on the system since the first frame} by loads, driven joints, and force elements beyond their `energy`.

        `total - total[0] = sum of work - sum of dissipated` for the exact motion. Of the cubic Hermite motion through q and v of
        the frames, by two Gauss points between them, and between the kinks of profiles: exact for constant loads and of fourth
        order in the time between frames; multipliers are interpolated with slopes from their neighbours. So it is as good as the
        frames are near: what swings between two of them is not seen. The blow of a motor whose speed jumps is counted where a frame is
        at that kink. A model of one's own tells by its `powers`.
        """
        return {name: work for name, work in self._works.items() if name not in self._motion.model.dissipating}

    @property
    def dissipated(self) -> dict[str, NDArray]:
        """{name: energy taken since the first frame}, alike: by force elements that say `dissipates`, and by plates whose material is damped."""
        return {name: -work for name, work in self._works.items() if name in self._motion.model.dissipating}

    @cached_property
    def _works(self):
        return works(self._motion)


def grown(motion):
    """What a summary says of energy that grows although nothing supplies any: by more than GROWN of the largest kinetic energy.

    LOOKS frames are looked at; empty where a part may do work.
    """
    model, count = motion.model, len(motion.t)
    if count < 2 or not _passive(model):
        return ""
    looks = np.unique(np.linspace(0, count - 1, LOOKS).astype(int))
    energy = energy_of(Motion(model, motion.t[looks], *(np.array([x[k] for k in looks], float) for x in motion[2:])))
    gains = energy.total - np.minimum.accumulate(energy.total)
    at, most = int(gains.argmax()), float(energy.kinetic.max())
    if not gains[at] > GROWN * most > 0.0:
        return ""
    return (
        f"the energy grows by {gains[at]:.2g} J up to t = {motion.t[looks[at]]:.4g} s, the largest kinetic energy being {most:.2g} J, "
        "and no part supplies it: take shorter steps or a tighter rtol"
    )


def _passive(model):
    """Whether a scene has no load, no profile and no force element without an energy; of other models nothing is known."""
    if not model.is_scene or any(name for name, _ in model.named_profiles) or dead_loads(model.parts, model.gravity, model.places):
        return False
    return all(own.strain or writes(own.element, ForceElement, "energy") for own in model.own_forces.each)


def energy_of(motion):
    """The Energy of a motion: model, t, q, v, lam."""
    model, frames = motion.model, zip(each(motion.q), each(motion.v))
    found = [(0.5 * v @ (model.mass(q) @ v), *model.potentials(q)) for q, v in frames]
    return Energy(*np.array(found, float).reshape(-1, 3).T, motion)
