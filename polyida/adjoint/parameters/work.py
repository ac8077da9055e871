"""What a parameter's slope is summed over: times and states of a run with the multipliers of its equations there."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

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


@dataclass(eq=False)
class Shared:
    """`make(model, work)`, kept for the last Work that it was asked for."""

    make: Callable[[Any, Any], Any]
    model: Any
    _last: tuple = field(default=(None, None), init=False)

    def __call__(self, work):
        if self._last[0] is not work:
            self._last = work, self.make(self.model, work)
        return self._last[1]
