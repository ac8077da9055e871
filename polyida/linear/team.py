"""The solve with a multifrontal factor in several threads: subtrees of the dissection in parallel, the fronts above them in one thread.

Thread k has the fronts cuts[k]:cuts[k + 1] without those on the path from a cut to the root, `top`. Its contributions to `top` are stored in
`late`, and thread 0 adds them in the order of the fronts: every sum has the order of a single thread, so the result is the same bit by bit
for any number of threads (with POLYIDA_PLAIN_NUMBA=1: to round-off). Threads wait actively, because a solve takes less than a
thousandth of a second; after SPINS looks they let others have the core, so that busy machines are not slowed down by threads that wait.
"""

from contextlib import contextmanager
from functools import partial
from threading import Thread
from typing import NamedTuple

import numpy as np

from polyida import jit
from polyida.jit import bound, pack
from polyida.jit.intrinsics import leave, seen, yield_core
from polyida.linear.fronts import ascend, descend, spread

entry = partial(jit.entry, fastmath=jit.FAST)
part = partial(jit.part, fastmath=jit.FAST)
LINE = 8  # numbers of a cache line: each signal has its own
CALLED, DONE, GONE = 0, LINE, -1
SPINS = 10_000  # some 10 us


@pack
class Team(NamedTuple):
    """cuts (k + 1,); top (fronts,); shared (nodes,): places of top; late (k, most); signals (2 LINE k,): counts of calls and of completed calls of each thread."""

    cuts: np.ndarray
    top: np.ndarray
    shared: np.ndarray
    late: np.ndarray
    signals: np.ndarray


def team(s, count, dtype):
    """The Team of `count` threads for fronts s."""
    cuts, above = _cuts(s, count)
    top, shared = np.zeros(len(s.children), np.int8), np.zeros(len(s.nodes), np.int8)
    top[above] = 1
    for f in above:
        shared[s.first[f] : s.first[f + 1]] = 1
    handed = np.add.reduceat(np.append(shared[s.rows], 0), s.start[:-1]) * (np.diff(s.start) > 0) * (1 - top)
    most = max(int(handed[low:high].sum()) for low, high in zip(cuts[:-1], cuts[1:]))
    return Team(cuts, top, shared, np.zeros((count, 2 * most), dtype), np.zeros(2 * LINE * count, np.int64))


def _cuts(s, count):
    """(cuts, fronts on the paths from them to the root): nearly equal parts of the panels, with few fronts above."""
    parent, waiting, work = np.full(len(s.children), -1), [], np.diff(s.panel).astype(float)
    for f, n_children in enumerate(s.children):
        parent[waiting[len(waiting) - n_children :]] = f
        waiting[len(waiting) - n_children :] = [f]
    way = np.zeros(len(parent))
    for f in range(len(parent) - 1, -1, -1):
        way[f] = way[parent[f]] + work[parent[f]] if parent[f] >= 0 else 0.0
    before, above = np.cumsum(work), set()
    cuts = [0, *(1 + int(np.argmin(np.abs(before - before[-1] * k / count) + way)) for k in range(1, count)), len(parent)]
    for f in (cut - 1 for cut in cuts[1:-1]):
        while parent[f] >= 0:
            f = parent[f]
            above.add(int(f))
    return np.array(cuts), sorted(above)


@part
def after(signals, at, number):
    """Wait until signals[at] is no longer `number`. Returns it."""
    spins = 0
    while seen(signals, at) == number:
        spins += 1
        if spins > SPINS:
            yield_core()
    return seen(signals, at)


@entry
def serve(fronts, panels, vector, team, who):
    """The loop of thread `who`: it waits for calls, until GONE."""
    work, calls = np.empty(fronts.size, vector.dtype), 0
    while True:
        calls = after(team.signals, 2 * LINE * who + CALLED, calls)
        if calls == GONE:
            return
        if calls % 2:
            gather(fronts, panels, vector, team, who, work)
        else:
            scatter(fronts, panels, vector, team, who, work)
        leave(team.signals, 2 * LINE * who + DONE, calls)


