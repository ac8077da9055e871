"""Linear modes of a model about a state, on the constraints."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.integrate.start import require_state
from polyida.integrate.state import State
from polyida.integrate.static import Equilibrium
from polyida.modal import eigen
from polyida.modal.eigen import linear_system
from polyida.modal.steady import Steady, modes_of
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.reprs import brief
from polyida.validation import flag, index, named_keywords, whole

FAR = 0.01  # of the extent: displacement by loads beyond which a drawing is not in balance
LEADING = 0.5  # of a shape's largest entry: the first entry above it is real and positive
FLUTTER = 1e-9  # of |s|: a root that is less to the right of the imaginary axis is on it


def effective_masses(model, M, X):
    """`|x^H M r|^2`, (count, 2), kg, of mass-normalised shapes X (n, count), r the unit translations along x and y; and `r^T M r`, kg.

    (None, nan) for a model without bodies.
    """
    r = translations(model)
    if r is None:
        return None, float("nan")
    return np.abs(X.conj().T @ (M @ r)) ** 2, float(r[:, 0] @ (M @ r[:, 0]))


def translations(model):
    """Columns (n, 2): changes of q if all bodies move by 1 m along x, and along y; None if the model has no bodies."""
    if not model.is_scene:
        return None
    T = model.translation
    return np.stack([T.view(float), (1j * T).view(float)], axis=1)


@named_keywords
@dataclass(frozen=True, eq=False)
class Modes:
    """Linear modes `x e^(s t)` of a model about a state; the result of `pi.modes`.

    Parameters
    ----------
    model : Model
    state : State
    roots : (count,) complex, 1/s
        s. Without damping a mode is a pair +-s, and the root above the real axis, or the growing one, is stored, ordered by s^2. With damping
        a mode is a complex pair, of which the root above the real axis is stored, or one real root, ordered by |s|.
    shapes : (count, n) float or complex
        x as changes of q (displacements, m, of plates), of modal mass 1 kg: `x^T M x = 1`; complex with damping. The first entry above half of
        the largest is real and positive.
    participation : (count, 2) float, kg, or None
        Effective modal masses along x and y, `|x^H M r|^2` of the unit translation r; None for a model without bodies. Over all modes without
        damping they add up to `mass` less the part on the supports.
    mass : float, kg
        Of the model.
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
        """`|s| / 2 pi`, (count,), Hz, of oscillating modes; 0 of rigid motions and, with damping, of real roots (see `rates`); without damping
        `-|s| / 2 pi` of a pair +-s with s^2 > 0.
        """
        swings = self.roots.imag != 0
        size = np.where(swings | (not np.iscomplexobj(self.shapes)), np.abs(self.roots), 0.0)
        return np.where(swings, 1.0, -1.0) * size / (2 * np.pi) + 0.0

    @property
    def rates(self) -> NDArray:
        """`Re s`, (count,), 1/s: the amplitude of a mode changes as `e^(rate t)`, so it decays if this is negative and grows if positive."""
        return self.roots.real

    @property
    def damping(self) -> NDArray:
        """Ratios `-Re s / |s|`, (count,): 0 without damping and of rigid motions, negative of growing modes; 1 or -1 of real roots."""
        return -self.roots.real / np.where(self.roots == 0, 1.0, np.abs(self.roots))

    @property
    def unstable(self) -> NDArray:
        """True for growing modes, (count,): the state is unstable."""
        return self.roots.real > FLUTTER * np.abs(self.roots)

    def summary(self) -> str:
        """Return a line for each mode: frequency, damping, its share of the mass along x and y."""
        lines = [f"{len(self.roots)} modes of {type(self.model).__name__} about t = {self.state.t:.6g} s"]
        for k in range(len(self.roots)):
            share = "" if self.participation is None else self._share(self.participation[k])
            lines.append(f"{self.title(k)}{share}")
        if self.participation is not None:
            lines.append(f"together of {self.mass:.6g} kg{self._share(self.participation.sum(axis=0))}")
        return "\n".join(lines)

    def _share(self, masses):
        """Text of the shares of modal masses (2,), kg, in the whole mass: along x and along y, in per cent."""
        return ", {:.1%} along x, {:.1%} along y".format(*masses / self.mass)

    @named_keywords
    def plot(self, number: int | list[int] | None = None, scale: float = 1.0, axes: Any = None) -> Any:
        """Return a matplotlib Figure of the bodies in the state and in a mode; of a complex shape its real part, of models without bodies bars.

        Parameters
        ----------
        number : int or list of int, optional
            Indices of modes, 0 the slowest, a panel each; by default all.
        scale : float
            The largest displacement is 12 % of the size of the whole, times this.
        axes : matplotlib axes, optional
            To draw one mode on.

        Returns
        -------
        Figure
            Not to scale.
        """
        from polyida.show.plates import plot_modes

        return plot_modes("modes.plot", self, self.state.q, number, scale, axes)

    def title(self, number: int) -> str:
        """Return "mode 1: 3.42 Hz", with its damping if it has any, or "mode 1: fades at 9.9 1/s" of a real root."""
        number = index("modes.title", "number", number, len(self.roots), "modes")
        damping, root = self.damping[number], self.roots[number]
        if root.real and not root.imag:
            return f"mode {number + 1}: " + (
                f"grows at {root.real:.3g} 1/s, unstable" if root.real > 0 else f"fades at {-root.real:.3g} 1/s"
            )
        fades = f", damping {damping:.3g}" if damping and not self.unstable[number] else ""
        return f"mode {number + 1}: {self.frequencies[number]:.4g} Hz{fades}{', unstable' if self.unstable[number] else ''}"


