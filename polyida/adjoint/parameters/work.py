"""What a parameter's slope is summed over: times and states of a run with the multipliers of its equations there."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Work(NamedTuple):
    """States t (k,), q, v, a (k, n), lam (k, m), and what multiplies each of their equations.

    w (k, n) multiplies the residual r, mu (k, m) the constraints phi, kappa (k, m) their rate `phi_q v + phi_t` and nu (k, m)
    their bias `(phi_q v)_q v + 2 phi_qt v + phi_tt`; None where all of that is zero.
    """

    t: NDArray
    q: NDArray
    v: NDArray
    a: NDArray
    lam: NDArray
    w: NDArray
    mu: NDArray | None = None
    kappa: NDArray | None = None
    nu: NDArray | None = None


def stacked(entries):
    """One Work of entries of single states, or None where there is none."""
    if not entries:
        return None
    return Work(np.array([entry.t for entry in entries]), *(np.stack(column) for column in list(zip(*entries))[1:]))
