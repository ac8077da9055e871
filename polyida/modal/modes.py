"""Linear modes about a state, on the constraints."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.brief import brief
from polyida.errors import InputError
from polyida.given import is_flag, is_number, is_whole
from polyida.integrate.state import State
from polyida.integrate.statics.loading import Equilibrium
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

    __repr__ = brief

    @property
    def frequencies(self) -> NDArray:
        """`|s| / 2 pi`, (count,), Hz, of modes that swing or fade; 0 of rigid motions; minus that where a mode grows without swinging."""
        return np.where((self.roots.imag == 0) & (self.roots.real > 0), -1.0, 1.0) * np.abs(self.roots) / (2 * np.pi)

    @property
    def damping(self) -> NDArray:
        """Ratios `-Re s / |s|`, (count,): 0 undamped and of rigid motions, 1 of modes that fade without swinging, negative where they
        grow.
        """
        return -self.roots.real / np.where(self.roots == 0, 1.0, np.abs(self.roots))

    @property
    def unstable(self) -> NDArray:
        """Which modes grow, (count,) of True and False: the state is left at a touch."""
        return self.roots.real > FLUTTER * np.abs(self.roots)

    def summary(self) -> str:
        """A line a mode: frequency, damping, its share of the mass along x and y."""
        lines = [f"{len(self.roots)} modes of {type(self.model).__name__} about t = {self.state.t:.6g} s"]
        for k in range(len(self.roots)):
            share = "" if self.participation is None else self._share(self.participation[k])
            lines.append(f"{self.title(k)}{share}")
        if self.participation is not None:
            lines.append(f"together of {self.mass:.6g} kg{self._share(self.participation.sum(axis=0))}")
        return "\n".join(lines)

    def _share(self, masses):
        return ", {:.1%} along x, {:.1%} along y".format(*masses / self.mass)

    def plot(self, number: int | list[int] | None = None, scale: float = 1.0, axes: Any = None) -> Any:
        """A matplotlib Figure of the bodies at rest and in a mode, not to scale: its largest displacement is 12 % of the size of the whole,
        times `scale`. Complex shapes when their first large entry is; models without bodies as bars.

        number: index of a mode, 0 the slowest, or a list, a panel each; None for all. axes: matplotlib axes to draw one mode on
        instead. Raises InputError for a number that there is not, and a scale that is not positive.
        """
        from polyida.show.small_motions import draw, shapes

        wanted = list(range(len(self.roots))) if number is None else number if isinstance(number, list) else [number]
        if not wanted or not all(is_whole(k, 0, len(self.roots) - 1) for k in wanted):
            raise InputError(f"modes.plot: number = {number!r} must be the index of one of {len(self.roots)} modes, or a list of these")
        if not (is_number(scale) and scale > 0):
            raise InputError(f"modes.plot: scale = {scale!r} must be positive")
        if axes is None:
            return shapes(self.model, self.state.q, [(self.title(k), self.shapes[k]) for k in wanted], scale)
        draw(axes, self.model, self.state.q, self.shapes[wanted[0]], self.title(wanted[0]), scale)
        return axes.figure

    def title(self, number: int) -> str:
        """ "mode 1: 3.42 Hz", with its damping where there is, and a word where it grows."""
        damping = self.damping[number]
        fades = f", damping {damping:.3g}" if damping and not self.unstable[number] else ""
        return f"mode {number + 1}: {self.frequencies[number]:.4g} Hz{fades}{', unstable' if self.unstable[number] else ''}"


@named_keywords
def modes(model: Model, state: State | None = None, count: int = 6, damped: bool = False) -> Modes:
    """The `count` slowest Modes about a state, or all n - m where these are fewer: `omega^2 M x = K x + B^T mu`, `B x = 0`, K = d(g + B^T
    lam)/dq, B = phi_q.

    state: one of `pi.static`, or any other with its lam; by default q = 0 at t = 0 as it is drawn, without loads (lam = 0). damped: with
    C = dg/dv, `(s^2 M + s C + K) x + B^T mu = 0`. Rigid motions come as 0 Hz, modes that grow with a warning.
    Large models by Lanczos' or Arnoldi's method in shift-invert, small ones dense.
    Raises InputError for a wrong count, no model, no state of it, one off its constraints, redundant constraints, coordinates without mass,
    and without `damped` for forces that have no potential; StepFailure where Arnoldi's method does not converge.

        pi.modes(model, state=pi.static(model), count=3).frequencies
    """
    system = linear_system("modes", model, state)
    if not is_whole(count):
        raise InputError(f"modes: count = {count!r} must be a whole number of at least 1")
    if not system.freedoms:
        raise InputError(f"modes: the model cannot move: it has as many constraints as coordinates, {model.n}")
    count = min(int(count), system.freedoms)
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
    about = state if isinstance(state, Equilibrium) else system.state
    found = Modes(model, about, roots, X.T.copy(), *effective_masses(system.model, system.M, X))
    if found.unstable.any():
        warnings.warn(f"modes: UNSTABLE, {found.unstable.sum()} of the modes grow: see .unstable", stacklevel=3)
    return found


def normalised(M: Any, X: NDArray) -> NDArray:
    """Columns X (n, count) scaled to `|x^H M x| = 1`, the first entry above LEADING of the largest real and positive."""
    X = X / np.sqrt(np.abs(np.einsum("ik,ik->k", X.conj(), M @ X)))
    size = np.abs(X)
    leading = np.argmax(size > LEADING * size.max(axis=0), axis=0), np.arange(X.shape[1])
    return X * (size[leading] / X[leading])
