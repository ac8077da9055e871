"""Buckling: the factors of a load at which another equilibrium branches off, linearised about an equilibrium.

Along a load factor f the equilibria start as q + f q', lam + f lam'. K and B = phi_q there are, to first order, K + f K' and B + f B':

    [ K + f K'    (B + f B')^T ] [ x  ]
    [ B + f B'    0            ] [ mu ] = 0

has a solution x where another equilibrium may branch off. K' and B' are central differences along q', lam' and the load: exact for plates, whose K is
quadratic in q. With A and A' of these matrices, 1/f are eigenvalues of -A^-1 A'.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.assembly.placement import GRAVITY
from polyida.errors import InputError, StepFailure
from polyida.integrate.input_direction import input_direction, input_names
from polyida.integrate.loose import FREE
from polyida.integrate.start import require_state
from polyida.integrate.state import State
from polyida.integrate.static import Loading, relaxed, start_of_unknowns, whole_load
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT, negative_directions, symmetric
from polyida.modal.modes import translations
from polyida.model import Model
from polyida.model.check import require_declared
from polyida.model.guarded import guard
from polyida.reprs import brief
from polyida.validation import index, named_keywords, whole

PART = 1e-3  # of the model's extent: displacement over which K' and B' are differences
SLOPE = 1e-3  # of the load: step of the slope of r and phi, which is exact for dead loads
SMALL = 400  # unknowns up to which matrices are dense
SPARE = 4  # eigenvalues beyond those that are wanted
REAL = 1e-6  # of |1/f|: larger imaginary parts are no factors
NOTHING = 1e-9  # of the largest |1/f|: round-off of deformations that the load does not soften
ALONG = 0.05  # cosine, in energy, between mode and response: above it the load itself moves along the mode, as at a limit point
FAR = 0.5  # times the extent: a factor at which the response is larger means nothing
LARGE = 0.05  # of the extent: displacements up to the first factor that are not small


@named_keywords
@dataclass(frozen=True, eq=False)
class Buckling:
    """Factors of a load and the shapes that branch off; the result of `pi.buckling`.

    Parameters
    ----------
    model : Model
    state : State
        The equilibrium that the factors are counted from.
    factors : (count,) float
        Positive, ascending; fewer than were asked for if the load softens fewer deformations.
    shapes : (count, n) float
        Changes of q, the largest entry 1.
    along : (count,) float
        Cosine, in energy, between each shape and the response to the load: 0 at a branch of a symmetric structure, near 1 at a limit point, where
        `pi.equilibrium_path` finds the load.
    """

    model: Model
    state: State
    factors: NDArray
    shapes: NDArray
    along: NDArray

    __repr__ = brief

    def title(self, number: int) -> str:
        """Return the title of a mode, such as "mode 1: factor 2.47"."""
        number = index("buckling.title", "number", number, len(self.factors), "modes")
        limit = ", a limit point: see pi.equilibrium_path" if self.along[number] > ALONG else ""
        return f"mode {number + 1}: factor {self.factors[number]:.5g}{limit}"

    def summary(self) -> str:
        """Return a text: a line with their number and the state, then one line for each buckling factor."""
        head = f"{len(self.factors)} buckling factors of {type(self.model).__name__} about t = {self.state.t:.6g} s"
        return "\n".join([head] + [self.title(k) for k in range(len(self.factors))])

    @named_keywords
    def plot(self, number: int | list[int] | None = None, scale: float = 1.0, axes: Any = None) -> Any:
        """Return a matplotlib Figure of the bodies in the state and in a mode; of models without bodies bars.

        Parameters
        ----------
        number : int or list of int, optional
            Indices of modes, 0 that of the least factor, a panel each; by default all.
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

        return plot_modes("buckling.plot", self, self.state.q, number, scale, axes)


@dataclass(frozen=True, eq=False)
class Growing:
    """A load that grows from an equilibrium: the Loading at each factor.

    start: Loading at factor 0; its slope is a dead load. pushed: (number, value) of each profile that grows too.
    """

    start: Loading
    pushed: tuple

    def at(self, factor):
        """The Loading of the model at a load factor."""
        model, t = self.start.model, self.start.t
        for number, value in self.pushed:
            model = model.pushed(t, number, factor * value)
        return replace(self.start, model=model, base=self.start.base + factor * self.start.slope)

    def equations(self, q, lam, factor):
        """Residual of the equilibrium and phi, (n + m,), at q and lam and a load factor."""
        return np.concatenate(self.at(factor).residuals(q, lam, 0.0))

    def matrices(self, q, lam, factor):
        """(K, B): tangent stiffness and phi_q at q and lam and a load factor."""
        loading = self.at(factor)
        return loading.stiffness(q, lam), loading.model.phi_q(loading.t, q)


