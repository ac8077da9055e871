"""How far a second thread can bring a step: what the memory gives to two threads, and what two halves of a model make of it.

A step streams the factor, twice a solve, and does little beside. Two models of half the size, which share nothing and wait for nothing,
are the best that a step in two threads could be; each gives bit by bit what it gives alone.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from polyida.compiled import entry
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.start import consistent_state
from polyida.integrate.state import Counts
from polyida.linear.cholesky.factor import symbolic_of
from polyida.problems import plates
from step_cost.measure import H, cells_for

MANY = 64 * 2**20  # bytes of an array that no cache holds
THREADS = 2


@entry
def _triad(a, b, c):
    for i in range(a.shape[0]):
        a[i] = b[i] + 0.5 * c[i]


class Half:
    """A run of generalized-alpha on the double plate, taken some steps at a time."""

    def __init__(self, dof):
        self.model = plates.double_plate(cells_for(dof)).build()
        self.begin()

    def begin(self):
        """Start anew, with a factor made."""
        state = consistent_state(self.model)
        self.states = GeneralizedAlpha(h=H).steps(self.model, state, 1e5 * H, Counts())
        self.take(2)

    def take(self, steps):
        """The state after so many more steps."""
        for _ in range(steps):
            state = next(self.states)
        return state


def wall(call):
    """Seconds that call() takes."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def threads_row(dof, steps, repeats):
    """Triad and steps in one thread and in two: medians of wall times measured in turn, and lowest and highest ratio of a turn.

    triad: a = b + c/2 on arrays that no cache holds, 24 bytes a number. Raises ArithmeticError where results differ by the threads.
    """
    halves = [Half(dof // THREADS) for _ in range(THREADS)]
    triads = [partial(_triad, *np.ones((3, MANY // 8))) for _ in range(THREADS)]
    with ThreadPoolExecutor(THREADS) as pool:
        require_same(halves, steps, pool)
        rows = []
        for _ in range(repeats):
            by_turns = wall(lambda: [half.take(1) for _ in range(steps) for half in halves])
            at_once = wall(lambda: list(pool.map(lambda half: half.take(steps), halves)))
            rows.append((by_turns, at_once, *(wall(lambda run=run: list(run(lambda triad: triad(), triads))) for run in (map, pool.map))))
    one, two, triad_one, triad_two = np.median(rows, axis=0)
    ratios, moved = [row[0] / row[1] for row in rows], THREADS * 3 * MANY / 1e9
    panels = sum(4 * int(half.model.once(symbolic_of).panel[-1]) for half in halves)
    return {
        "n": sum(half.model.n for half in halves),
        "factor_mb": panels / 1e6,
        "one_thread_ms": 1e3 * one / steps,
        "two_threads_ms": 1e3 * two / steps,
        "speedup": float(np.median(ratios)),
        "lowest": min(ratios),
        "highest": max(ratios),
        "triad_gb_s_one": moved / triad_one,
        "triad_gb_s_two": moved / triad_two,
        "triad_speedup": triad_one / triad_two,
    }


def require_same(halves, steps, pool):
    """Raise ArithmeticError unless both halves end, at once and one after the other, in the same state bit by bit."""
    ends = [half.take(steps) for half in halves]
    for half in halves:
        half.begin()
    for alone, beside in zip(ends, pool.map(lambda half: half.take(steps), halves)):
        if not all(np.array_equal(getattr(alone, name), getattr(beside, name)) for name in ("q", "v", "a", "lam")):
            raise ArithmeticError("a run gives other results beside another")


def figures(rows):
    """{name: number} of the rows of this part."""
    return {
        key: value
        for row in rows
        for key, value in (("threads_speedup_1e5", row["speedup"]), ("triad_threads_speedup", row["triad_speedup"]))
    }


def notes(rows):
    """What was measured, and what the memory would allow."""
    return [
        f"{row['n']} coordinates in two threads that share nothing, half the plates' cells each: {row['two_threads_ms']:.3g} ms a step, by "
        f"turns in one {row['one_thread_ms']:.3g} ms, {row['speedup']:.2f} times as fast ({row['lowest']:.2f} to {row['highest']:.2f}), bit by "
        f"bit the same; the memory gives {row['triad_gb_s_one']:.3g} GB/s to one thread and {row['triad_gb_s_two']:.3g} to two, "
        f"{row['triad_speedup']:.2f} times; the factor is {row['factor_mb']:.3g} MB, a step streams it twice a solve"
        for row in rows
    ]
