"""The compiled driver of Radau IIA: stretches of equal or error-controlled steps of any model, with factors stored for several steps h."""

from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, NOT_FINITE, RAISED, WRONG_SHAPE
from polyida.integrate.radau import step
from polyida.jit import entry, pack, part, shared
from polyida.jit.intrinsics import address, call
from polyida.linear.dense import copy_matrix, put
from polyida.linear.lu import FACTORS as SLOTS
from polyida.system import MATRICES, PREPARE, SELECT

NEVER = 1e9  # LEAST of a factor that has solved no step; finite, since files need finite numbers
MADE = 16  # most factors that the driver makes in a stretch
FAILURES = 20.0  # most failed attempts in a row
MIN_STEP = 16.0  # least step over the distance of neighbouring floating point times
SHARE = 0.05  # Newton's tolerance over the local error, with fixed steps times the relative error to the power ERROR_POWER
ERROR_POWER = 0.6  # because the true error of a step is far below the local error
EXACT = 1e-15  # of the model's length: Newton's tolerance in the first fixed step
NOTHING = 1e-20  # of the model's length: least tolerance of Newton's method
ROUND_OFF = 2.0**-53  # of v, which is e over h
# further statuses of a stretch: requests to the caller, and failures
MAKE, RESTORE, PAUSE, STEP_TOO_SHORT, TOO_MANY_STEPS = range(100, 105)
H, PRICE, LEAST, USED, READY = range(5)  # rows of FactorSlots.table
LEVEL, TIME, FAILED, STEP, TARGET, REMAINING = range(6)  # of Control.now
REJECTED = 4  # of the counts, after those of step.py
COUNTS = 5
# adaptive steps are `first` 2^(k/2), k any whole number, so that steps recur and their factors are used again
SAFETY = 0.65
LEVELS_PER_DOUBLING = 2.0
MOST_UP, MOST_DOWN = 6.0, 12.0  # largest change in levels
CUT = 4.0  # levels down after a failed step


@pack
class Control(NamedTuple):
    """Settings and state of the step size controller.

    adaptive: True if steps follow the local error; h: the step of equal steps; first: the step at level 0; most, end: the largest step and the
    end of the piece; most_steps: limit of the number of steps, rejected ones included. now: LEVEL of the step size; TIME reached; FAILED,
    attempts since the last accepted step; STEP and TARGET, length and end of the last attempt; REMAINING, steps until the limit.
    """

    adaptive: bool
    h: float
    first: float
    most: float
    end: float
    most_steps: float
    now: np.ndarray


@pack
class FactorSlots(NamedTuple):
    """Factors of the few steps h that were used last, for adaptive steps that return to them.

    table (5, slots): H, the step, 0 if the slot is free; PRICE, iterations beyond LEAST so far; LEAST, the fewest iterations of one step; USED,
    number of the last use; READY, 1 if the factor exists. states (slots, 1 + 3 n + m): t, q, v, a and lam at which the factor was made.
    """

    table: np.ndarray
    states: np.ndarray


@pack
class Record(NamedTuple):
    """Results of the steps of a stretch, each array (steps, ...): states, stages, and what Memory and Control hold after each step.

    made (MADE, .): number of the step for which the driver made a factor, its slot, and the state as in FactorSlots; infinite without one.
    """

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
    phi_start: np.ndarray
    marks: np.ndarray
    level: np.ndarray
    slots: np.ndarray
    counts: np.ndarray
    made: np.ndarray


def record(count, stages, n, m, tied):
    """An empty Record of `count` steps."""
    motion = (count,), (count, n), (count, n), (count, n), (count, m)
    each, closing = (count, stages, n), (count, stages, m)
    inner = each, each, each, closing, each, closing, (count, stages, m if tied else 0), (count, 2, m)
    sizes = (*motion, *inner, (count, step.MARKS), (count,), (count, 4, SLOTS), (count, COUNTS))
    return Record(*map(np.empty, sizes), np.full((MADE, 3 + 3 * n + m), np.inf))


@part
def step_of_level(first, level):
    """The step of a level, s: first 2^(level/2)."""
    return first * 2.0 ** (level / LEVELS_PER_DOUBLING)


@part
def next_level(level, error, order):
    """The level at which the predicted error meets the tolerance. error: relative to the tolerance; order: its order in h.

    A rejected step (error > 1) goes down by at least one level.
    """
    levels = -MOST_DOWN
    if np.isfinite(error):
        levels = np.floor(LEVELS_PER_DOUBLING * np.log2(SAFETY * max(error, 1e-12) ** (-1.0 / order)))
    return level + (min(max(levels, 0.0), MOST_UP) if error <= 1.0 else min(max(levels, -MOST_DOWN), -1.0))


