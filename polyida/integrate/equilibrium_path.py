"""The path of equilibria through turning points of the load: snap-through, and the equilibria behind it.

Steps follow the path by its arc length: the load factor is one more multiplier, the length one more constraint.

```
[ K     B^T   -slope ] [ dq      ]     [ r                      ]
[ B     0      0     ] [ dlam    ] = - [ phi                    ]      |x|^2 = sum w_i x_i^2, sum w_i = 1
[ w Dq  0      0     ] [ dfactor ]     [ (|Dq|^2 - length^2) / 2 ]
```
Dq = q - q0 is the distance from the last point (Crisfield 1981, the cylindrical form; linearised in every iteration as in Ramm 1981 and
Schweizerhof, Wriggers 1986). The matrix is regular at turning points of the factor, where K is singular.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError, StepFailure
from polyida.integrate.input_direction import input_direction
from polyida.integrate.loose import FREE
from polyida.integrate.start import vector_of
from polyida.integrate.state import State
from polyida.integrate.static import Equilibrium, Loading, relaxed, start_of_unknowns, whole_load
from polyida.linear.saddle import coordinate_sizes
from polyida.model import Model
from polyida.model.check import require_declared
from polyida.model.guarded import guard
from polyida.reprs import brief
from polyida.validation import is_whole, named_keywords, number

ITERATIONS = 4  # of a step of the right length
LEAST_FIRST = 1e-14  # of the factor, or of 1: a shorter step does not change it
LONGEST = 64.0  # times the first step
FARTHEST = 0.1  # of the model's extent: the longest step
SHORTEST = 2.0**-16  # of the first step
TURNING_TOLERANCE = 1e-9  # of a step: tolerance of a turning point
LOST = "the path of equilibria is lost"
STRAIGHT = 0.9  # least cosine of the angle between a step and the path at its two ends


@named_keywords
@dataclass(frozen=True, eq=False)
class EquilibriumPath:
    """Equilibria and their load factors in the order of the path, from `equilibrium_path`.

    Parameters
    ----------
    model : Model
        The model.
    factors : (points,) array
        Load factors.
    states : tuple of Equilibrium
        The points.
    turning : tuple of int
        Indices of the points at which the factor turns.
    message : str
        Why the path ended before the factor or the number of points that was asked for, else empty.
    """

    model: Model
    factors: NDArray
    states: tuple[Equilibrium, ...]
    turning: tuple[int, ...]
    message: str = ""

    __repr__ = brief

    def __len__(self) -> int:
        """Return the number of points of the path."""
        return len(self.states)

    @property
    def q(self) -> NDArray:
        """Coordinates q of all points, (points, n)."""
        return np.array([state.q for state in self.states])

    @property
    def lam(self) -> NDArray:
        """Multipliers lam of all points, (points, m)."""
        return np.array([state.lam for state in self.states])

    @property
    def falling(self) -> tuple[int | None, ...]:
        """Number of directions in which the energy falls at each point, None if unknown; it changes at turning points and branches."""
        return tuple(state.falling for state in self.states)

    @property
    def branches(self) -> tuple[int, ...]:
        """Points behind which another path branches off: `falling` changes there otherwise than by one at a turning point."""
        regular = [(k, falls) for k, falls in enumerate(self.falling) if k not in self.turning and falls is not None]
        return tuple(k for (k, one), (then, other) in zip(regular, regular[1:]) if abs(other - one) != then - k - 1)

    def position(self, name: object) -> NDArray:
        """Path of a named point, (points, 2), m."""
        return self.model.position(name, self.q)

    def summary(self) -> str:
        """One line: the range of the factor, where it turns, how the path ended."""
        turns = ", ".join(f"{self.factors[k]:.6g}" for k in self.turning) or "nowhere"
        branches = ", ".join(f"{self.factors[k]:.6g}" for k in self.branches)
        branch = f", another path branches off behind {branches}" if branches else ""
        end = f"; ended early: {self.message}" if self.message else ""
        low, high = self.factors.min(), self.factors.max()
        return f"{len(self)} equilibria at load factors from {low:.6g} to {high:.6g}, turning at {turns}{branch}{end}"


@dataclass(frozen=True, eq=False)
class Point:
    """An equilibrium on the path and the direction of the path there, of length one: `q' = dq/ds`, `lam'`, `rate = dfactor/ds`.

    q: the unknowns of Loading.
    """

    factor: float
    q: np.ndarray
    state: Equilibrium
    q_s: np.ndarray
    lam_s: np.ndarray
    rate: float


class ArcLength:
    """Steps along the equilibria of a Loading."""

    def __init__(self, loading: Loading):
        """Take the loading; the squares of coordinates count in the length by their typical sizes."""
        self.loading = loading
        sizes = coordinate_sizes(loading.model, np.zeros(loading.model.n))
        self.weights = sizes**-2 / np.sum(sizes**-2)

    def first(self, q, factor):
        """The Point at a factor, by Newton's method from q; its direction is that of a growing factor."""
        loading = self.loading
        q, lam, system = loading.solve(q, loading.multipliers(q, factor), factor)
        if system.lu.doubtful():
            raise StepFailure("singular", FREE, loading.t)
        loading.require_accepted(q)
        q_s, lam_s = system.solve(-loading.slope, np.zeros(loading.model.m))
        size = float(np.sqrt(self.weights @ q_s**2))
        if not size > 0:
            raise StepFailure("singular", "the load moves nothing", loading.t)
        return Point(factor, q, loading.equilibrium(q, lam, system.solve), q_s / size, lam_s / size, 1.0 / size)

    def next(self, point, length):
        """(the Point at the distance `length`, which may be negative, iterations). Raises StepFailure."""
        loading = self.loading
        q, lam, factor = point.q + length * point.q_s, point.state.lam + length * point.lam_s, point.factor + length * point.rate
        for iteration in range(1, loading.max_iterations + 1):
            r, phi = loading.residuals(q, lam, factor)
            displacement = q - point.q
            dq, dlam = self._system(q, lam, displacement).solve(r, np.append(phi, (self.weights @ displacement**2 - length**2) / 2))
            loading.require_near(q, dq, iteration)
            q, lam, factor = q + dq, lam + dlam[:-1], factor + float(dlam[-1])
            if loading.converged(q, dq):
                break
        else:
            raise StepFailure("newton", LOST, loading.t, iterations=loading.max_iterations)
        loading.require_accepted(q)
        chord = (q - point.q) / length
        system = self._system(q, lam, chord)
        q_s, lam_s = system.solve(np.zeros(len(q)), np.append(np.zeros(len(lam)), -1.0))
        size = float(np.sqrt(self.weights @ q_s**2))
        if min(self.weights @ (chord * point.q_s), 1.0 / size) < STRAIGHT:  # it may be a point of another path
            raise StepFailure("bent", LOST, loading.t)
        state = loading.equilibrium(q, lam, lambda r, phi: system.solve(r, np.append(phi, 0.0)))
        return Point(factor, q, state, q_s / size, lam_s[:-1] / size, float(lam_s[-1]) / size), iteration

    def _system(self, q, lam, displacement):
        """The factored matrix; displacement: the one whose length is prescribed."""
        loading, B = self.loading, self.loading.model.phi_q(self.loading.t, q)
        return loading.factored(loading.stiffness(q, lam), _with_row(B, self.weights * displacement), LOST, _with_row(B, -loading.slope))


