"""How a small input, a load or a motor, enters the equations of a model at a state: a direction of forces and of constraint rows."""

from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.model import differences
from polyida.validation import floats, read_only


@dataclass(frozen=True, eq=False)
class InputDirection:
    """`r + ... = force u`, `phi + row u = 0` for a small input u: force (n,), row (m,). label: the profile's name, or empty."""

    label: str
    force: np.ndarray
    row: np.ndarray


def input_names(model):
    """Names of the model's profiles, numbered if several have one name; empty for those without a name."""
    names = [name for name, _ in model.named_profiles]
    return [name if not name or names.count(name) == 1 else f"{name} {names[:k].count(name)}" for k, name in enumerate(names)]


def input_direction(part, model, state, value):
    """The InputDirection of the name of a profile, of a vector (n,), or of a function of q that returns one, at a state.

    Raises InputError, in the name of `part`, for anything else and for a profile that has no effect there.
    """
    names = input_names(model)
    known = ", ".join(repr(name) for name in names if name) or "none"
    if not isinstance(value, str):
        force = floats(value(read_only(state.q)) if callable(value) else value)
        if force is None or force.shape != (model.n,):
            what = f"must be the name of a profile ({known}), {model.n} finite numbers, or a function of q that gives these"
            raise InputError(f"{part}: input {str(value)[:80]} {what}")
        return InputDirection("", force, np.zeros(model.m))
    if not value or value not in names:
        raise InputError(f"{part}: no load or motor with a profile is called {value!r}; known: {known}")
    number, rest, t, q = names.index(value), state.v - model.without_states(state.v), state.t, state.q

    def equations(s):
        """(residual, phi) at the state with the profile's value changed by s."""
        pushed = model.pushed(t, number, s)
        return np.concatenate([pushed.residual(t, q, rest, np.zeros(model.n), state.lam), pushed.phi(t, q)])

    slope = differences.along(equations)
    if not slope.any():
        raise InputError(f"{part}: the profile of {value!r} moves nothing at this state")
    return InputDirection(value, -slope[: model.n], slope[model.n :])