@part
def level_within(first, level, most):
    """The level, or if its step exceeds `most` the highest level whose step does not."""
    if step_of_level(first, level) > most * (1.0 + 1e-9):
        return np.floor(LEVELS_PER_DOUBLING * np.log2(most / first) + 1e-9)
    return level


@part
def next_step(t, end, h, last):
    """(step, its end). The last two steps before `end` are equal.

    A step that equals h or the last one up to round-off of t gets exactly that length, so that its factor is found.
    """
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
def cut(first, level, h):
    """The level after a failed step of h."""
    return level_within(first, level, h) - CUT


@part
def slot_of_step(slots, h):
    """The slot of a step h, or -1."""
    for slot in range(SLOTS):
        if slots.table[H, slot] == h:
            return slot
    return -1


@part
def mark_used(slots, slot, marks):
    """Mark a slot as the one used last. Newton's contraction was measured with the factor used before, so it is unknown for another one."""
    most = 0.0
    for other in range(SLOTS):
        most = max(most, slots.table[USED, other])
    if slots.table[USED, slot] < most or most == 0.0:
        slots.table[USED, slot] = most + 1.0
        marks[step.CONTRACTION], marks[step.AGE] = step.UNKNOWN[0], step.UNKNOWN[1]


@entry
def reserve_slot(slots, h, t, y):
    """The slot for a new factor of step h at the state of y: the slot of this h, a free one, or the one not used for the longest time."""
    slot = slot_of_step(slots, h)
    if slot < 0:
        slot = 0
        for other in range(SLOTS):
            if slots.table[USED, other] < slots.table[USED, slot]:
                slot = other
    n = y.past.shape[1]
    slots.table[H, slot], slots.table[PRICE, slot], slots.table[LEAST, slot], slots.table[READY, slot] = h, 0.0, NEVER, 1.0
    mark_used(slots, slot, y.marks)
    state = slots.states[slot]
    state[0] = t
    put(1.0, y.past[step.Q], state[1:])
    put(1.0, y.past[step.V], state[1 + n :])
    put(1.0, y.past[step.A], state[1 + 2 * n :])
    put(1.0, y.lam, state[1 + 3 * n :])
    y.marks[step.CONTRACTION], y.marks[step.AGE] = step.UNKNOWN[0], step.UNKNOWN[1]
    return slot


@part
def clamp(p, t):
    """t limited to [p.low, p.high]."""
    return min(max(t, p.low), p.high)


@part
def allowed_error(p, y):
    """atol + rtol |q| at the state of y."""
    return p.atol + p.rtol * np.sqrt(step.mean_square(y.past[step.PLACES], y.past[step.Q]))


@part
def newton_tolerance(p, h, y):
    """Newton's tolerance, of q, in a step of h from the state of y."""
    if p.tolerance > 0.0:
        return p.tolerance
    if p.share > 0.0:
        return p.share * allowed_error(p, y)
    error = y.marks[step.ERROR]
    if error < 0.0:
        return EXACT * p.length
    round_off = max(NOTHING * p.length, ROUND_OFF * h * np.sqrt(step.mean_square(y.past[step.SHARES], y.past[step.V])))
    return max(round_off, SHARE * (error / p.length) ** ERROR_POWER * error)


@part
def selected(t, z):
    """The argument of SELECT."""
    return z.times[3 + t.c.shape[0] :]


@shared
def attempt(f, w, first, p, t, h, begin, target, slots, fresh, y, x, z, counts):
    """Try a step from the state of y: (status, local error). The stages are in x."""
    count, times, select = t.c.shape[0], z.times, selected(t, z)
    times[0], times[1], times[2] = h, begin, clamp(p, begin)
    for i in range(count):
        times[3 + i] = clamp(p, begin + t.c[i] * h) if i < count - 1 else clamp(p, target)
    for i in range(3):
        select[i] = t.values[i] / h
    if f[PREPARE]:
        ended = call(f[PREPARE], w, first, address(times), 0, 0, 0, 0, 0)
        if ended != DONE:
            return ended, 0.0
    slot = slot_of_step(slots, h)
    if slot < 0 or (slots.table[PRICE, slot] > p.renewal and not fresh):
        return MAKE, 0.0
    if slots.table[READY, slot] == 0.0:
        return RESTORE, 0.0
    mark_used(slots, slot, y.marks)
    if f[SELECT]:
        call(f[SELECT], w, slot, address(select), 0, 0, 0, 0, 0)
    ended, iterations = step.solve_stages(f, w, first, p, t, h, y, x, z, newton_tolerance(p, h, y), counts)
    if ended != DONE:
        if fresh or ended in (NOT_FINITE, RAISED, WRONG_SHAPE):
            return ended, 0.0
        slots.table[PRICE, slot] = NEVER
        return MAKE, 0.0
    slots.table[LEAST, slot] = min(slots.table[LEAST, slot], float(iterations))
    slots.table[PRICE, slot] += max(0.0, iterations - slots.table[LEAST, slot])
    ended, error = step.project_end(f, w, first, p, t, h, y, x, z), 0.0
    if ended == DONE and p.estimates_error:
        ended, error = step.local_error(f, w, first, p, t, h, y, x, z, counts)
    return ended, error