def _with_row(B, row):
    """B (m, n), dense or sparse, with one more row."""
    if not hasattr(B, "tocsc"):
        return np.vstack([B, row])
    from scipy.sparse import csr_array, vstack

    return vstack([csr_array(B), csr_array(row[None])], format="csr")


@named_keywords
def equilibrium_path(
    model: Model,
    load: object = None,
    t: float = 0.0,
    q0: ArrayLike | None = None,
    first: float = 0.05,
    until: float = 1.0,
    count: int = 200,
    start: float = 0.0,
    tolerance: float = 1e-10,
    max_iterations: int = 25,
) -> EquilibriumPath:
    """Follow the equilibria under a growing load by arc length, through points at which the load turns.

    Parameters
    ----------
    model : Model
        The model.
    load : str, (n,) array_like or callable, optional
        None: the model's own load, `g(q) + phi_q^T lam = (1 - factor) g(0)`. Otherwise a load `factor f` beside the model's own: the name of a
        load with a profile, a vector f, N, or a function of q that returns it, evaluated at the start (dead loads).
    t : float, s
        Time at which loads and motors are evaluated.
    q0 : (n,) array_like, optional
        Guess of the coordinates, zero by default.
    first : float
        Load factor of the first step; later steps are up to 64 times as long in q, depending on the convergence of Newton's method.
    until : float
        The path ends with the first point at this factor or above.
    count : int
        Largest number of points.
    start : float
        Factor of the first point, for structures whose stiffness comes from the load.
    tolerance : float
        Newton's method ends at |dq| <= tolerance (length + |q|), largest entries; length: of the scene, 1 of an own model.
    max_iterations : int
        Largest number of Newton iterations in a step.

    Returns
    -------
    EquilibriumPath
        Points of the path, turning points (to round-off) among them. A failure behind the first point is in its `message`.

    Raises
    ------
    InputError
        For a wrong setting.
    StepFailure
        If there is no first equilibrium.

    Notes
    -----
    Viscoelastic plates have their long-time modulus. Crisfield, Computers and Structures 13 (1981) 55-62.

    Examples
    --------
    >>> path = pi.equilibrium_path(arch, first=0.02, until=2.0)
    >>> path.factors[list(path.turning)]
    """
    guarded = guard(model, "equilibrium_path")
    if guarded.strains:
        scene: Any = guarded
        elastic, q = scene.elastic(relaxed=True), vector_of("q0", q0, scene)[: 2 * scene.n_factored]
        force = None if load is None or isinstance(load, str) or callable(load) else vector_of("load", load, scene)[: len(q)]
        path = equilibrium_path(elastic, load if force is None else force, t, q, first, until, count, start, tolerance, max_iterations)
        return replace(path, model=model, states=tuple(relaxed(scene, state) for state in path.states))
    loading = whole_load("equilibrium_path", guarded, t, tolerance, max_iterations)
    first, until, start = (
        number("equilibrium_path", name, value, "a factor of the load")
        for name, value in (("first", first), ("until", until), ("start", start))
    )
    if not first > LEAST_FIRST * max(1.0, abs(start)):
        raise InputError(f"equilibrium_path: first = {first!r} must be positive, more than the round-off of start")
    if not until > start:
        raise InputError(f"equilibrium_path: until = {until!r} must be greater than start = {start!r}")
    if not is_whole(count, 2):
        raise InputError(f"equilibrium_path: count = {count!r} must be a whole number of at least 2")
    q = start_of_unknowns(guarded, q0)
    require_declared(guarded, loading.t, q, np.zeros(guarded.n))
    if load is not None:
        loading = _loading_of(loading, load, q)
    points, turning, message = _follow(ArcLength(loading), q, first, until, count, start)
    return EquilibriumPath(model, np.array([p.factor for p in points]), tuple(p.state for p in points), tuple(turning), message)


