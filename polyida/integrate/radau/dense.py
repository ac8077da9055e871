"""The collocation polynomial of a step: the motion between its ends."""

from typing import NamedTuple

import numpy as np

from polyida.integrate.radau.tableau import through, through_zero
from polyida.integrate.state import State


class Collocation(NamedTuple):
    """Called with t it gives the State there: q and v by polynomials of degree s (3rd or 4th order), a and lam of degree s - 1.

    stages: e, v - v_0, v' and lam of the nodes c, each (s, ...).
    """

    t: float
    h: float
    q: np.ndarray
    v: np.ndarray
    c: np.ndarray
    stages: tuple

    def __call__(self, t):
        s = (t - self.t) / self.h
        moved, rest = through_zero(self.c, s), through(self.c, s)
        e, dv, a, lam = self.stages
        q = self.q + ((t - self.t) * self.v + moved @ e)
        return State(float(t), q, self.v + moved @ dv, rest @ a, rest @ lam, restart=False)