@part
def record_step(o, k, target, h, y, x, z, slots, level, counts):
    """Write step k to the record."""
    o.t[k], o.level[k] = target, level
    put(1.0, z.q, o.q[k])
    put(1.0, z.v, o.v[k])
    put(1.0, z.a, o.a[k])
    put(1.0, z.lam, o.lam[k])
    copy_matrix(x.e, o.e[k])
    copy_matrix(x.dv, o.dv[k])
    copy_matrix(x.a, o.stages_a[k])
    copy_matrix(x.lam, o.stages_lam[k])
    copy_matrix(x.mu, o.mu[k])
    copy_matrix(y.miss_e[0], o.miss_e[k])
    copy_matrix(y.miss_lam[0], o.miss_lam[k])
    copy_matrix(y.phi_start, o.phi_start[k])
    put(1.0, y.marks, o.marks[k])
    copy_matrix(slots.table[:READY], o.slots[k])
    put(1.0, counts, o.counts[k])


@entry
def stretch(f, w, first, p, t, c, slots, fresh, y, x, z, counts, ends, o):
    """Take steps until the record is full, a factor is missing, or a step fails: (number of steps, status). PAUSE: `made` is full.

    f, w: addresses of the table's functions and of the model's workspace; first: number of the instant at which the stretch begins; fresh: True
    if the factor of the first step was made for it; ends: the ends of equal steps.
    """
    most, apart, now, taken, made = o.t.shape[0], t.c.shape[0] + 1, c.now, 0, 0
    while taken < most and (not c.adaptive or now[TIME] < c.end):
        h, target, begin = c.h, now[TIME], now[TIME]
        if c.adaptive:
            now[LEVEL] = level_within(c.first, now[LEVEL], c.most)
            h = step_of_level(c.first, now[LEVEL])
            h, target = next_step(begin, c.end, h, y.marks[step.LAST] if y.marks[step.LAST] > 0.0 else h)
            if now[FAILED] > 0.0 and (h < MIN_STEP * (np.nextafter(abs(begin), np.inf) - abs(begin)) or now[FAILED] >= FAILURES):
                now[STEP] = h
                return taken, STEP_TOO_SHORT
            if taken + counts[REJECTED] >= now[REMAINING]:
                now[STEP] = h
                return taken, TOO_MANY_STEPS
        else:
            target = ends[taken]
        now[STEP], now[TARGET] = h, target
        at = first if f[PREPARE] else first + taken * apart
        ended, error = attempt(f, w, at, p, t, h, begin, target, slots, fresh, y, x, z, counts)
        if ended == MAKE and f[MATRICES] and made < MADE:
            slot = reserve_slot(slots, h, clamp(p, begin), y)
            o.made[made, 0], o.made[made, 1] = taken, slot
            put(1.0, slots.states[slot], o.made[made, 2:])
            made += 1
            ended, counts[step.FACTORS] = make_factors(f, w, at, t, y, z, slot), counts[step.FACTORS] + 1
            fresh = ended == DONE  # a constant True would be another type, and `attempt` be compiled again
            if fresh:
                ended, error = attempt(f, w, at, p, t, h, begin, target, slots, fresh, y, x, z, counts)
            else:
                slots.table[H, slot] = slots.table[USED, slot] = 0.0
        if ended == MAKE and f[MATRICES]:
            return taken, PAUSE
        allowed = allowed_error(p, y) if c.adaptive else np.inf
        good = ended != DONE or error <= allowed
        if ended == DONE and good:
            ended = step.end_state(f, w, at, h, y, x, z)
        if ended != DONE:
            return taken, ended
        if c.adaptive and (not good or h >= step_of_level(c.first, now[LEVEL]) * (1.0 - 1e-9)):
            now[LEVEL] = next_level(level_within(c.first, now[LEVEL], h), error / allowed, t.c.shape[0] + 1.0)
        if not good:
            counts[REJECTED] += 1
            now[FAILED] += 1.0
            fresh = False
            continue
        step.advance(h, error, y, x, z)
        fresh, now[TIME], now[FAILED] = False, target, 0.0
        record_step(o, taken, target, h, y, x, z, slots, now[LEVEL], counts)
        taken += 1
    return taken, DONE


@part
def make_factors(f, w, at, t, y, z, slot):
    """Make the factors of a slot at the state of y, for the step of the last attempt. Returns a status."""
    state = address(y.past[step.Q]), address(y.past[step.V]), address(y.past[step.A]), address(y.lam)
    return call(f[MATRICES], w, at, state[0], state[1], state[2], state[3], slot, address(selected(t, z)))
