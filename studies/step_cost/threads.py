"""Speed-up of a step of generalized-alpha by a second thread, compared with the memory bandwidth of two threads and with two independent
halves of a model.

A step reads the factor twice for each solve. Two models of half the size, which share nothing, are the upper bound of a step in two
threads. All results are equal bit by bit.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from polyida.environment import threads
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.start import consistent_state
from polyida.integrate.state import Counts
from polyida.jit import entry
from polyida.linear.dissection import symbolic_of
from polyida.problems import plates
from step_cost.measure import H, cells_for

MANY = 64 * 2**20  # bytes of an array that no cache holds
THREADS = 2


@entry
def _triad(a, b, c):
    for i in range(a.shape[0]):
        a[i] = b[i] + 0.5 * c[i]


class Run:
    """A run of generalized-alpha on the double plate in `count` threads, taken some steps at a time; a factor is made."""

    def __init__(self, dof, count=1):
        self.model = plates.double_plate(cells_for(dof)).build()
        before = threads()
        threads(count)
        self.states = GeneralizedAlpha(h=H).steps(self.model, consistent_state(self.model), 1e5 * H, Counts())
        self.advance(2)
        threads(before)

    def advance(self, steps):
        """The state after so many more steps."""
        for _ in range(steps):
            state = next(self.states)
        return state


def wall(call):
    """Wall seconds of a call."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def threads_row(dof, steps, repeats):
    """Steps and triads in one thread and in two: medians of wall times measured in turn, and of the ratios of a turn.

    triad: a = b + c/2 on arrays that no cache holds, 24 bytes a number. Raises ArithmeticError if results differ by the threads.
    """
    one, two, halves = Run(dof), Run(dof, THREADS), [Run(dof // THREADS) for _ in range(THREADS)]
    require_same(one.advance(steps), two.advance(steps))
    with ThreadPoolExecutor(THREADS) as pool:
        require_same(*pool.map(lambda half: half.advance(steps), halves))
        triads = [partial(_triad, *np.ones((3, MANY // 8))) for _ in range(THREADS)]
        measured = {
            "one_thread": lambda: one.advance(steps),
            "two_threads": lambda: two.advance(steps),
            "halves_by_turns": lambda: [half.advance(1) for _ in range(steps) for half in halves],
            "halves_at_once": lambda: list(pool.map(lambda half: half.advance(steps), halves)),
            "triad_one": lambda: [triad() for triad in triads],
            "triad_two": lambda: list(pool.map(lambda triad: triad(), triads)),
        }
        times = np.array([[wall(call) for call in measured.values()] for _ in range(repeats)])
    result = dict(zip(measured, np.median(times, axis=0).tolist()))
    ratios = times[:, ::2] / times[:, 1::2]
    speedup, limit, triad = np.median(ratios, axis=0).tolist()
    return {
        "n": one.model.n,
        "factor_mb": 4e-6 * int(one.model.once(symbolic_of).panel[-1]),
        "speedup": speedup,
        "lowest": float(ratios[:, 0].min()),
        "highest": float(ratios[:, 0].max()),
        "limit": limit,
        "triad_speedup": triad,
        **{f"{name}_ms": 1e3 * result[name] / steps for name in list(measured)[:4]},
        **{f"{name}_gb_s": THREADS * 3e-9 * MANY / result[name] for name in list(measured)[4:]},
    }


def require_same(first, second):
    """Raise ArithmeticError unless two states are the same bit by bit."""
    if not all(np.array_equal(getattr(first, name), getattr(second, name)) for name in ("q", "v", "a", "lam")):
        raise ArithmeticError("the number of threads changes the results")


def figures(rows):
    """{name: number} of the rows of this part."""
    names = {"threads_speedup_1e5": "speedup", "threads_limit_1e5": "limit", "triad_threads_speedup": "triad_speedup"}
    return {name: row[key] for row in rows for name, key in names.items()}


def notes(rows):
    """The measurements, and the upper bound by the memory."""
    return [
        f"{row['n']} coordinates, wall time of a step: {row['one_thread_ms']:.3g} ms in one thread, {row['two_threads_ms']:.3g} ms in two, which "
        f"share the solves, {row['speedup']:.2f} times as fast ({row['lowest']:.2f} to {row['highest']:.2f}), bit by bit the same. Two "
        f"halves that share nothing: {row['halves_by_turns_ms']:.3g} ms by turns, {row['halves_at_once_ms']:.3g} ms at once, {row['limit']:.2f} times. "
        f"The memory gives {row['triad_one_gb_s']:.3g} GB/s to one thread and {row['triad_two_gb_s']:.3g} to two, {row['triad_speedup']:.2f} times; "
        f"the factor is {row['factor_mb']:.3g} MB, streamed twice a solve"
        for row in rows
    ]
