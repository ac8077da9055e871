"""What is looked at in small motions: places, velocities, accelerations and reactions by name, or a combination of coordinates."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.given import floats, is_one_of
from polyida.joint.attachment import Attachment
from polyida.model import differences
from polyida.results.motion import reaction_of

KINDS = ("position", "velocity", "acceleration", "reaction")
MOTION = {"position": 0, "velocity": 1, "acceleration": 2}


@dataclass(frozen=True, eq=False)
class Output:
    """labels: of its components. along(moved, mu): their changes, (components, k), where q, v and a change by the three of `moved`,
    (n, k) each, and lam by mu (m, k)."""

    labels: tuple[str, ...]
    along: Callable[[tuple[NDArray, NDArray, NDArray], NDArray], NDArray]


def outputs_of(part, model, state, given):
    """A list of Output of what a user gives: None, one, a list or a dictionary {label: one}. Raises InputError, in the name of `part`."""
    if given is None:
        given = default(model)
    if isinstance(given, (dict, list)) and not given:
        raise InputError(f"{part}: output {given!r} names nothing to look at; leave it out for masses, loads or all coordinates")
    if isinstance(given, dict):
        return [_output(part, model, state, one, str(label)) for label, one in given.items()]
    given = given if isinstance(given, list) else [given]
    return [_output(part, model, state, one, None) for one in given]


def default(model):
    """The places of all masses and loads; without any, all of q."""
    names = [name for name, thing in model.parts.items() if isinstance(getattr(thing, "at", None), Attachment)]
    return names or {f"q[{k}]": row for k, row in enumerate(np.eye(model.n))}


def labels_of(outputs):
    """Labels of all components."""
    return tuple(label for output in outputs for label in output.labels)


def along(outputs, moved, mu):
    """Changes of all components, (components, k), real or complex."""
    if any(map(np.iscomplexobj, (*moved, mu))):
        real, imaginary = (along(outputs, tuple(map(take, moved)), take(mu)) for take in (np.real, np.imag))
        return real + 1j * imaginary
    return np.concatenate([np.zeros((0, mu.shape[1])), *(output.along(moved, mu) for output in outputs)])


def _output(part, model, state, given, label):
    vector = None if isinstance(given, (str, Attachment)) else floats(given)
    if vector is not None and vector.shape == (model.n,):
        return Output((label or "output",), lambda moved, mu: vector[None] @ moved[0])
    what, kind = given if isinstance(given, tuple) and len(given) == 2 else (given, "position")
    if not is_one_of(kind, KINDS) or not isinstance(what, (str, Attachment)):
        wanted = f"a name, (name, one of {', '.join(KINDS)}), or {model.n} finite numbers"
        raise InputError(f"{part}: output {str(given)[:80]} must be {wanted}")
    return _reaction(part, model, state, what, label) if kind == "reaction" else _place(model, state, what, kind, label)


def _place(model, state, what, kind, label):
    model.position(what, state.q[None])
    name = label or (f"{what} {kind}" if kind != "position" else f"{what}")

    def change(moved, mu):
        X = moved[MOTION[kind]]
        return _slope(lambda s: model.position(what, state.q + s * X.T).T, X)

    return Output((f"{name} x", f"{name} y"), change)


def _reaction(part, model, state, name, label):
    if not is_one_of(name, model.joints):
        raise InputError(f"{part}: no joint is called {name!r}; known: {', '.join(map(repr, model.joints)) or 'none'}")

    def reactions(q, lam):
        return reaction_of(model, name, np.full(len(q), state.t), q, lam).T

    def change(moved, mu):
        return _slope(lambda s: reactions(state.q + s * moved[0].T, state.lam + s * mu.T), moved[0])

    count = len(reactions(state.q[None], state.lam[None]))
    return Output(tuple(f"{label or name + ' reaction'} {k}" for k in range(count)), change)


def _slope(function, X):
    """Derivative along columns X (n, k), in which q moves by about 1e-3 of a metre at most."""
    return differences.along(function, 1.0 / (float(np.abs(X).max(initial=0.0)) or 1.0))
