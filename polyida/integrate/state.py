"""What an integrator takes and yields: states, one by one or in stretches, between two of them, and the counts of the work done."""

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from polyida.model import Model
from polyida.reprs import brief
from polyida.validation import is_number


@dataclass(frozen=True)
class State:
    """One accepted instant: t in s, q, v, a (n,), lam (m,).

    `memory` is what the integrator that yielded the state needs besides to go on from it as if it had not stopped
    (generalized-alpha: the algorithmic acceleration `a_alg` and its step; Radau IIA: the last step's polynomial; IDA: nothing).
    restart: False where nothing tells that memory: in the middle of a compiled stretch, between two accepted instants.
    within: a function t -> State in the step that ended here, of an integrator that knows more of it than its two ends.
    """

    t: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    memory: dict = field(default_factory=dict)
    restart: bool = True
    within: Callable[[float], "State"] | None = None

    __repr__ = brief

    def finite(self) -> bool:
        """Whether q and v, and lam, are finite: one product each tells."""
        return math.isfinite(self.q.dot(self.v)) and math.isfinite(self.lam.dot(self.lam))


class Stretch:
    """Accepted states in a row: t (k,), q, v, a (k, n), lam (k, m), and the last of them as a State, with the memory that it may have.

    Those before the last have no memory: a run cannot go on from them. spent: the counts of the work done up to the last state, but for the
    steps, as a dictionary; None where they are those of the whole stretch.
    """

    spent = None

    def __init__(self, t, q, v, a, lam, last=None):
        self.t, self.q, self.v, self.a, self.lam, self._last = t, q, v, a, lam, last

    @classmethod
    def of(cls, state):
        """The Stretch of one State."""
        return Alone(state)

    def __len__(self):
        return len(self.t)

    def __iter__(self):
        return map(self.state, range(len(self)))

    @property
    def last(self):
        """The last State."""
        if self._last is None:
            self._last = State(float(self.t[-1]), self.q[-1], self.v[-1], self.a[-1], self.lam[-1], restart=False)
        return self._last

    def state(self, k):
        """The State number k, counted from 0."""
        if k == len(self) - 1:
            return self.last
        return State(float(self.t[k]), self.q[k], self.v[k], self.a[k], self.lam[k], restart=False)

    def part(self, first, end, every=1):
        """The Stretch of the states from number `first` to before `end`, or of each `every`-th of them."""
        if first == 0 and end >= len(self) and every == 1:
            return self
        at = slice(first, end, every)
        whole = end >= len(self) and every == 1
        return Stretch(self.t[at], self.q[at], self.v[at], self.a[at], self.lam[at], self.last if whole else None)

    def finite(self):
        """Whether q and v, and lam, are finite: one product each tells."""
        return math.isfinite(np.vdot(self.q, self.v)) and math.isfinite(np.vdot(self.lam, self.lam))


class Alone(Stretch):
    """The Stretch of one State, whose vectors are made when they are asked for: an integrator may yield states that are not made whole yet."""

    def __init__(self, state):
        self._last = state

    def __getattr__(self, name):
        if name not in ("t", "q", "v", "a", "lam"):
            raise AttributeError(name)
        return np.asarray(getattr(self._last, name))[None]

    def __len__(self):
        return 1

    def finite(self):
        """Whether the State is."""
        return self._last.finite()


class States:
    """The states of stretches one by one; counts.steps is the number of each as it comes. stretches: what they are taken from."""

    def __init__(self, stretches, counts):
        self.stretches, self._states = stretches, (part.last for stretch in stretches for part in parted(stretch, counts))

    def __iter__(self):
        return self

    def __next__(self):
        return next(self._states)


def parted(stretch, counts, size=lambda: 1):
    """Yield a stretch in parts of `size()` states, with counts as at the last state of each: `steps`, and what `spent` says."""
    done, whole = 0, len(stretch)
    counts.steps -= whole
    while done < whole:
        part = stretch.part(done, done + size())
        done += len(part)
        counts.steps += len(part)
        if part.spent:
            vars(counts).update(part.spent)
        yield part


@dataclass
class Counts:
    """Exact counts of the work done in a run; the same on every machine for fixed-step integrators.

    solves are with the n x n factor. backend names what made it.
    """

    steps: int = 0
    rejected: int = 0
    newton_iterations: int = 0
    residuals: int = 0
    tangents: int = 0
    factorizations: int = 0
    solves: int = 0
    backend: str = ""

    def as_dict(self) -> dict:
        """The counts as a plain dictionary."""
        return asdict(self)


def constant_step(integrator):
    """The step of an integrator that keeps to one, 0 of any other; what a user's own calls h may be anything."""
    h = asked(integrator, "h")
    return float(h) if is_number(h) and not asked(integrator, "adaptive") else 0.0


def cubic(x0, v0, x1, v1, h, s):
    """(x, x') at the part s of an interval of length h, from values x0, x1 and slopes v0, v1 at its ends: Hermite's polynomial."""
    move = x1 - x0
    x = x0 + s * s * (3 - 2 * s) * move + h * s * (1 - s) * ((1 - s) * v0 - s * v1)
    return x, 6 * s * (1 - s) / h * move + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1


def between(before, after, t):
    """The State at t between two accepted ones.

    q is the cubic Hermite polynomial through q and v at both ends, v its derivative, a and lam are linear in t; at an
    end it is the accepted state itself. q is of fourth, v of third, a and lam of second order in the step. An integrator's own
    polynomial, `after.within`, goes before.
    """
    if t in (before.t, after.t):
        return before if t == before.t else after
    if after.within is not None:
        return after.within(t)
    h = after.t - before.t
    s = (t - before.t) / h
    q, v = cubic(before.q, before.v, after.q, after.v, h, s)
    a, lam = before.a + s * (after.a - before.a), before.lam + s * (after.lam - before.lam)
    return State(float(t), q, v, a, lam, restart=False)


class Restart(NamedTuple):
    """Where a run goes on: an accepted state with its memory, the number of frames up to it, the counts at it."""

    state: State
    frames: int
    counts: dict


class Integrator(Protocol):
    """What `solve` takes: settings with one method, a user's as well as ours. What else it may have is in `Declared`."""

    def steps(self, model: Model, state: State, t_end: float, counts: Counts, /) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one a step. Raises StepFailure."""
        ...


class Declared:
    """What else is asked of an integrator, with the values for a class that does not have it.

    h: the step, s, constant unless `adaptive` is True; rtol: the relative tolerance, None without one; adaptive: whether errors choose the
    steps, None where that is not said; max_halvings: of a step that fails. nonholonomic: rows of phi_rate need not be derivatives of phi.
    second_order: the error of a step in v is O(h^3). writes_rows: `steps` takes `rows`, the places of frames, to write into.
    """

    h = rtol = adaptive = max_halvings = None
    nonholonomic = second_order = writes_rows = False

    def require(self, model):
        """Raise InputError unless the integrator can take the model."""

    def require_reach(self, model, state, t_end):
        """Raise InputError unless it can go from the state to t_end."""

    def told(self, memory):
        """What a summary says of the steps, from the memory of the last state."""
        return ""


_DECLARED = Declared()


def asked(integrator, name):
    """What an integrator has under a name of `Declared`, or what that has."""
    return getattr(integrator, name, getattr(_DECLARED, name))
