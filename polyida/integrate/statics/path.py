"""The path of equilibria through turning points of the load: snap-through and what lies behind it.

Steps go along the path by its length: the load factor is one more multiplier, the length one more constraint.

```
[ K     B^T   -slope ] [ dq      ]     [ r                      ]
[ B     0      0     ] [ dlam    ] = - [ phi                    ]      |x|^2 = sum w_i x_i^2, sum w_i = 1
[ w Dq  0      0     ] [ dfactor ]     [ (|Dq|^2 - length^2) / 2 ]
```
Dq = q - q0 is the way since the last point (Crisfield 1981, the cylindrical form; linearised in every iteration as Ramm 1981 and Schweizerhof
and Wriggers 1986 do). The matrix is regular at turning points of the factor, where K alone is not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError, StepFailure
from polyida.integrate.directions import direction
from polyida.integrate.start import given
from polyida.integrate.state import State
from polyida.integrate.statics.static import FREE, Equilibrium, Loading, whole_load
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT, coordinate_sizes
from polyida.model import Model
from polyida.model.check import require_declared
from polyida.model.guarded import guard
from polyida.reprs import brief
from polyida.validation import is_number, is_whole, named_keywords

WANTED = 4  # iterations of a step of the right length
LONGEST = 64.0  # times the first step
FARTHEST = 0.1  # of the model's extent: no step is longer
SHORTEST = 2.0**-16
CLOSE = 1e-9  # of a step: how sharply a turning point is found
LOST = "the path of equilibria is lost"
STRAIGHT = 0.9  # cosine of the angle, at most, between a step and the path at its two ends


@dataclass(frozen=True, eq=False)
class Point:
    """An equilibrium on the path and the way on from it, of length one: `q' = dq/ds`, `lam'`, and `rate = dfactor/ds`."""

    factor: float
    state: Equilibrium
    q_s: np.ndarray
    lam_s: np.ndarray
    rate: float


class Path:
    """Points of a Loading's equilibria."""

    def __init__(self, loading: Loading):
        self.loading = loading
        sizes = coordinate_sizes(loading.model, np.zeros(loading.model.n))
        self.weights = sizes**-2 / np.sum(sizes**-2)

    def length(self, x):
        """|x|, m: the root mean square, by mass, of displacements."""
        return float(np.sqrt(self.weights @ x**2))

    def begin(self, q, factor):
        """The Point at a factor, by Newton's method from q; it goes on to where the factor grows."""
        loading = self.loading
        q, lam, system = loading.solve(q, loading.multipliers(q, factor), factor)
        if system.lu.doubtful():
            raise StepFailure("singular", FREE, loading.t)
        loading.require_accepted(q)
        q_s, lam_s = system.solve(-loading.slope, np.zeros(loading.model.m))
        size = self.length(q_s)
        if not size > 0:
            raise StepFailure("singular", "the load moves nothing", loading.t)
        return Point(factor, loading.found(q, lam, system.solve), q_s / size, lam_s / size, 1.0 / size)

    def onward(self, point, length):
        """(the next Point, iterations) at a distance `length` from one, to either side. Raises StepFailure."""
        loading, start = self.loading, point.state
        q, lam, factor = start.q + length * point.q_s, start.lam + length * point.lam_s, point.factor + length * point.rate
        for iteration in range(1, loading.max_iterations + 1):
            r, phi = loading.residuals(q, lam, factor)
            way = q - start.q
            system = self._system(q, lam, way)
            dq, dlam = system.solve(r, np.append(phi, (self.weights @ way**2 - length**2) / 2))
            loading.require_near(q, dq, iteration)
            q, lam, factor = q + dq, lam + dlam[:-1], factor + float(dlam[-1])
            if loading.converged(q, dq):
                return self._reached(point, q, lam, factor, (q - start.q) / length), iteration
        raise StepFailure("newton", LOST, loading.t, iterations=loading.max_iterations)

    def _reached(self, last, q, lam, factor, chord):
        """The Point at (q, lam, factor). Raises StepFailure where the path bends too far on the way there: it may be another's point."""
        self.loading.require_accepted(q)
        system = self._system(q, lam, chord)
        q_s, lam_s = system.solve(np.zeros(len(q)), np.append(np.zeros(len(lam)), -1.0))
        size = self.length(q_s)
        if min(self.weights @ (chord * last.q_s), 1.0 / size) < STRAIGHT:
            raise StepFailure("bent", LOST, self.loading.t)
        solve = lambda r, phi: system.solve(r, np.append(phi, 0.0))  # noqa: E731
        return Point(factor, self.loading.found(q, lam, solve), q_s / size, lam_s[:-1] / size, float(lam_s[-1]) / size)

    def _system(self, q, lam, along):
        """The factored system; along: the way whose length is held."""
        K, B = self.loading.stiffness(q, lam), self.loading.model.phi_q(self.loading.t, q)
        try:
            return KKT(K, _under(B, self.weights * along), pull=_under(B, -self.loading.slope))
        except SingularSystem:
            raise StepFailure("singular", LOST, self.loading.t) from None


def _under(B, row):
    """B (m, n), dense or sparse, with one row more."""
    if not hasattr(B, "tocsc"):
        return np.vstack([B, row])
    from scipy.sparse import csr_array, vstack

    return vstack([csr_array(B), csr_array(row[None])], format="csr")


