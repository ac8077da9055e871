"""What an input of a model pushes: derivatives of r and phi in the value of a profile, or a direction of force of one's own."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.model import Model, differences
from polyida.validation import floats, read_only


@dataclass(frozen=True, eq=False)
class Direction:
    """`r + ... = force u`, `phi + row u = 0` for a small input u: force (n,), row (m,). drives: whether it moves constraints."""

    label: str
    force: np.ndarray
    row: np.ndarray

    @property
    def drives(self):
        """Whether it moves constraints: a motor's angle."""
        return bool(self.row.any())


def known_inputs(model):
    """Names of the profiles of a model, numbered where several have one name; empty of those that are nobody's."""
    names = [name for name, _ in model.named_profiles]
    return [name if not name or names.count(name) == 1 else f"{name} {names[:k].count(name)}" for k, name in enumerate(names)]


def direction(part: str, model: Model, state: Any, given: Any) -> Direction:
    """The Direction of an input at a state: of the name of a profile, a vector (n,), or a function of q that gives one.

    Raises InputError, in the name of `part`, for anything else, and for a profile that moves nothing there.
    """
    if isinstance(given, str):
        return _of_profile(part, model, state, given)
    found = floats(given(read_only(state.q)) if callable(given) else given)
    if found is None or found.shape != (model.n,):
        what = f"must be the name of a profile ({_known(model)}), {model.n} finite numbers, or a function of q that gives these"
        raise InputError(f"{part}: input {str(given)[:80]} {what}")
    return Direction("", found, np.zeros(model.m))


def _of_profile(part, model, state, name):
    known = known_inputs(model)
    if not name or name not in known:
        raise InputError(f"{part}: no load or motor with a profile is called {name!r}; known: {_known(model)}")
    number, still, t, q = known.index(name), np.zeros(model.n), state.t, state.q

    def both(s):
        pushed = model.pushed(t, number, s)
        return np.concatenate([pushed.residual(t, q, still, still, state.lam), pushed.phi(t, q)])

    slope = differences.along(both)
    if not slope.any():
        raise InputError(f"{part}: the profile of {name!r} moves nothing at this state")
    return Direction(name, -slope[: model.n], slope[model.n :])


def _known(model):
    return ", ".join(repr(name) for name in known_inputs(model) if name) or "none"
