"""A parameter of a model: its slope in a sum over a run, and the model with another value of it."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.assembly.scene_model import SceneModel
from polyida.errors import DONE
from polyida.joint.attachment import Attachment
from polyida.model.differences import EVERYWHERE
from polyida.model.guarded import unguarded
from polyida.system import dense as small
from polyida.system.python import small_own, small_table


class AdjointMultipliers(NamedTuple):
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
    """One AdjointMultipliers of entries of single states, or None where there is none."""
    if not entries:
        return None
    return AdjointMultipliers(np.array([entry.t for entry in entries]), *(np.stack(column) for column in list(zip(*entries))[1:]))


@dataclass(eq=False)
class Shared:
    """`make(model, work)`, kept for the last AdjointMultipliers that it was asked for."""

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

    def slope(self, work: AdjointMultipliers) -> Any:
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


@dataclass(frozen=True, eq=False)
class OfPart(Parameter):
    """A number, or numbers, in a field of a part of a scene. part: its name. path: the names of the fields, from the part inwards."""

    part: str
    path: tuple

    def replaced(self, value):
        """The scene with the part of another value."""
        given = tuple(value) if np.ndim(value) else value
        return with_part(self.model, self.part, changed(self.model.parts[self.part], self.path, given))


def total(model: Any, work: AdjointMultipliers) -> float:
    """`sum w . r + mu . phi + kappa . rate + nu . bias` of a model over the entries."""
    terms = ((model.phi, work.mu, False), (model.phi_rate, work.kappa, True), (model.phi_bias, work.nu, True))
    result = 0.0
    for k, (t, q, v) in enumerate(zip(work.t.tolist(), work.q, work.v)):
        if work.w[k].any():
            result += work.w[k] @ model.residual(t, q, v, work.a[k], work.lam[k])
        for function, factor, moving in terms:
            if factor is not None and factor[k].any():
                result += factor[k] @ (function(t, q, v) if moving else function(t, q))
    return float(result)


def values_of(model):
    """A function (work) that gives all that its factors multiply, r, phi, rate and bias of all entries, one behind the other.

    In compiled code where numba compiled the functions of a guarded model of one's own.
    """
    table = small_table(model) if unguarded(model).by_numba and small_own(model) else None

    def values(work):
        state, (w, *rows) = [np.ascontiguousarray(x, float) for x in work[:5]], work[5:]
        found = [np.zeros(np.shape(w)), *(np.zeros((0 if x is None else len(x), model.m)) for x in rows)]
        if table:
            table.hold_constant(float(work.t[0]), work.q[0])
        if not table or small.values(table.w, *state, *found) != DONE:
            for k, (t, q, v, a, lam) in enumerate(zip(work.t.tolist(), *state[1:])):
                if len(w):
                    found[0][k] = model.residual(t, q, v, a, lam)
                for made, function, given in zip(found[1:], (model.phi, model.phi_rate, model.phi_bias), ((q,), (q, v), (q, v))):
                    if len(made):
                        made[k] = function(t, *given)
        return np.concatenate([x.ravel() for x in found])

    return values


def entries_of(work, which):
    """The entries of some numbers."""
    return AdjointMultipliers(*(x if x is None else x[which] for x in work))


def rebuilt(model, parts, gravity=None):
    """The model of other parts of the same names, with the factors of this one."""
    made = SceneModel(parts, model.gravity if gravity is None else gravity, model.treats_redundant)
    return made.with_factors(**model.factors) if model.factors else made


def changed(part, path, value):
    """The part with another value in a field, or in that of what stands in a field: path, their names."""
    key, *inner = path
    return replace(part, **{key: changed(getattr(part, key), inner, value) if inner else value})


def with_part(model, name, new):
    """The model with a part changed; what holds on to a body holds on to the changed one."""
    old = model.parts[name]
    on_new = lambda value: value.on(new) if isinstance(value, Attachment) and value.body is old else value  # noqa: E731
    return rebuilt(model, {known: new if part is old else _with(part, on_new) for known, part in model.parts.items()})


def with_profile(model, old, new):
    """The model with another profile wherever it has this one."""
    parts = {name: holding_profile(part, old, new) for name, part in model.parts.items()}
    return rebuilt(model, parts, tuple(new if g is old else g for g in model.gravity))


def holding_profile(part, old, new):
    """The part with another profile in its fields, alone or in a tuple, in place of one; itself where it has not that."""
    return _with(part, lambda value: new if value is old else value)


def _with(part, change):
    """The part with `change` done to its fields and to what tuples among them hold; itself where that changes nothing."""
    given = {field.name: getattr(part, field.name) for field in fields(part) if field.init}
    found = {name: tuple(map(change, value)) if isinstance(value, tuple) else change(value) for name, value in given.items()}
    different = {name: value for name, value in found.items() if not _same(value, given[name])}
    return replace(part, **different) if different else part


def _same(one, other):
    return one is other or isinstance(one, tuple) and len(one) == len(other) and all(x is y for x, y in zip(one, other))
