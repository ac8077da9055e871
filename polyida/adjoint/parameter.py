"""A parameter of a model: its slope in a sum over a run, and the model with another value of the parameter."""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import wraps
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.assembly.scene_model import SceneModel
from polyida.errors import DONE
from polyida.joint.attachment import Attachment
from polyida.model.differences import EVERYWHERE
from polyida.system import dense as small
from polyida.system.own import small_own, small_table


class AdjointMultipliers(NamedTuple):
    """States t (k,), q, v, a (k, n), lam (k, m), and the multipliers of their equations.

    w (k, n) multiplies the residual r, mu (k, m) the constraints phi, kappa (k, m) their rate `phi_q v + phi_t` and nu (k, m)
    their bias `(phi_q v)_q v + 2 phi_qt v + phi_tt`; None if all are zero.
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


class SharedStates(list):
    """AdjointMultipliers of several objectives at the same states. w (k, columns, n): all their w; by default a copy of these."""

    def __init__(self, works, w=None):
        """Take the AdjointMultipliers of each objective; w: all their w if they are in one array already."""
        super().__init__(works)
        self.w = np.stack([work.w for work in works], axis=1) if w is None else w


def stacked(entries):
    """One AdjointMultipliers of those of single states, or None for none."""
    if not entries:
        return None
    return AdjointMultipliers(np.array([entry.t for entry in entries]), *(np.stack(column) for column in list(zip(*entries))[1:]))


@dataclass(eq=False)
class CachedByMultipliers:
    """`make(model, work)`, cached for the last AdjointMultipliers. together: function (model, SharedStates) -> the results of all."""

    make: Callable[[Any, Any], Any]
    model: Any
    together: Callable[[Any, Any], Any] | None = None
    _last: tuple = field(default=((), ()), init=False)

    def prepare(self, works):
        """Compute and keep the results of several AdjointMultipliers together, if there is a function for it."""
        if self._last[0] is not works and self.together:
            self._last = works, self.together(self.model, works)

    def __call__(self, work):
        """The result for AdjointMultipliers: the cached one, or a new one."""
        for known, result in zip(*self._last):
            if known is work:
                return result
        self._last = [work], [self.make(self.model, work)]
        return self._last[1][0]


@dataclass(frozen=True, eq=False)
class Parameter:
    """A number, or an array of numbers, of a model.

    name: such as "arm.E". value: a float or an array. model: whose parameter it is. only_by_name: True if `gradient` takes it only if it is
    named, because its slope needs differences of models or another parameter is equivalent; reason: why. changes_coordinates: True if the
    same q may be another position with another value. bounds: interval in which the value may change.
    """

    name: str
    value: Any
    model: Any
    only_by_name = False
    reason = "its slope takes differences of the model"  # of only_by_name
    changes_coordinates = False
    bounds = EVERYWHERE

    def slope(self, work: AdjointMultipliers) -> Any:
        """The slope of the sum over the entries of `w . r + mu . phi + kappa . rate + nu . bias`, of the shape of the value.

        Times are held; entries beside a kink stay on their side of it.
        """
        raise NotImplementedError

    def prepare(self, works: SharedStates) -> None:
        """Compute together what `slope` shares between several AdjointMultipliers at the same states, of which it is asked next."""

    def of_model(self, function: Callable[[Any], float]) -> float:
        """The slope of a function of the model; 0 if objectives give it under the name of the parameter (Slopes.direct)."""
        return 0.0

    def replaced(self, value: Any) -> Any:
        """A copy of the model with another value of this parameter. Raises InputError if no model has this value."""
        raise NotImplementedError

    def start(self, t: float, q: NDArray, adjoint: NDArray) -> Any:
        """The slope of `adjoint . initial_velocity(t, q)`, of the shape of the value; None if it does not depend on the parameter."""
        return None

    def kinks(self, t0: float, t1: float) -> dict[float, float]:
        """{time of a kink in (t0, t1), s: its derivative with respect to the parameter}, without zeros."""
        return {}


@dataclass(frozen=True, eq=False)
class PartParameter(Parameter):
    """A number, or numbers, in a field of a part of a scene. part: name of the part. path: names of the fields, outermost first."""

    part: str
    path: tuple

    def replaced(self, value):
        """A copy of the scene with another value in this field of the part."""
        entry = tuple(value) if np.ndim(value) else value
        return with_part(self.model, self.part, with_field(self.model.parts[self.part], self.path, entry))


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


def equation_values(model):
    """Return a function (work) -> values of r, phi, rate and bias of all entries, concatenated, without those whose multipliers are None.

    It calls compiled code if numba compiled the functions of a user's model.
    """
    table = small_table(model) if model.by_numba and small_own(model) else None

    def values(work):
        """The values of the equations at all entries, by compiled code if there is any."""
        state, (w, *rows) = [np.ascontiguousarray(x, float) for x in work[:5]], work[5:]
        results = [np.zeros(np.shape(w)), *(np.zeros((0 if x is None else len(x), model.m)) for x in rows)]
        if table:
            table.evaluate_constants(float(work.t[0]), work.q[0])
        if not table or small.values(table.w, tuple(state), tuple(results)) != DONE:
            for k, (t, q, v, a, lam) in enumerate(zip(work.t.tolist(), *state[1:])):
                if len(w):
                    results[0][k] = model.residual(t, q, v, a, lam)
                for rows_of_phi, function, state_of_phi in zip(
                    results[1:], (model.phi, model.phi_rate, model.phi_bias), ((q,), (q, v), (q, v))
                ):
                    if len(rows_of_phi):
                        rows_of_phi[k] = function(t, *state_of_phi)
        return np.concatenate([x.ravel() for x in results])

    return values


def select_entries(work, which):
    """The entries with the given indices."""
    return AdjointMultipliers(*(x if x is None else x[which] for x in work))


def with_parts(model, parts, gravity=None):
    """A copy of the model with other parts of the same names and the same factors of cells."""
    new = SceneModel(parts, model.gravity if gravity is None else gravity, model.treats_redundant, late=model.late)
    return new.with_factors(**model.factors) if model.factors else new


def of_all_parts(change):
    """The function `change(model, ...)` that gives a copy of a model of all its parts, also for a mode of it that events made."""

    @wraps(change)
    def of_mode(model, *arguments):
        """The changed copy of a model of all parts; for a mode, the same mode of the changed copy of its whole model."""
        return change(model, *arguments) if model.whole is None else change(model.whole, *arguments).mode_like(model)

    return of_mode


def with_field(part, path, value):
    """A copy of a dataclass, part, with `value` in the field at `path`: names of nested dataclass fields, outermost first, one at least."""
    key, *inner = path
    return replace(part, **{key: with_field(getattr(part, key), inner, value) if inner else value})


@of_all_parts
def with_part(model, name, new):
    """A copy of the model with one part replaced; attachments to a replaced body move to the new one."""
    return with_parts(model, parts_with(model.parts, name, new, lambda attachment, body: attachment.on(body)))


def parts_with(parts, name, new, move):
    """Parts with one replaced; attachments to a replaced body become move(attachment, new)."""
    old = parts[name]
    on_new = lambda value: move(value, new) if isinstance(value, Attachment) and value.body is old else value  # noqa: E731
    return {known: new if part is old else _with_values(part, on_new) for known, part in parts.items()}


@of_all_parts
def with_profile(model, old, new):
    """A copy of the model with a profile replaced wherever it occurs."""
    parts = {name: part_with_profile(part, old, new) for name, part in model.parts.items()}
    return with_parts(model, parts, tuple(new if g is old else g for g in model.gravity))


def part_with_profile(part, old, new):
    """A copy of the part with a profile replaced in its fields and in tuples of them; the part itself if it does not have it."""
    return _with_values(part, lambda value: new if value is old else value)


def _with_values(part, change):
    """A copy of the part with `change` applied to its fields and to items of tuples; the part itself if nothing changes."""
    old = {field.name: getattr(part, field.name) for field in fields(part) if field.init}
    new = {name: tuple(map(change, value)) if isinstance(value, tuple) else change(value) for name, value in old.items()}
    different = {name: value for name, value in new.items() if not _same(value, old[name])}
    return replace(part, **different) if different else part


def _same(one, other):
    """True if two values, or all entries of two tuples, are the same objects."""
    return one is other or isinstance(one, tuple) and len(one) == len(other) and all(x is y for x, y in zip(one, other))