@named_keywords
@dataclass(frozen=True, eq=False)
class EquilibriumPath:
    """Equilibria in the order of the path, and their load factors; what `pi.equilibrium_path` gives.

    states: each an Equilibrium. factors: (points,). turning: the points among them where the factor turns, as indices. message: why it
    ended before what was asked for, else empty.
    """

    model: Model
    factors: NDArray
    states: tuple[Equilibrium, ...]
    turning: tuple[int, ...]
    message: str = ""

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.states)

    @property
    def q(self) -> NDArray:
        """(points, n)."""
        return np.array([state.q for state in self.states])

    @property
    def lam(self) -> NDArray:
        """(points, m)."""
        return np.array([state.lam for state in self.states])

    @property
    def falling(self) -> tuple[int | None, ...]:
        """In how many directions the energy falls at each point, None where that cannot be told; it changes at turning points and branches."""
        return tuple(state.falling for state in self.states)

    @property
    def branches(self) -> tuple[int, ...]:
        """Points behind which `falling` changes otherwise than by one where the factor turns: another path branches off before the next."""
        regular = [(k, falls) for k, falls in enumerate(self.falling) if k not in self.turning and falls is not None]
        return tuple(k for (k, one), (then, other) in zip(regular, regular[1:]) if abs(other - one) != then - k - 1)

    def position(self, name: object) -> NDArray:
        """Path of a named point, (points, 2), m."""
        return self.model.position(name, self.q)

    def summary(self) -> str:
        """The range of the factor, where it turns, how it ended, in one line."""
        turns = ", ".join(f"{self.factors[k]:.6g}" for k in self.turning) or "nowhere"
        branches = ", ".join(f"{self.factors[k]:.6g}" for k in self.branches)
        branch = f", another path branches off behind {branches}" if branches else ""
        end = f"; ended early: {self.message}" if self.message else ""
        low, high = self.factors.min(), self.factors.max()
        return f"{len(self)} equilibria at load factors from {low:.6g} to {high:.6g}, turning at {turns}{branch}{end}"


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
    """The EquilibriumPath from the factor `start` of a load on, by arc length, through points where the load turns.

    load: None, all of the model's: `g(q) + phi_q^T lam = (1 - factor) g(0)`; or what comes beside the model's own, `factor f`: the name of
    a load with a profile, a vector f (n,), N, or a function of q that gives it (taken at the start: dead loads). first: of the factor, in
    the first step; later ones are up to 64 times as long in q, as Newton's method converges. until: it ends with the first point at this
    factor or beyond, or after `count` points. start: where all stiffness is that of loads, begin with a part of them. Turning points are
    found to round-off and are points of the path. Raises InputError for a wrong setting, StepFailure where there is no first equilibrium;
    what fails later is in `message`.

        path = pi.equilibrium_path(arch, first=0.02, until=2.0)
        path.factors[list(path.turning)]
    """
    guarded = guard(model, "equilibrium_path")
    loading = whole_load("equilibrium_path", guarded, t, tolerance, max_iterations)
    _require(first, until, start, count)
    q = given(guarded, "q0", q0)
    require_declared(guarded, loading.t, q, np.zeros(guarded.n))
    if load is not None:
        loading = _beside(loading, q, load)
    way = Path(loading)
    points, turning, message = _walk(way, way.begin(q, start), first, until, count)
    return EquilibriumPath(model, np.array([p.factor for p in points]), tuple(p.state for p in points), tuple(turning), message)


def _require(first, until, start, count):
    for name, value in (("first", first), ("until", until), ("start", start)):
        if not is_number(value):
            raise InputError(f"equilibrium_path: {name} = {value!r} must be a finite number, a factor of the load")
    if not first > 0:
        raise InputError(f"equilibrium_path: first = {first!r} must be positive")
    if not until > start:
        raise InputError(f"equilibrium_path: until = {until!r} must be greater than start = {start!r}")
    if not is_whole(count, 2):
        raise InputError(f"equilibrium_path: count = {count!r} must be a whole number of at least 2")


def _beside(loading, q, load):
    """The Loading of a force beside those of the model."""
    at = State(loading.t, q, *np.zeros((2, len(q))), np.zeros(loading.model.m))
    pushed = direction("equilibrium_path", loading.model, at, load)
    if pushed.drives:
        raise InputError(f"equilibrium_path: {pushed.label!r} moves constraints; only forces have a load factor")
    if not pushed.force.any():
        raise InputError("equilibrium_path: the load is zero")
    zero = np.zeros(len(q))
    return Loading(loading.model, loading.t, zero, pushed.force, loading.tolerance, loading.max_iterations)


def _walk(way: Path, point: Point, first, until, count):
    """(points, numbers of those that turn, why it ended early or "")."""
    points, most = [point], FARTHEST * (way.loading.model.extent or np.inf)
    turning: list[int] = []
    length = unit = min(first / point.rate, most)
    while len(points) < count and points[-1].factor < until:
        last = points[-1]
        try:
            then, iterations = way.onward(last, length)
            turn = [_turn(way, last, length)] if last.rate * then.rate < 0 else []
        except StepFailure as failure:
            length /= 2
            if length < SHORTEST * unit:
                return points, turning, str(failure)
            continue
        turning += [len(points)] * len(turn)
        points += [*turn, then]
        length = min(LONGEST * unit, most, length * float(np.clip((WANTED / iterations) ** 0.5, 0.5, 2.0)))
    return points, turning, ""


def _turn(way, last, length):
    """The Point within a step where the rate of the factor is zero."""
    from scipy.optimize import brentq

    rate = lambda s: way.onward(last, s)[0].rate if s else last.rate  # noqa: E731
    return way.onward(last, brentq(rate, 0.0, length, xtol=CLOSE * length))[0]
