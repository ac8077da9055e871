"""The state at the end of a step that has its forces at the middle."""

import math
from functools import cached_property

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import State


class AtEnd(State):
    """A State whose a and lam are worked out of q and v when they are first asked for: most steps of a run need not have them.

    `[[M, B^T], [B, 0]] (a, lam) = (-g, -bias)`: of the order of q and v, needs no step before or after, and the forces of a frame are in
    balance. So is v, where it is None: `free` put on its constraint, and made as fast as that was.
    memory: what the next step starts from, where it restarts. at: the time, to one side of a kink there.
    """

    def __init__(self, model, t, q, v, free, memory, at, restart=True):
        vars(self).update(t=t, q=q, memory=memory, restart=restart, _at=(model, at), _free=free)
        if v is not None:
            vars(self)["v"] = v

    @cached_property
    def v(self):
        """v on its constraint with the kinetic energy of the free one, (n,)."""
        (model, at), free = self._at, self._free
        on = on_velocity(model, at, self.q, free)
        M = model.mass(on)
        has = on @ (M @ on)
        return on * np.sqrt(free @ (M @ free) / has) if has > 0.0 else on

    @cached_property
    def _forces(self):
        model, at = self._at
        try:
            return consistent_acceleration(model, at, self.q, self.v)
        except np.linalg.LinAlgError:
            raise StepFailure("singular", "the constraints' system is singular", self.t) from None

    def finite(self):
        """Whether q and v are finite; a and lam, and v on its constraint, follow where they are asked for."""
        v = vars(self).get("v")
        return math.isfinite(self.q.dot(self._free if v is None else v))

    a = property(lambda self: self._forces[0])
    lam = property(lambda self: self._forces[1])
