"""The compiled loop of Radau IIA: stretches of steps of any model, equal ones or such that follow the local error, with the factors kept."""

from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, NOT_FINITE, RAISED, WRONG_SHAPE
from polyida.integrate.radau.step import (
    AGE,
    CONTRACTION,
    ERROR,
    LAST,
    MARKS,
    SHARES,
    UNKNOWN,
    A,
    Q,
    V,
    close,
    end,
    local_error,
    mean_square,
    take,
)
from polyida.integrate.radau.step import stages as solved
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import address, call
from polyida.linear.lu import KEPT as SLOTS
from polyida.system import MATRICES, PREPARE, SELECT

NEVER = 1e9  # iterations, the least a step of factors that solved none: files take finite numbers only
FAILURES = 20.0  # in a row
SHORT = 16.0  # times that a step is apart, at least
SHARE = 0.05  # of the local error that Newton may leave, times the relative error to the power BELOW: a step's true error is far below
BELOW = 0.6
EXACT = 1e-15  # of the model's length: what it may leave in a fixed step that none went before, as good as nothing
NOTHING = 1e-20  # the same behind a step without any error
ROUND_OFF = 2.0**-53  # of v, which is e over h
MAKE, AGAIN, PAUSE, STUCK, MANY = range(100, 105)  # how a stretch may end besides: what the caller is to do, or to say
H, PRICE, LEAST, USED, READY = range(5)  # rows of Kept.table
RUNG, TIME, FAILED, STEP, GOES, LEFT = range(6)  # of Control.now
REJECTED = 4  # of the counts, beside those of step.py
COUNTS = 5
# the steps that follow the local error are `first` 2^(k/2), k any whole number, so that factors are kept and come back
SAFETY = 0.65
RUNGS = 2.0  # a factor of two
MOST_UP, MOST_DOWN = 6.0, 12.0  # rungs at once
CUT = 4.0  # rungs down where a step fails


@pack
class Control(NamedTuple):
    """What the steps of a stretch are held to.

    adaptive: whether they follow the local error; h: of equal steps; first: the step at rung 0; most, end: the largest step and the end of the
    piece; most_steps: as counts have them, with those rejected. now: the RUNG, the TIME reached, the attempts that FAILED since the last accepted
    step, STEP and the time it GOES to of the last attempt, and how many steps are LEFT.
    """

    adaptive: bool
    h: float
    first: float
    most: float
    end: float
    most_steps: float
    now: np.ndarray


@pack
class Kept(NamedTuple):
    """The factors of the few steps h that were used last: adaptive steps come back to them.

    table (5, slots): h, 0 of a free slot; price: iterations that they cost beyond their best ones, `least` a step; when they were used; whether
    they are there. made (slots, 1 + 3 n + m): t, q, v, a and lam of where they were made.
    """

    table: np.ndarray
    made: np.ndarray


