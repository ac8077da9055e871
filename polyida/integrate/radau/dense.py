"""The collocation polynomial of a step: the motion between its ends."""

from typing import NamedTuple

import numpy as np

from polyida.integrate.radau.tableau import from_zero, through
from polyida.integrate.state import State


class Collocation(NamedTuple):
    """Called with t it gives the State there: q and v by polynomials of degree s (3rd or 4th order), a and lam of degree s - 1."""

    t: float
    h: float
    q: np.ndarray
    v: np.ndarray
    c: np.ndarray
    stages: tuple

    def __call__(self, t):
        s = (t - self.t) / self.h
        moved, rest = from_zero(self.c, s), through(self.c, s)
        q, v, a, lam = self.stages
        return State(float(t), self.q + moved @ q, self.v + moved @ v, rest @ a, rest @ lam, restart=False)
