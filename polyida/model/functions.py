"""The functions of a user's model: what they take and return, which of them a model writes, and whether they can be called."""

from contextlib import suppress
from functools import cache
from inspect import signature

import numpy as np

from polyida.errors import InputError
from polyida.model import Model
from polyida.validation import is_whole, takes

OF_CONSTRAINTS = ("phi", "phi_q", "reaction_q", "phi_t", "phi_rate", "phi_bias", "phi_rate_q", "phi_bias_q")
SHAPES = {  # of the returned arrays, in n, m and k
    "rates": "k",  # first: those of other functions call it
    "mass": "nn",
    "force": "n",
    "phi": "m",
    "phi_q": "mn",
    "phi_t": "m",
    "residual": "n",
    "force_q": "nn",
    "force_v": "nn",
    "mass_a_q": "nn",
    "reaction_q": "nn",
    "phi_bias": "m",
    "potential": "",
    "tangent": "nn",
    "phi_rate": "m",
    "phi_rate_q": "mn",
    "phi_bias_q": "mn",
}
OF_STEPS = tuple(name for name in SHAPES if name not in ("potential", "tangent", "phi_rate", "phi_rate_q", "phi_bias_q"))  # for tables
CHECKED = tuple(name for name in SHAPES if name != "potential")
FUNCTIONS = tuple(name for name, default in vars(Model).items() if callable(default) and name[0] != "_")  # all that a user may write
ASKED = (  # with arguments that are checked
    *SHAPES, "momenta", "powers", "psi", "psi_v", "gaps", "kinks", "rejection_reason", "initial_velocity", "potentials", "residual_p", "phi_p",
)  # fmt: skip


def writes(model, name):
    """True if a model's class, or the object itself, has a function of this name in place of Model's; of Equations, if the user's has."""
    written = vars(model).get("written_names")
    if written is not None:
        return name in written
    return getattr(type(model), name) is not getattr(Model, name) or name in vars(model)


@cache
def arguments_of(name):
    """Names of the arguments of a function of Model, without self."""
    return tuple(signature(getattr(Model, name)).parameters)[1:]


def require_counted(model):
    """Raise InputError for rows that would be ignored, because the class that writes them counts none, and for states without rates.

    A class that inherits from one with rows may set their number to zero, and an object its own.
    """
    name = type(model).__name__
    for size, function, call in (("m", "phi", model.phi), ("p", "psi", model.psi)):
        writer = next(one for one in (model, *type(model).__mro__) if function in vars(one))
        if size in vars(model) or not (writes(model, function) and is_whole(getattr(writer, size, None), 0, 0)):
            continue
        rows, arguments = 0, arguments_of(function)
        with suppress(Exception), np.errstate(all="ignore"):
            rows = np.size(call(0.0, *np.zeros((len(arguments) - 1, model.n))))
        if rows:
            told = f"its class gives {function}({', '.join(arguments)}), but {size} = 0, so it would be ignored"
            raise InputError(f"{name}: {told}: set {size} to the number of its rows")
    if not (is_whole(model.algebraic, 0, 0) or writes(model, "rates")):  # k may be a number of the user's own, such as a stiffness
        raise InputError(f"{name}: algebraic = {model.algebraic!r:.60} states, but its class gives no rates(t, q, v, x)")


def require_arguments(user):
    """Raise InputError for a function of a user's model that does not take its arguments; OwnStates says which take the states."""
    for name in ASKED:
        if not writes(user, name) or (name in OF_CONSTRAINTS and not user.m) or (name in ("psi", "psi_v") and not user.p):
            continue
        function, arguments = getattr(user, name), arguments_of(name)
        if not (takes(function, len(arguments)) or writes(user, "rates") and takes(function, len(arguments) + 1)):
            given = f"it takes {signature(function)}" if callable(function) else f"it is {type(function).__name__}"
            raise InputError(f"{type(user).__name__}.{name} must be a function {name}({', '.join(['self', *arguments])}); {given}")