@pack
class Record(NamedTuple):
    """What the steps of a stretch leave, each array (steps, ...)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    e: np.ndarray
    dv: np.ndarray
    stages_a: np.ndarray
    stages_lam: np.ndarray
    miss_e: np.ndarray
    miss_lam: np.ndarray
    mu: np.ndarray
    closed: np.ndarray
    marks: np.ndarray
    rung: np.ndarray
    kept: np.ndarray
    counts: np.ndarray


def record(count, stages, n, m, tied):
    """A Record of so many steps."""
    motion = (count,), (count, n), (count, n), (count, n), (count, m)
    each, closing = (count, stages, n), (count, stages, m)
    inner = each, each, each, closing, each, closing, (count, stages, m if tied else 0), (count, 2, m)
    return Record(*map(np.empty, (*motion, *inner, (count, MARKS), (count,), (count, 4, SLOTS), (count, COUNTS))))


def kept(n, m):
    """A Kept without factors."""
    return Kept(np.zeros((5, SLOTS)), np.zeros((SLOTS, 1 + 3 * n + m)))


@part
def length(first, rung):
    """The step, s."""
    return first * 2.0 ** (rung / RUNGS)


@part
def followed(rung, error, order):
    """Where the error, which is of that order in h, is expected to be allowed; down at least a rung where it is not."""
    rungs = -MOST_DOWN
    if np.isfinite(error):
        rungs = np.floor(RUNGS * np.log2(SAFETY * max(error, 1e-12) ** (-1.0 / order)))
    return rung + (min(max(rungs, 0.0), MOST_UP) if error <= 1.0 else min(max(rungs, -MOST_DOWN), -1.0))


@part
def below(first, rung, most):
    """Down to where the step is not above `most`."""
    if length(first, rung) > most * (1.0 + 1e-9):
        return np.floor(RUNGS * np.log2(most / first) + 1e-9)
    return rung


@part
def next_step(t, end, h, last):
    """(step, where it ends): the last two before the end are equal, and equal to one that there are factors for up to round-off of t."""
    rest = end - t
    if abs(rest - h) <= 1e-9 * h:
        return h, end
    known = min(h, last)
    if abs(rest - known) <= 1e-9 * known:
        return known, end
    if rest < h:
        return rest, end
    if rest < 2.0 * h * (1.0 - 1e-9):
        return 0.5 * rest, t + 0.5 * rest
    return h, t + h


@entry
def cut(first, rung, h):
    """The rung behind a step of h that failed."""
    return below(first, rung, h) - CUT


@part
def found(k, h):
    """The slot of a step, or -1."""
    for slot in range(SLOTS):
        if k.table[H, slot] == h:
            return slot
    return -1


@part
def use(k, slot):
    """Note that it is used now."""
    most = 0.0
    for other in range(SLOTS):
        most = max(most, k.table[USED, other])
    if k.table[USED, slot] < most or most == 0.0:
        k.table[USED, slot] = most + 1.0


@entry
def keep(k, h, t, y):
    """The slot for a factor of steps h made at the state of y: that of this h, a free one, or that not used for the longest time."""
    slot = found(k, h)
    if slot < 0:
        slot = 0
        for other in range(SLOTS):
            if k.table[USED, other] < k.table[USED, slot]:
                slot = other
    n = y.past.shape[1]
    k.table[H, slot], k.table[PRICE, slot], k.table[LEAST, slot], k.table[READY, slot] = h, 0.0, NEVER, 1.0
    use(k, slot)
    k.made[slot, 0] = t
    for i in range(n):
        k.made[slot, 1 + i], k.made[slot, 1 + n + i], k.made[slot, 1 + 2 * n + i] = y.past[Q, i], y.past[V, i], y.past[A, i]
    for e in range(y.lam.shape[0]):
        k.made[slot, 1 + 3 * n + e] = y.lam[e]
    y.marks[CONTRACTION], y.marks[AGE] = UNKNOWN[0], UNKNOWN[1]
    return slot


@part
def clamp(p, t):
    """t held to the limits."""
    return min(max(t, p.low), p.high)


@part
def allowed_error(p, y):
    """The local error that is allowed at the state of y."""
    return p.atol + p.rtol * np.sqrt(mean_square(y.past[SHARES], y.past[Q]))


@part
def left(p, h, y):
    """What Newton may leave of q in a step of h from there."""
    if p.tolerance > 0.0:
        return p.tolerance
    if p.share > 0.0:
        return p.share * allowed_error(p, y)
    error = y.marks[ERROR]
    if error < 0.0:
        return EXACT * p.length
    round_off = max(NOTHING * p.length, ROUND_OFF * h * np.sqrt(mean_square(y.past[SHARES], y.past[V])))
    return max(round_off, SHARE * (error / p.length) ** BELOW * error)


@part
def attempt(f, w, first, p, t, h, begin, goes, k, fresh, y, x, z, counts):
    """(how it ended, the local error) of a step from the state of y; the stages are in x, its end in z."""
    count, times = t.c.shape[0], z.times
    times[0], times[1], times[2] = h, begin, clamp(p, begin)
    for i in range(count):
        times[3 + i] = clamp(p, begin + t.c[i] * h) if i < count - 1 else clamp(p, goes)
    if f[PREPARE]:
        ended = call(f[PREPARE], w, first, address(times), 0, 0, 0, 0, 0)
        if ended != DONE:
            return ended, 0.0
    slot = found(k, h)
    if slot < 0 or (k.table[PRICE, slot] > p.renewal and not fresh):
        return MAKE, 0.0
    if k.table[READY, slot] == 0.0:
        return AGAIN, 0.0
    use(k, slot)
    select = times[3 + count :]
    for i in range(3):
        select[i] = t.values[i] / h
    if f[SELECT]:
        call(f[SELECT], w, slot, address(select), 0, 0, 0, 0, 0)
    ended, iterations = solved(f, w, first, p, t, h, y, x, z, left(p, h, y), counts)
    if ended != DONE:
        if fresh or ended in (NOT_FINITE, RAISED, WRONG_SHAPE):
            return ended, 0.0
        k.table[PRICE, slot] = NEVER
        return MAKE, 0.0
    k.table[LEAST, slot] = min(k.table[LEAST, slot], float(iterations))
    k.table[PRICE, slot] += max(0.0, iterations - k.table[LEAST, slot])
    ended, error = close(f, w, first, p, t, h, y, x, z), 0.0
    if ended == DONE and p.looks:
        ended, error = local_error(f, w, first, t, h, y, x, z, counts)
    return ended, error


@part
def write(o, k, goes, h, y, x, z, kept, rung, counts):
    """Note the step."""
    o.t[k], o.rung[k] = goes, rung
    for i in range(z.q.shape[0]):
        o.q[k, i], o.v[k, i], o.a[k, i] = z.q[i], z.v[i], z.a[i]
        for j in range(x.e.shape[0]):
            o.e[k, j, i], o.dv[k, j, i], o.stages_a[k, j, i], o.miss_e[k, j, i] = x.e[j, i], x.dv[j, i], x.a[j, i], y.miss_e[j, i]
    for e in range(z.lam.shape[0]):
        o.lam[k, e], o.closed[k, 0, e], o.closed[k, 1, e] = z.lam[e], y.closed[0, e], y.closed[1, e]
        for j in range(x.e.shape[0]):
            o.stages_lam[k, j, e], o.miss_lam[k, j, e] = x.lam[j, e], y.miss_lam[j, e]
    for j in range(y.mu.shape[0]):
        for e in range(y.mu.shape[1]):
            o.mu[k, j, e] = y.mu[j, e]
    for i in range(MARKS):
        o.marks[k, i] = y.marks[i]
    for i in range(4):
        for slot in range(SLOTS):
            o.kept[k, i, slot] = kept.table[i, slot]
    for i in range(COUNTS):
        o.counts[k, i] = counts[i]


@entry
def stretch(f, w, first, p, t, c, k, fresh, y, x, z, counts, ends, o):
    """Steps until the record is full, a factor is to be made, or one fails: (steps, how it ended).

    f, w: addresses of the table's functions and of the model's workspace; first: number of the instant where it begins; fresh: whether the
    factors of the first step were made for it; ends: where equal steps end.
    """
    most, apart, now, taken = o.t.shape[0], t.c.shape[0] + 1, c.now, 0
    while taken < most and (not c.adaptive or now[TIME] < c.end):
        h, goes, begin = c.h, now[TIME], now[TIME]
        if c.adaptive:
            now[RUNG] = below(c.first, now[RUNG], c.most)
            h = length(c.first, now[RUNG])
            h, goes = next_step(begin, c.end, h, y.marks[LAST] if y.marks[LAST] > 0.0 else h)
            if now[FAILED] > 0.0 and (h < SHORT * (np.nextafter(abs(begin), np.inf) - abs(begin)) or now[FAILED] >= FAILURES):
                now[STEP] = h
                return taken, STUCK
            if taken + counts[REJECTED] >= now[LEFT]:
                now[STEP] = h
                return taken, MANY
        else:
            goes = ends[taken]
        now[STEP], now[GOES] = h, goes
        at = first if f[PREPARE] else first + taken * apart
        ended, error = attempt(f, w, at, p, t, h, begin, goes, k, fresh, y, x, z, counts)
        if ended == MAKE and f[MATRICES] and taken == 0:
            slot = keep(k, h, clamp(p, begin), y)
            ended, counts[3] = made(f, w, at, y, slot), counts[3] + 1
            fresh = True
            if ended == DONE:
                ended, error = attempt(f, w, at, p, t, h, begin, goes, k, fresh, y, x, z, counts)
            else:
                k.table[H, slot] = k.table[USED, slot] = 0.0
        if ended == MAKE and f[MATRICES]:
            return taken, PAUSE
        allowed = allowed_error(p, y) if c.adaptive else np.inf
        good = ended != DONE or error <= allowed
        if ended == DONE and good:
            ended = end(f, w, at, h, y, x, z)
        if ended != DONE:
            return taken, ended
        if c.adaptive and (not good or h >= length(c.first, now[RUNG]) * (1.0 - 1e-9)):
            now[RUNG] = followed(below(c.first, now[RUNG], h), error / allowed, t.c.shape[0] + 1.0)
        if not good:
            counts[REJECTED] += 1
            now[FAILED] += 1.0
            fresh = False
            continue
        take(h, error, y, x, z)
        fresh, now[TIME], now[FAILED] = False, goes, 0.0
        write(o, taken, goes, h, y, x, z, k, now[RUNG], counts)
        taken += 1
    return taken, DONE


@part
def made(f, w, at, y, slot):
    """Make the factors at the state of y."""
    return call(f[MATRICES], w, at, address(y.past[Q]), address(y.past[V]), address(y.past[A]), address(y.lam), slot, 0)
