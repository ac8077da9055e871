"""The compiled driver of Radau IIA: stretches of equal or error-controlled steps of any model, with factors stored for several steps h.

`take_steps` repeats: the length of the next step (`next_step`, with step control), an `attempt` of it, a new factor and another attempt if
the stored one is missing or slow, the next level by the local error, and the record of an accepted step.
"""

from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, NOT_FINITE, RAISED, WRONG_SHAPE
from polyida.integrate.radau import step, step_end
from polyida.integrate.radau.step_arrays import AGE, CONTRACTION, ERROR, FACTORS, LAST, MARKS, UNKNOWN
from polyida.jit import entry, pack, part, shared
from polyida.linear.dense import copy_matrix, put
from polyida.linear.lu import FACTORS as SLOTS
from polyida.system import MATRICES, PREPARE
from polyida.system import instant as ask

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
H, EXTRA, LEAST, USED, READY = range(5)  # rows of FactorSlots.table
LEVEL, TIME, FAILED, STEP, TARGET, REMAINING = range(6)  # of Control.now
REJECTED = 4  # of the counts, after those of step_arrays.py
COUNTS = 5
# adaptive steps are `first` 2^(k/2), k any whole number, so that steps recur and their factors are used again
SAFETY = 0.65
LEVELS_PER_DOUBLING = 2.0
MOST_UP, MOST_DOWN = 6.0, 12.0  # largest change in levels
CUT = 4.0  # levels down after a failed step


@pack
class Control(NamedTuple):
    """Settings and state of the step size controller."""

    adaptive: bool  # True if steps follow the local error
    h: float  # s: of equal steps
    first: float  # s: the step at level 0
    most: float  # s: the largest step
    end: float  # s: the end of the piece
    most_steps: float  # limit of the number of steps, rejected ones included
    now: np.ndarray  # (6,) LEVEL of the step; TIME reached; FAILED attempts since the last step; STEP, TARGET: length, end of the attempt; REMAINING steps


@pack
class FactorSlots(NamedTuple):
    """Factors of the few steps h that were used last, for adaptive steps that return to them.

    Rows of the table: H, the step, 0 if the slot is free; EXTRA, iterations beyond LEAST so far; LEAST, the fewest iterations of one step; USED,
    number of the last use; READY, 1 if the factor exists.
    """

    table: np.ndarray  # (5, slots)
    states: np.ndarray  # (slots, 1 + 3 n + m) t, q, v, a and lam at which the factors were made


@pack
class Record(NamedTuple):
    """Results of the steps of a stretch: states, stages, and what Memory and Control hold after each step."""

    t: np.ndarray  # (steps,) with equal steps, their ends when the stretch begins
    q: np.ndarray  # (steps, n) q, v, a at the ends
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray  # (steps, m)
    e: np.ndarray  # (steps, s, n) e, v - v_0 and v' of the stages
    dv: np.ndarray
    stages_a: np.ndarray
    stages_lam: np.ndarray  # (steps, s, m)
    miss_e: np.ndarray  # (steps, s, n) the newest prediction errors, as miss_lam and mu
    miss_lam: np.ndarray  # (steps, s, m)
    mu: np.ndarray  # (steps, s, m), or (steps, s, 0) without mu
    phi_start: np.ndarray  # (steps, 2, m)
    marks: np.ndarray  # (steps, MARKS)
    level: np.ndarray  # (steps,) of the step size
    slots: np.ndarray  # (steps, 4, slots) of FactorSlots.table, without READY
    counts: np.ndarray  # (steps, COUNTS)
    made: np.ndarray  # (MADE, 3 + 3 n + m) number of the step for which a factor was made, its slot, and its state; infinite without one


def record(count, stages, n, m, tied):
    """An empty Record of `count` steps."""
    motion = (count,), (count, n), (count, n), (count, n), (count, m)
    each, closing = (count, stages, n), (count, stages, m)
    inner = each, each, each, closing, each, closing, (count, stages, m if tied else 0), (count, 2, m)
    sizes = (*motion, *inner, (count, MARKS), (count,), (count, 4, SLOTS), (count, COUNTS))
    return Record(*map(np.empty, sizes), np.full((MADE, 3 + 3 * n + m), np.inf))


@part
def step_of_level(first, level):
    """The step of a level, s: `first 2^(level/2)`, with first the step of level 0."""
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
    """`level`, or if its step exceeds the length `most`, s, the highest level whose step does not. first: step of level 0, s."""
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
    """The level after a failed step of length h: the highest of at most `level` whose step does not exceed h, less CUT levels.

    first: step of level 0.
    """
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
        marks[CONTRACTION], marks[AGE] = UNKNOWN[0], UNKNOWN[1]


