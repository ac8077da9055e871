"""Linear modes about a state, on the constraints."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.given import is_flag, is_whole
from polyida.integrate.state import State
from polyida.keywords import named_keywords
from polyida.modal import eigen
from polyida.modal.participation import effective_masses
from polyida.modal.system import linear_system
from polyida.model import Model

LEADING = 0.5  # of a shape's largest entry: the first entry above it is real and positive
FLUTTER = 1e-9  # of |s|: a root to the right of the imaginary axis by no more is on it


@named_keywords
@dataclass(frozen=True, eq=False)
class Modes:
    """Linear modes `x e^(s t)` of a model about a state, the slowest first; what `pi.modes` gives.

    roots: s, (count,), 1/s, complex, one of each conjugate pair. shapes: x, (count, n), as changes of q (displacements, m, of plates), of
    modal mass 1 kg: `x^T M x = 1`; complex with damping. The first entry above half of the largest is real and positive.
    participation: effective modal masses along x and y, (count, 2), kg, `(x^T M r)^2` of the unit translation r, and None of a model
    without bodies; over all modes they add up to `mass`, kg, less what the supports hold.
    """

    model: Model
    state: State
    roots: NDArray
    shapes: NDArray
    participation: NDArray | None
    mass: float

    @property
    def frequencies(self) -> NDArray:
        """`|s| / 2 pi`, (count,), Hz, of modes that swing or fade; 0 of rigid motions; minus that where a mode grows without swinging."""
        return np.where((self.roots.imag == 0) & (self.roots.real > 0), -1.0, 1.0) * np.abs(self.roots) / (2 * np.pi)

    @property
    def damping(self) -> NDArray:
        """Ratios `-Re s / |s|`, (count,): 0 undamped and of rigid motions, 1 of modes that fade without swinging, negative where they grow."""
        return -self.roots.real / np.where(self.roots == 0, 1.0, np.abs(self.roots))

    @property
    def unstable(self) -> NDArray:
        """Which modes grow, (count,) of True and False: the state is left at a touch."""
        return self.roots.real > FLUTTER * np.abs(self.roots)

    def summary(self) -> str:
        """A line a mode: frequency, damping, share of the mass along x and y."""
        lines = [f"{len(self.roots)} modes of {type(self.model).__name__} about t = {self.state.t:.6g} s"]
        for k, (frequency, damping, grows) in enumerate(zip(self.frequencies, self.damping, self.unstable)):
            share = ""
            if self.participation is not None:
                share = ", {:.1%} of the mass along x, {:.1%} along y".format(*self.participation[k] / self.mass)
            fades = f", damping {damping:.3g}" if damping else ""
            lines.append(f"{k:3d}  {frequency:.6g} Hz{fades}{', UNSTABLE' if grows else ''}{share}")
        if self.participation is not None:
            x, y = self.participation.sum(axis=0) / self.mass
            lines.append(f"together {x:.1%} of {self.mass:.6g} kg along x, {y:.1%} along y")
        return "\n".join(lines)


@named_keywords
def modes(model: Model, state: State | None = None, count: int = 6, damped: bool = False) -> Modes:
    """The `count` slowest Modes about a state: `omega^2 M x = K x + B^T mu`, `B x = 0`, K = d(g + B^T lam)/dq, B = phi_q.

    state: one of `pi.static`, or any other with its lam; by default q = 0 at t = 0 as it is drawn, without loads (lam = 0). damped: with
    C = dg/dv, `(s^2 M + s C + K) x + B^T mu = 0`. Rigid motions come as 0 Hz, modes that grow with a warning.
    Large models by Lanczos' or Arnoldi's method in shift-invert, small ones dense.
    Raises InputError for a wrong count, no model, no state of it, one off its constraints, redundant constraints, coordinates without mass,
    and without `damped` for forces that have no potential.

        pi.modes(model, state=pi.static(model), count=3).frequencies
    """
    system = linear_system("modes", model, state)
    if not is_whole(count, 1, system.freedoms):
        raise InputError(f"modes: count = {count!r} must be a whole number from 1 to {system.freedoms}: n - m of the model")
    if not is_flag(damped):
        raise InputError(f"modes: damped = {damped!r} must be True or False")
    if not (damped or system.conservative):
        raise InputError("modes: K is not symmetric, a force has no potential; use damped=True, which takes any K")
    if damped:
        roots, X = eigen.damped(system, count)
    else:
        values, X = eigen.undamped(system, count)
        roots = np.where(values < 0, 1.0, 1j) * np.sqrt(np.abs(values))
    X = normalised(system.M, X)
    found = Modes(model, system.state, roots, X.T.copy(), *effective_masses(system.model, system.M, X))
    if found.unstable.any():
        warnings.warn(f"modes: UNSTABLE, {found.unstable.sum()} of the modes grow: see .unstable", stacklevel=2)
    return found


def normalised(M: Any, X: NDArray) -> NDArray:
    """Columns X (n, count) scaled to `|x^H M x| = 1`, the first entry above LEADING of the largest real and positive."""
    X = X / np.sqrt(np.abs(np.einsum("ik,ik->k", X.conj(), M @ X)))
    size = np.abs(X)
    leading = np.argmax(size > LEADING * size.max(axis=0), axis=0), np.arange(X.shape[1])
    return X * (size[leading] / X[leading])