@named_keywords
def buckling(model: Model, load: object = None, state: State | None = None, count: int = 3, t: float | None = None) -> Buckling:
    """Compute the factors by which a load must grow until another equilibrium branches off: `(K + f K') x + B^T mu = 0`.

    K' is the change of the stiffness with the forces and displacements that the load makes per factor, linearised about the equilibrium without the
    load, or about a given one. At a limit point, as of an arch that snaps through, the result is an estimate, and a warning says so.

    Parameters
    ----------
    model : Model
    load : str, sequence of str, (n,) array_like or callable, optional
        What grows. None: all that loads the model, gravity too. Names of loads or motors, or "gravity": factor 1 is their value at t, or 1
        where that is 0; what is not named stays as it is. A vector of dead forces, N, or a function of q that returns one.
    state : State, optional
        An equilibrium at which all loads act, as of `pi.static`; the factors then count what is added to it. By default the one without the load.
    count : int
        Number of factors; the least positive ones.
    t : float, s, optional
        Time at which loads and motors are evaluated: that of the state, or 0.

    Returns
    -------
    Buckling
        Factors, shapes.

    Raises
    ------
    InputError
        For wrong arguments and for forces without a potential.
    StepFailure
        If there is no equilibrium without the load, or the structure can move freely there.

    Notes
    -----
    Viscoelastic plates have their long-time modulus. Bathe, Finite Element Procedures (2014), 6.8.2.

    Examples
    --------
    >>> pi.buckling(column, load="push").factors  # doctest: +SKIP
    """
    guarded = guard(model, "buckling")
    whole("buckling", "count", count)
    state = None if state is None else require_state("buckling", guarded, state)
    if guarded.strains:
        scene: Any = guarded
        elastic = scene.elastic(relaxed=True)
        about = None if state is None else replace(state, q=state.q[: elastic.n], v=np.zeros(elastic.n), a=np.zeros(elastic.n), memory={})
        found = buckling(elastic, load, about, count, t)
        padded = np.pad(found.shapes, ((0, 0), (0, scene.n - elastic.n)))
        return replace(found, model=model, state=relaxed(scene, found.state) if state is None else state, shapes=padded)
    if t is None:
        t = 0.0 if state is None else state.t
    plain = whole_load("buckling", guarded, t, 1e-10, 25)
    if state is not None and state.t != plain.t:
        raise InputError(f"buckling: t = {t!r} is not that of the state, {state.t!r} s")
    growing = _growing(plain, load, state)
    about, q, lam = _equilibrium(growing, state)
    return _branches(model, growing, about, q, lam, int(count))


def _growing(plain, load, state):
    """The Growing load of a user's `load`, from the state or from no load."""
    model, none = plain.model, np.zeros(plain.model.n)
    if load is None:
        return Growing(replace(plain, base=none if state else plain.base), ())
    names = [load] if isinstance(load, str) else load
    if not (isinstance(names, (list, tuple)) and names and all(isinstance(one, str) for one in names)):
        rest = state or State(plain.t, none, none, none, np.zeros(model.m))
        force = input_direction("buckling", model, rest, load).force
        if not force.any():
            raise InputError("buckling: load is zero, nothing grows")
        return Growing(replace(plain, base=none, slope=force), ())
    slope, pushed, start = none.copy(), [], model
    known = input_names(model)
    for name in names:
        if name == GRAVITY and name not in known:
            slope += _weight(model, load)
            continue
        if not name or name not in known:
            listed = ", ".join(repr(one) for one in dict.fromkeys([*known, GRAVITY]) if one)
            raise InputError(f"buckling: load = {load!r}: no load or motor with a profile is called {name!r}; known: {listed}")
        number = known.index(name)
        value = float(model.drives(plain.t)[number, 0])
        if value and not state:
            start = start.pushed(plain.t, number, -value)
        pushed.append((number, value or 1.0))
    return Growing(replace(plain, model=start, base=none if state else -slope, slope=slope), tuple(pushed))


def _weight(model, load):
    """The dead forces (n,) of gravity. Raises InputError for a model without it."""
    steady = [g for g in getattr(model, "gravity", ()) if isinstance(g, float)]
    if len(steady) < 2 or not any(steady):
        raise InputError(f"buckling: load = {load!r}: the model has no gravity")
    return model.mass(np.zeros(model.n)) @ (translations(model) @ np.array(steady))


def _equilibrium(growing, state):
    """(the equilibrium, q, lam) that the load grows from; q are the unknowns of Loading."""
    loading = growing.start
    model = loading.model
    if state is not None:
        q = state.q.copy()
        q[model.state_columns] = state.v[model.state_columns]
        loading.require_accepted(q)
        return state, q, state.lam
    q = start_of_unknowns(model, None)
    require_declared(model, loading.t, q, np.zeros(model.n))
    q, lam, system = loading.solve(q, loading.multipliers(q, 0.0), 0.0)
    return loading.equilibrium(q, lam, system.solve), q, lam


