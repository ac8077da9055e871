"""What a model's parameter answers: its slope in a sum over a run, and the model with another value."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.model.differences import EVERYWHERE


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


@dataclass(frozen=True, eq=False)
class Parameter:
    """A number, or an array of numbers, of a model.

    name: as in "arm.E". value: a float or an array. model: that it is a parameter of. asked: whether it is taken only where somebody
    asks for it by name: its slope is made of differences of models, or another parameter says the same.
    """

    name: str
    value: Any
    model: Any
    asked = False
    why = "its slope takes differences of the model"  # where it is `asked`: the reason why it is not taken without its name
    changes_coordinates = False  # whether the same q may be another position with it
    room = EVERYWHERE  # in which it may be changed

    def work(self, work: Work) -> Any:
        """The slope, of the shape of the value, of the sum over the entries of `w . r + mu . phi + kappa . rate + nu . bias`.

        Times stay; entries beside a kink stay on their side of it.
        """
        raise NotImplementedError

    def of_model(self, function: Callable[[Any], float]) -> float:
        """The slope of a function of the model; 0 where objectives say it by the parameter's name (Slopes)."""
        return 0.0

    def replaced(self, value: Any) -> Any:
        """The model with another value of it, all else the same. Raises InputError where no model has it."""
        raise NotImplementedError

    def start(self, t: float, q: NDArray, bar: NDArray) -> Any:
        """The slope of `bar . initial_velocity(t, q)`, of the shape of the value; None where that does not depend on it."""
        return None

    def kinks(self, t0: float, t1: float) -> dict[float, float]:
        """{time of a kink in (t0, t1), s: by how much it moves with the parameter}, without those that stay."""
        return {}


def total(model: Any, work: Work) -> float:
    """`sum w . r + mu . phi + kappa . rate + nu . bias` of a model over the entries."""
    terms = ((model.phi, work.mu, False), (model.phi_rate, work.kappa, True), (model.phi_bias, work.nu, True))
    result = 0.0
    for k, (t, q, v) in enumerate(zip(work.t.tolist(), work.q, work.v)):
        result += work.w[k] @ model.residual(t, q, v, work.a[k], work.lam[k])
        for function, factor, moving in terms:
            if factor is not None and model.m:
                result += factor[k] @ (function(t, q, v) if moving else function(t, q))
    return float(result)