@entry
def reserve_slot(slots, h, begin, memory):
    """The slot for a new factor of step h at the time `begin` and the state in `memory`.

    It is the slot of this h, a free one, or the one not used for the longest time.
    """
    slot = slot_of_step(slots, h)
    if slot < 0:
        slot = 0
        for other in range(SLOTS):
            if slots.table[USED, other] < slots.table[USED, slot]:
                slot = other
    n = memory.q.shape[0]
    slots.table[H, slot], slots.table[EXTRA, slot], slots.table[LEAST, slot], slots.table[READY, slot] = h, 0.0, NEVER, 1.0
    mark_used(slots, slot, memory.marks)
    state = slots.states[slot]
    state[0] = begin
    put(1.0, memory.q, state[1:])
    put(1.0, memory.v, state[1 + n :])
    put(1.0, memory.a, state[1 + 2 * n :])
    put(1.0, memory.lam, state[1 + 3 * n :])
    memory.marks[CONTRACTION], memory.marks[AGE] = UNKNOWN[0], UNKNOWN[1]
    return slot


@part
def clamp(method, time):
    """A time limited to [low, high]."""
    return min(max(time, method.low), method.high)


@part
def allowed_error(method, memory):
    """atol + rtol |q| at the state in `memory`."""
    return method.atol + method.rtol * np.sqrt(step.mean_square(memory.places, memory.q))


@part
def newton_tolerance(method, h, memory):
    """Newton's tolerance, of q, in a step of h from the state in `memory`."""
    if method.tolerance > 0.0:
        return method.tolerance
    if method.share > 0.0:
        return method.share * allowed_error(method, memory)
    error = memory.marks[ERROR]
    if error < 0.0:
        return EXACT * method.length
    round_off = max(NOTHING * method.length, ROUND_OFF * h * np.sqrt(step.mean_square(memory.shares, memory.v)))
    return max(round_off, SHARE * (error / method.length) ** ERROR_POWER * error)


@part
def selected(tableau, work):
    """The part of the workspace for c of the modes, as `ask.select` takes them."""
    return work.times[3 + tableau.c.shape[0] :]


@shared
def attempt(functions, workspace, first, method, arrays, now, fresh):
    """Try the step in `now`, of Control, from the state of `memory`: (status, local error). The stages are in `trial`.

    MAKE and RESTORE ask for a factor, a new one or the stored one of this h; fresh: True if the present one was made for this step.
    """
    model, tableau, slots, memory, work = (functions, workspace), arrays.tableau, arrays.slots, arrays.memory, arrays.work
    h, begin, target = now[STEP], now[TIME], now[TARGET]
    count, times, select = tableau.c.shape[0], work.times, selected(tableau, work)
    times[0], times[1], times[2] = h, begin, clamp(method, begin)
    for i in range(count):
        times[3 + i] = clamp(method, begin + tableau.c[i] * h) if i < count - 1 else clamp(method, target)
    for i in range(3):
        select[i] = tableau.values[i] / h
    if ask.provides(model, PREPARE):
        status = ask.prepare(model, first, times)
        if status != DONE:
            return status, 0.0
    slot = slot_of_step(slots, h)
    if slot < 0 or (slots.table[EXTRA, slot] > method.renewal and not fresh):
        return MAKE, 0.0
    if slots.table[READY, slot] == 0.0:
        return RESTORE, 0.0
    mark_used(slots, slot, memory.marks)
    ask.select(model, slot, select)
    allowed = newton_tolerance(method, h, memory)
    status, iterations = step.solve_stages(model, first, method, arrays, h, allowed)
    if status != DONE:
        if fresh or status in (NOT_FINITE, RAISED, WRONG_SHAPE):
            return status, 0.0
        slots.table[EXTRA, slot] = NEVER
        return MAKE, 0.0
    slots.table[LEAST, slot] = min(slots.table[LEAST, slot], float(iterations))
    slots.table[EXTRA, slot] += max(0.0, iterations - slots.table[LEAST, slot])
    status, error = step_end.project_end(model, first, method, arrays, h), 0.0
    if status == DONE and method.estimates_error:
        status, error = step_end.local_error(model, first, method, arrays, h)
    return status, error


@part
def record_step(log, number, target, level, arrays):
    """Write step `number`, with its end `target`, its level and the numbers in arrays, to row `number` of the Record log."""
    memory, trial, work = arrays.memory, arrays.trial, arrays.work
    log.t[number], log.level[number] = target, level
    put(1.0, work.q, log.q[number])
    put(1.0, work.v, log.v[number])
    put(1.0, work.a, log.a[number])
    put(1.0, work.lam, log.lam[number])
    copy_matrix(trial.e, log.e[number])
    copy_matrix(trial.dv, log.dv[number])
    copy_matrix(trial.a, log.stages_a[number])
    copy_matrix(trial.lam, log.stages_lam[number])
    copy_matrix(trial.mu, log.mu[number])
    copy_matrix(memory.miss_e[0], log.miss_e[number])
    copy_matrix(memory.miss_lam[0], log.miss_lam[number])
    copy_matrix(memory.phi_start, log.phi_start[number])
    put(1.0, memory.marks, log.marks[number])
    copy_matrix(arrays.slots.table[:READY], log.slots[number])
    put(1.0, arrays.counts, log.counts[number])


