"""Slopes of an objective in the frames of a run, in parameters that it depends on by itself, and along a way in q."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.model.differences import FIRST_ORDER_STEP
from polyida.validation import named_keywords

SHARES = np.array([[1.0, 2.0 / 3.0], [-1.0, -2.0 / 3.0], [2.0, -1.0 / 12.0], [-2.0, 1.0 / 12.0]])  # places, and weights of a slope there


@named_keywords
@dataclass(frozen=True, eq=False)
class Slopes:
    """dJ by the frames of a slice of a run: q, v, a (count, n), lam (count, m), t (count,), the times at which the frames are, or a
    function without arguments that gives this, called where times move with a parameter; None where zero.

    direct: {name of a parameter: dJ/dp at fixed frames}, this slice's share, such as "arm.stiffness" (cells,). work: more of the same
    for every parameter, entries (t (k,), q, v, a (k, n), lam (k, m), w (k, n), mu (k, m)): dJ/dp holds the sum over them of
    `w . dr/dp + mu . dphi/dp`; or None. of_model: this slice's share of J, to first order, as a function of the model at fixed frames: for
    parameters that `direct` does not name, such as "arm.nu"; or None.
    """

    q: NDArray | None = None
    v: NDArray | None = None
    a: NDArray | None = None
    lam: NDArray | None = None
    t: NDArray | Callable[[], NDArray] | None = None
    direct: dict[str, NDArray | float] = field(default_factory=dict)
    work: tuple[NDArray, ...] | None = None
    of_model: Callable[[Any], float] | None = None

    def by_time(self) -> NDArray | None:
        """t, (count,), or None."""
        return self.t() if callable(self.t) else self.t

    def times(self, factor: float) -> "Slopes":
        """Those of J times a number."""
        found: dict[str, Any] = {name: _times(factor, getattr(self, name)) for name in FRAMES}
        direct = {name: factor * value for name, value in self.direct.items()}
        work = None if self.work is None else (*self.work[:5], *(factor * x for x in self.work[5:]))
        return Slopes(**found, direct=direct, work=work, of_model=_times(factor, self.of_model))

    def plus(self, other: "Slopes") -> "Slopes":
        """Those of a sum of two objectives, of the same slice."""
        found: dict[str, Any] = {name: _sum(getattr(self, name), getattr(other, name)) for name in FRAMES}
        direct = self.direct | {name: value + self.direct.get(name, 0.0) for name, value in other.direct.items()}
        works = [work for work in (self.work, other.work) if work is not None]
        work = tuple(map(np.concatenate, zip(*works))) if works else None
        return Slopes(**found, direct=direct, work=work, of_model=_sum(self.of_model, other.of_model))


FRAMES = tuple(entry.name for entry in fields(Slopes))[:5]


def _times(factor, x):
    """Of an array or a function, None where there is none."""
    if callable(x):
        return lambda *given: factor * x(*given)
    return None if x is None else factor * x


def _sum(a, b):
    if a is None or b is None:
        return b if a is None else a
    if not (callable(a) or callable(b)):
        return a + b
    return lambda *given: _value(a, given) + _value(b, given)


def _value(x, given):
    return x(*given) if callable(x) else x


def reach(model, q, way):
    """The length along a way over which a model's functions vary, about."""
    return (model.extent or max(1.0, np.abs(q).max())) / (np.abs(way).max() or 1.0)


def along_way(model, t, q, lam, way, w, mu):
    """Entries of the `work` of Slopes whose sum is `d/ds (w . r + mu . phi)` at q + s way, a = 0: exact of plates, whose r is a cubic of s.

    What is linear about a state is so in every parameter too. q, way, w (n,), lam, mu (m,).
    """
    step = FIRST_ORDER_STEP * reach(model, q, way)
    at, weight = SHARES[:, :1] * step, SHARES[:, 1:] / step
    still = np.zeros((len(at), model.n))
    return np.full(len(at), t), q + at * way, still, still, np.tile(lam, (len(at), 1)), weight * w, weight * mu