@part
def gather(fronts, panels, vector, team, who, work):
    """The forward half of `vector <- S^-1 vector`, in place, on the fronts of thread `who` that are not at the top; work: scratch.

    Contributions to nodes of the top are overwritten in team.late[who]; thread 0 adds its own to vector at once.
    """
    late, at = team.late[who], 0
    for f in range(team.cuts[who], team.cuts[who + 1]):
        if team.top[f]:
            continue
        going = descend(fronts, panels, vector, work, f)
        if who == 0:
            if going:
                spread(fronts, vector, work, f)
            continue
        own = 2 * (fronts.first[f + 1] - fronts.first[f])
        for k in range(fronts.start[f], fronts.start[f + 1]):
            i, q = 2 * fronts.rows[k], own + 2 * (k - fronts.start[f])
            if team.shared[fronts.rows[k]]:
                late[at] = late[at + 1] = 0.0
                if going:
                    late[at], late[at + 1] = work[q], work[q + 1]
                at += 2
            elif going:
                vector[i] += work[q]
                vector[i + 1] += work[q + 1]


@part
def scatter(fronts, panels, vector, team, who, work):
    """The backward half of `vector <- S^-1 vector`, in place, on the fronts of thread `who` that are not at the top; work: scratch."""
    for f in range(team.cuts[who + 1] - 1, team.cuts[who] - 1, -1):
        if not team.top[f]:
            ascend(fronts, panels, vector, work, f)


@part
def call(team):
    """Call all other threads from thread 0. Returns the number of calls so far."""
    calls = seen(team.signals, DONE) + 1
    leave(team.signals, DONE, calls)
    for who in range(1, team.late.shape[0]):
        leave(team.signals, 2 * LINE * who + CALLED, calls)
    return calls


@part
def await_all(team, calls):
    """Wait until all threads have completed the call."""
    for who in range(1, team.late.shape[0]):
        after(team.signals, 2 * LINE * who + DONE, calls - 1)


@part
def solve_together(fronts, panels, vector, team):
    """vector <- S^-1 vector, as `solve_fronts` does, with others that `serve`."""
    work = np.empty(fronts.size, vector.dtype)
    calls = call(team)
    gather(fronts, panels, vector, team, 0, work)
    await_all(team, calls)
    for who in range(1, team.late.shape[0]):
        late, at = team.late[who], 0
        for f in range(team.cuts[who], team.cuts[who + 1]):
            if team.top[f]:
                if descend(fronts, panels, vector, work, f):
                    spread(fronts, vector, work, f)
                continue
            for k in range(fronts.start[f], fronts.start[f + 1]):
                if team.shared[fronts.rows[k]]:
                    i = 2 * fronts.rows[k]
                    vector[i] += late[at]
                    vector[i + 1] += late[at + 1]
                    at += 2
    for f in range(fronts.children.shape[0] - 1, team.cuts[1] - 1, -1):
        if team.top[f]:
            ascend(fronts, panels, vector, work, f)
    calls = call(team)
    scatter(fronts, panels, vector, team, 0, work)
    await_all(team, calls)


@contextmanager
def at_work(t, factor, x, workspace=None):
    """Context in which the other threads take part in solves of x with the factor; gives `workspace`."""
    t.signals[:] = 0
    args = factor.fronts, factor.panels, x, t
    serving = bound(serve, *args, 1)
    others = [Thread(target=serving, args=(*args, who), daemon=True) for who in range(1, len(t.late))]
    started = []
    try:
        for other in others:
            other.start()
            started.append(other)
        yield workspace
    finally:
        t.signals[CALLED :: 2 * LINE] = GONE
        for other in started:
            other.join()


class Helpers:
    """`count` threads with this one; factors on the same fronts share a Team."""

    def __init__(self, count):
        """Take the number of threads, this one included; they start with the work."""
        self.count, self.team = count, None

    def at_work(self, factor, workspace):
        """Context in which threads share solves with the factor; gives the workspace of the solves."""
        self.team = self.team or team(factor.fronts, self.count, factor.panels.dtype)
        return at_work(self.team, factor, workspace.x, workspace._replace(team=self.team))
