"""Independent coordinates y of small motions, `x = T y + G u`, and what accelerates them.

Columns of T are normal (`B T = 0`, `T^T M T = 1`). G is what inputs that move constraints do at once, `B G = -rows`, normal to T in M, so
that their accelerations move no y: `y'' = T^T M x''`.
"""

from dataclasses import replace

import numpy as np

from polyida.errors import InputError
from polyida.given import is_whole
from polyida.integrate.directions import direction, known_inputs
from polyida.linear.kkt import KKT
from polyida.linear.lu import SingularSystem
from polyida.modal import eigen
from polyida.modal.modes import Modes, normalised
from polyida.modal.system import NO_MASS

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
            self.mass = KKT(system.M, system.B)
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
        return _of_modes(part, system, modes)
    if not is_whole(modes, 1, system.freedoms):
        raise InputError(f"{part}: modes = {str(modes)[:80]} must be None, Modes or a whole number from 1 to {system.freedoms}")
    if not system.conservative:
        raise InputError(f"{part}: K is not symmetric, a force has no potential: it has no undamped modes; leave modes out")
    return normalised(system.M, eigen.undamped(system, modes)[1])


def _of_modes(part, system, modes):
    X = modes.shapes.T
    if len(X) != system.n:
        raise InputError(f"{part}: the modes are of another model, with {len(X)} coordinates; this one has {system.n}")
    if np.iscomplexobj(X):
        raise InputError(f"{part}: modes with damping are complex; give those without, pi.modes(model, state)")
    if np.abs(system.B @ X).max(initial=0.0) > OFF * abs(system.B).max(initial=0.0) * np.abs(X).max():
        raise InputError(f"{part}: the modes are about another state, they leave the constraints of this one")
    return X
