"""The path of equilibria through turning points of the load: snap-through and what lies behind it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.brief import brief
from polyida.errors import InputError
from polyida.given import is_number, is_whole
from polyida.integrate.directions import direction
from polyida.integrate.start import given
from polyida.integrate.state import State, StepFailure
from polyida.integrate.statics.arc import Path, Point
from polyida.integrate.statics.loading import Equilibrium, Loading
from polyida.integrate.statics.static import whole_load
from polyida.keywords import named_keywords
from polyida.model import Model
from polyida.model.check import require_declared
from polyida.model.guarded import guard

WANTED = 4  # iterations of a step of the right length
LONGEST = 64.0  # times the first step
FARTHEST = 0.1  # of the model's extent: no step is longer
SHORTEST = 2.0**-16
CLOSE = 1e-9  # of a step: how sharply a turning point is found


@named_keywords
@dataclass(frozen=True, eq=False)
class EquilibriumPath:
    """Equilibria in the order of the path, and their load factors; what `pi.equilibrium_path` gives.

    states: each an Equilibrium. factors: (points,). turning: the points among them where the factor turns, as indices. message: why it ended
    before what was asked for, else empty.
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

    load: None, all of the model's: `g(q) + phi_q^T lam = (1 - factor) g(0)`; or what comes beside the model's own, `factor f`: the name of a
    load with a profile, a vector f (n,), N, or a function of q that gives it (taken at the start: dead loads). first: of the factor, in the
    first step; later ones are up to 64 times as long in q, as Newton's method converges. until: it ends with the first point at this
    factor or beyond, or after `count` points. start: where all stiffness is that of loads, begin with a part of them.
    Turning points are found to round-off and are points of the path.
    Raises InputError for a wrong setting, StepFailure where there is no first equilibrium; what fails later is in `message`.

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