def _branches(model, growing, about, q, lam, count):
    """The Buckling of a load that grows from an equilibrium q, lam: the `count` smallest factors and their modes."""
    K, B = growing.matrices(q, lam, 0.0)
    system, n = _stable_system(K, B, about.t), len(q)
    slope = (growing.equations(q, lam, SLOPE) - growing.equations(q, lam, -SLOPE)) / (2.0 * SLOPE)
    if not slope.any():
        raise InputError("buckling: the load is zero, nothing grows")
    dq, dlam = system.solve(slope[:n], slope[n:])
    moved, size = float(np.abs(dq).max()), growing.start.model.extent or 1.0
    step = PART * size / moved if moved else 1.0
    ahead, back = (growing.matrices(q + s * dq, lam + s * dlam, s) for s in (step, -step))
    change_K, change_B = ((after - before) / (2.0 * step) for after, before in zip(ahead, back))
    scale = system.size

    def operator(y):
        """Product -A^-1 A' y for y = (x, mu / scale), whose eigenvalues are the inverse factors."""
        x, mu = y[:n], scale * y[n:]
        solved = system.solve(change_K @ x + change_B.T @ mu, change_B @ x)
        return np.concatenate([solved[0], solved[1] / scale])

    values, vectors = _largest(operator, n + len(lam), count)
    kept = _factors(values, moved / size, count)
    shapes = np.array([_real(vectors[:n, k]) for k in kept]).reshape(-1, n)
    found = Buckling(model, about, 1.0 / values[kept].real, shapes, _along(K, shapes, dq))
    _warn(found, moved / size)
    return found


def _stable_system(K, B, t):
    """The factored [[K, B^T], [B, 0]], with a warning if the equilibrium is unstable. Raises InputError and StepFailure."""
    if not symmetric(K):
        raise InputError(
            "buckling: K is not symmetric, a force has no potential: its equilibria may flutter; use modes(..., damped=True) about them"
        )
    try:
        system = KKT(K, B)
        falling = negative_directions(K, B)
    except SingularSystem:
        raise StepFailure("singular", FREE, t) from None
    if system.lu.doubtful():
        raise StepFailure("singular", FREE, t)
    if falling:
        warnings.warn(f"buckling: the equilibrium without the load is UNSTABLE, the energy falls in {falling} directions", stacklevel=5)
    return system


def _factors(values, response, count):
    """Numbers of the `count` largest eigenvalues 1/f that are real, positive and above round-off, the largest first.

    response: displacement per factor over the extent; a factor at which it is larger than FAR means nothing.
    """
    least = max(NOTHING * np.abs(values).max(initial=0.0), response / FAR)
    kept = np.flatnonzero((np.abs(values.imag) <= REAL * np.abs(values)) & (values.real > least))
    return kept[np.argsort(-values[kept].real, kind="stable")][:count]


def _along(K, shapes, dq):
    """Cosines (count,), in the scalar product of K, between each shape and the response dq to the load."""
    energies = np.sqrt(np.abs(np.einsum("kn,kn->k", shapes @ K, shapes)) * abs(dq @ (K @ dq)))
    return np.minimum(np.abs(shapes @ (K @ dq)) / np.where(energies > 0.0, energies, 1.0), 1.0)


def _largest(operator, size, count):
    """Eigenvalues of largest real part, and their vectors (size, .): dense or by Arnoldi's method."""
    wanted = count + SPARE
    if size <= SMALL or wanted >= size - 1:
        return np.linalg.eig(np.array([operator(one) for one in np.eye(size)]).T)
    from scipy.sparse.linalg import LinearOperator, eigs

    start = operator(np.random.default_rng(0).standard_normal(size))
    return eigs(LinearOperator((size, size), operator, dtype=float), wanted, which="LR", v0=start, ncv=min(size, max(40, 4 * wanted)))


def _real(vector):
    """A real vector, its largest entry 1, of one that may have a complex factor."""
    vector = vector / vector[np.argmax(np.abs(vector))]
    return vector.real


def _warn(found, response):
    """Warn of a first factor at a limit point, and of displacements that are not small up to it. response: displacement per factor over the extent."""
    if not len(found.factors):
        warnings.warn(
            "buckling: the load softens no deformation, there is no positive factor; try the load in the other direction", stacklevel=5
        )
    elif found.along[0] > ALONG or response * found.factors[0] > LARGE:
        why = "the load moves along the first mode" if found.along[0] > ALONG else "the structure moves far before it buckles"
        advice = "the first factor is an estimate, follow pi.equilibrium_path to the limit point or branch"
        warnings.warn(f"buckling: {why}; {advice}", stacklevel=5)