def _loading_of(loading, load, q):
    """The Loading in which `load` alone grows, beside the model's own load. Raises InputError for a load that is zero or moves constraints."""
    model, (place, v, zero) = loading.model, loading.at_rest(q)
    direction = input_direction("equilibrium_path", model, State(loading.t, place, v, zero, np.zeros(model.m)), load)
    if direction.row.any():
        raise InputError(f"equilibrium_path: {direction.label!r} moves constraints; only forces have a load factor")
    if not direction.force.any():
        raise InputError("equilibrium_path: the load is zero")
    return replace(loading, base=np.zeros(model.n), slope=direction.force)


def _follow(arc, q, first, until, count, start):
    """(Points of the path from the factor `start`, indices of the turning points, why it ended early or an empty text).

    A step is halved where it fails, and else its length follows from the iterations that it took. Raises StepFailure without a first point.
    """
    points, turning = [arc.first(q, start)], []
    most = FARTHEST * (arc.loading.model.extent or np.inf)
    length = unit = min(first / points[0].rate, most)
    while len(points) < count and points[-1].factor < until:
        last = points[-1]
        try:
            point, iterations = arc.next(last, length)
            if last.rate * point.rate < 0:
                turn = _turning_point(arc, last, length)
                turning.append(len(points))
                points.append(turn)
        except StepFailure as failure:
            length /= 2
            if length < SHORTEST * unit:
                return points, turning, str(failure)
            continue
        points.append(point)
        length = min(LONGEST * unit, most, length * float(np.clip((ITERATIONS / iterations) ** 0.5, 0.5, 2.0)))
    return points, turning, ""


def _turning_point(arc, last, length):
    """The Point within a step at which the rate of the factor is zero."""
    from scipy.optimize import brentq

    rate = lambda s: arc.next(last, s)[0].rate if s else last.rate  # noqa: E731
    return arc.next(last, brentq(rate, 0.0, length, xtol=TURNING_TOLERANCE * length))[0]