@named_keywords
def modes(model: Model | Steady, state: State | None = None, count: int = 6, damped: bool = False) -> Modes:
    """Compute linear modes about a state: `s^2 M x + K x + B^T mu = 0`, `B x = 0`, K = d(g + B^T lam)/dq, B = phi_q.

    With damping `(s^2 M + s C + K) x + B^T mu = 0`, C = dg/dv, and `s x = f_q q + f_v v + f_x x` of first-order states, which modes without
    damping hold. Rigid motions have s = 0 twice, x and x t, and are returned once, as 0 Hz; with damping and first-order states twice.
    Growing modes are returned with a warning. Large models are solved by Lanczos' or Arnoldi's method in shift-invert, small ones dense.

    Parameters
    ----------
    model : Model or Steady
        Of a `Steady` rotation the modes in the turning frame, with centrifugal and Coriolis terms, of least |s|, without damping.
    state : State, optional
        One of `pi.static`, or any other with its lam; by default q = 0 at t = 0 without loads (lam = 0), with a warning if the loads would move it
        by more than 1 % of its size or act on a mechanism.
    count : int
        Number of modes: those of least s^2, with damping of least |s|; all if there are fewer.
    damped : bool
        True: the 2 (n - m) roots of the linearised system, the eigenvalues of `pi.linearise(model, state).A` without motors; a mode is a
        complex pair or one real root. False: the n - m modes without damping, each a pair +-s.

    Returns
    -------
    Modes
        Roots, shapes, effective masses.

    Raises
    ------
    InputError
        For wrong arguments, a state off the constraints, redundant constraints, coordinates without mass, and without `damped` for forces
        that have no potential.
    StepFailure
        If Arnoldi's method does not converge.

    Notes
    -----
    Viscoelastic plates have the modulus of a sudden strain, and with damping that of s: `(s^2 M + kappa(s) K) x = 0` about the state at rest,
    kappa(s) = 1 - sum g / (1 + s tau). Their relaxation adds a real root for each tau and elastic mode. Shapes and the result's model are
    without the relaxed strains.

    Examples
    --------
    >>> pi.modes(model, state=pi.static(model), count=3).frequencies  # doctest: +SKIP
    """
    if isinstance(model, Steady):
        return _turning(model, state, count, damped)
    if guard(model, "modes").strains:
        scene: Any = model
        relaxing = linear_system("modes", scene, state) if damped is True else None
        model = scene.elastic(relaxed=False)
        if state is not None:
            q = require_state("modes", scene, state).q[: model.n]
            state = replace(state, q=q, v=np.zeros(model.n), a=np.zeros(model.n), memory={})
    else:
        relaxing = None
    system = linear_system("modes", model, state)
    whole("modes", "count", count)
    if not system.freedoms:
        raise InputError(f"modes: the model cannot move: it has as many constraints as coordinates, {model.n}")
    flag("modes", "damped", damped)
    held = system if damped or not system.model.k else system.with_states_held()
    if not (damped or held.conservative):
        raise InputError("modes: K is not symmetric, a force has no potential; use damped=True, which takes any K")
    if damped:
        roots, X = eigen.damped(relaxing or system, int(count))
        X = X[: system.n]
    else:
        values, X = eigen.undamped(held, min(int(count), held.freedoms))
        X = X if held is system else system.whole(X)
        roots = np.where(values < 0, 1.0, 1j) * np.sqrt(np.abs(values))
    X = normalised(system.M, X)
    if state is None and system.model.is_scene and not damped:
        _warn_off_balance(system, values, X)
    about = state if isinstance(state, Equilibrium) else system.state
    result = Modes(model, about, roots, X.T.copy(), *effective_masses(system.model, system.M, X))
    if result.unstable.any():
        warnings.warn(f"modes: UNSTABLE, {result.unstable.sum()} of the modes grow: see .unstable", stacklevel=3)
    return result


def _turning(found, state, count, damped):
    """The Modes of bodies about a Steady rotation, in the turning frame."""
    if state is not None or damped is not False:
        raise InputError("modes: a steady rotation has a state of its own and no damping; leave state and damped out")
    roots, X = modes_of(found, whole("modes", "count", count))
    model, still = guard(found.model), np.zeros(len(found.q))
    M = model.mass(found.q)
    X = normalised(M, X)
    return Modes(found.model, State(0.0, found.q, still, still, found.lam), roots, X.T.copy(), *effective_masses(model, M, X))


def _warn_off_balance(system, values, X):
    """Warn if the loads move the reference configuration far, or act on a mechanism; springs and plates bear small loads.

    values: omega^2 of the shapes, columns of X, negative of growing ones.
    """
    model, still = system.model, np.zeros(system.n)
    force = model.force(0.0, still, still)
    shares, stiff = X.T @ force, values > 0.0
    moved = float(np.abs(X[:, stiff] @ (shares[stiff] / values[stiff])).max(initial=0.0))
    if moved > FAR * (model.extent or 1.0) or (force.any() and model.m and not stiff.all()):
        how = f"its loads move it by {moved:.3g} m" if stiff.all() else "its loads act on a mechanism"
        warnings.warn(
            f"modes: the drawing is not in balance, {how}, and the modes leave loads out; give state=pi.static(model)", stacklevel=4
        )


def normalised(M: Any, X: NDArray) -> NDArray:
    """Columns X (n, count) scaled to `|x^H M x| = 1`, the first entry above LEADING of the largest real and positive."""
    X = X / np.sqrt(np.abs(np.einsum("ik,ik->k", X.conj(), M @ X)))
    size = np.abs(X)
    leading = np.argmax(size > LEADING * size.max(axis=0), axis=0), np.arange(X.shape[1])
    return X * (size[leading] / X[leading])
