"""The state at the end of a step that has its forces at the middle."""

import math
from functools import cached_property

import numpy as np

from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State, StepFailure


class AtEnd(State):
    """A State whose a and lam are worked out of q and v when they are first asked for: most steps of a run need not have them.

    `[[M, B^T], [B, 0]] (a, lam) = (-g, -bias)`: of the order of q and v, needs no step before or after, and the forces of a frame are in
    balance. memory: what the next step starts from. at: the time, to one side of a kink there.
    """

    def __init__(self, model, t, q, v, memory, at):
        vars(self).update(t=t, q=q, v=v, memory=memory, restart=True, _at=(model, at))

    @cached_property
    def _forces(self):
        model, at = self._at
        try:
            return consistent_acceleration(model, at, self.q, self.v)
        except np.linalg.LinAlgError:
            raise StepFailure("singular", "the constraints' system is singular", self.t) from None

    def finite(self):
        """Whether q and v are finite; a and lam follow from them where they are asked for."""
        return math.isfinite(self.q.dot(self.v))

    a = property(lambda self: self._forces[0])
    lam = property(lambda self: self._forces[1])