@part
def choose_step(control, memory, log, taken, counts):
    """Set STEP and TARGET, and LEVEL of adaptive steps, in control.now for the next attempt; return a status.

    It is DONE, or of adaptive steps STEP_TOO_SHORT or TOO_MANY_STEPS. Fixed steps have control.h and end at log.t[taken]. taken: steps of
    the stretch so far. memory: has the length of the last step. counts: of the stretch, with REJECTED.
    """
    now, begin = control.now, control.now[TIME]
    if not control.adaptive:
        now[STEP], now[TARGET] = control.h, log.t[taken]
        return DONE
    now[LEVEL] = level_within(control.first, now[LEVEL], control.most)
    h = step_of_level(control.first, now[LEVEL])
    h, now[TARGET] = next_step(begin, control.end, h, memory.marks[LAST] if memory.marks[LAST] > 0.0 else h)
    now[STEP] = h
    if now[FAILED] > 0.0 and (h < MIN_STEP * (np.nextafter(abs(begin), np.inf) - abs(begin)) or now[FAILED] >= FAILURES):
        return STEP_TOO_SHORT
    return TOO_MANY_STEPS if taken + counts[REJECTED] >= now[REMAINING] else DONE


@part
def new_factors(model, at, method, arrays, now, made, taken):
    """Make the factors of the attempted step, and write its number, the slot and the state to a row of Record.made. Returns a status."""
    slots, memory = arrays.slots, arrays.memory
    slot = reserve_slot(slots, now[STEP], clamp(method, now[TIME]), memory)
    made[0], made[1] = taken, slot
    put(1.0, slots.states[slot], made[2:])
    arrays.counts[FACTORS] += 1
    status = make_factors(model, at, arrays.tableau, memory, arrays.work, slot)
    if status != DONE:
        slots.table[H, slot] = slots.table[USED, slot] = 0.0
    return status


@entry
def take_steps(functions, workspace, first, method, arrays, control, fresh, log):
    """Take steps until the record is full, a factor is missing, or a step fails: (number of steps, status). PAUSE: `made` is full.

    functions, workspace: of the model's table (system/instant.py); first: number of the instant at which the stretch begins; fresh: True
    if the factor of the first step was made for it.
    """
    model, now = (functions, workspace), control.now
    memory, trial, work = arrays.memory, arrays.trial, arrays.work
    stages, taken, made = arrays.tableau.c.shape[0], 0, 0
    while taken < log.t.shape[0] and (not control.adaptive or now[TIME] < control.end):
        status = choose_step(control, memory, log, taken, arrays.counts)
        if status != DONE:
            return taken, status
        at = first if ask.provides(model, PREPARE) else first + taken * (stages + 1)
        status, error = attempt(functions, workspace, at, method, arrays, now, fresh)
        if status == MAKE and ask.provides(model, MATRICES) and made < MADE:
            status = new_factors(model, at, method, arrays, now, log.made[made], taken)
            made += 1
            fresh = status == DONE  # a constant True would be another type, and `attempt` be compiled again
            if fresh:
                status, error = attempt(functions, workspace, at, method, arrays, now, fresh)
        if status == MAKE and ask.provides(model, MATRICES):
            return taken, PAUSE
        h, allowed = now[STEP], allowed_error(method, memory) if control.adaptive else np.inf
        rejected = status == DONE and not error <= allowed  # so is one that is not a number
        if status == DONE and not rejected:
            status = step_end.end_state(model, at, h, memory, trial, work)
        if status != DONE:
            return taken, status
        if control.adaptive and (rejected or h >= step_of_level(control.first, now[LEVEL]) * (1.0 - 1e-9)):
            now[LEVEL] = next_level(level_within(control.first, now[LEVEL], h), error / allowed, stages + 1.0)
        if rejected:
            arrays.counts[REJECTED] += 1
            now[FAILED] += 1.0
            fresh = False
            continue
        step_end.advance(h, error, memory, trial, work)
        fresh, now[TIME], now[FAILED] = False, now[TARGET], 0.0
        record_step(log, taken, now[TARGET], now[LEVEL], arrays)
        taken += 1
    return taken, DONE


@part
def make_factors(model, at, tableau, memory, work, slot):
    """Make the model's factors in this slot, at instant `at` and the state q, v, a, lam in `memory`, for the step of the last attempt.

    Returns a status.
    """
    return ask.matrices(model, at, memory.q, memory.v, memory.a, memory.lam, slot, selected(tableau, work))
