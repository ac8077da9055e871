"""Inputs, independent coordinates and outputs of small motions: `x = T y + G u`, and what accelerates y.

Columns of T are normal (`B T = 0`, `T^T M T = 1`). G is what inputs that move constraints do at once, `B G = -rows`, normal to T in M, so
that their accelerations move no y: `y'' = T^T M x''`. Outputs are places, velocities, accelerations and reactions by name, or combinations
of coordinates.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.integrate.directions import direction, known_inputs
from polyida.joint.attachment import Attachment
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT
from polyida.modal import eigen
from polyida.modal.modes import Modes, normalised
from polyida.modal.system import NO_MASS
from polyida.model import differences
from polyida.results.motion import reaction_of
from polyida.validation import floats, is_one_of, is_whole

OFF = 1e-6  # of |B| |x|: modes that leave the constraints by more are none of this state
MOST = 2000  # coordinates that are taken without modes


def inputs_of(part, model, state, given):
    """A list of Direction with labels, of what a user gives: None (all profiles), one, a list or a dictionary {label: one}.

    Raises InputError in the name of `part`.
    """
    if given is None:
        given = [name for name in known_inputs(model) if name]
    if not isinstance(given, (list, dict)):
        given = [given]
    named = given.items() if isinstance(given, dict) else ((None, one) for one in given)
    found = [(label, direction(part, model, state, one)) for label, one in named]
    return [replace(one, label=str(label or one.label or f"input {k}")) for k, (label, one) in enumerate(found)]


class Coordinates:
    """T (n, d) and, of inputs, forces (n, k), rows (m, k) and G (n, k). modes: None for all coordinates, a number of modes, or Modes."""

    def __init__(self, part, system, inputs, modes=None):
        self.system, n, m = system, system.n, system.model.m
        try:
            self.mass = KKT(system.M, system.B, 1.0)
        except SingularSystem:
            raise InputError(NO_MASS) from None
        self.T = _basis(part, system, modes)
        self.forces = np.array([one.force for one in inputs]).reshape(len(inputs), n).T
        self.rows = np.array([one.row for one in inputs]).reshape(len(inputs), m).T
        self.G = self.mass.solve(np.zeros_like(self.forces), self.rows)[0]

    def accelerations(self, x, v, forces, rows):
        """(x'', mu) for columns x, v (n, k) under forces (n, k) and with the accelerations of the rows (m, k)."""
        r = self.system.K @ x - forces
        if self.system.C is not None:
            r = r + self.system.C @ v
        if not np.iscomplexobj(r):
            return self.mass.solve(r, rows)
        parts = [self.mass.solve(part(r), part(rows)) for part in (np.real, np.imag)]
        return tuple(real + 1j * imaginary for real, imaginary in zip(*parts))

    def reduced(self, a):
        """y'' of columns a (n, k)."""
        return self.T.T @ (self.system.M @ a)


def _basis(part, system, modes):
    if modes is None:
        if system.freedoms > MOST:
            raise InputError(f"{part}: modes = None takes all {system.freedoms} coordinates, {MOST} at most; give a number of modes")
        return system.basis
    if isinstance(modes, Modes):
        X = modes.shapes.T
        if len(X) != system.n:
            raise InputError(f"{part}: the modes are of another model, with {len(X)} coordinates; this one has {system.n}")
        if np.iscomplexobj(X):
            raise InputError(f"{part}: modes with damping are complex; give those without, pi.modes(model, state)")
        if np.abs(system.B @ X).max(initial=0.0) > OFF * abs(system.B).max(initial=0.0) * np.abs(X).max():
            raise InputError(f"{part}: the modes are about another state, they leave the constraints of this one")
        return X
    if not is_whole(modes, 1, system.freedoms):
        raise InputError(f"{part}: modes = {str(modes)[:80]} must be None, Modes or a whole number from 1 to {system.freedoms}")
    if not system.conservative:
        raise InputError(f"{part}: K is not symmetric, a force has no potential: it has no undamped modes; leave modes out")
    return normalised(system.M, eigen.undamped(system, modes)[1])


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
