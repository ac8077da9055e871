"""Increments of phi of a scene in a step, from the increments of its profiles and of the places of its points."""

from typing import NamedTuple

import numpy as np

from polyida.assembly import joints
from polyida.jit import entry, pack, part
from polyida.profile import SAMPLES, SHAPES

# constants of compiled code
EPS = 2.0**-52
NODES, WEIGHTS = (0.5 * x for x in np.polynomial.legendre.leggauss(4))  # on [-1/2, 1/2]
AT, LATE = 0.5 + NODES, WEIGHTS * (0.5 - NODES)
SMALL = 1e-5  # of the numbers: a difference below it has lost digits
POLYNOMIAL, SINE, MOVE = range(3)


def drive_table(model, times, ends):
    """Values of each profile, and two derivatives of those that drive rows, at the times, (times, profiles, 3); else 0.

    ends: the first and the last time, or times beside them inside the steps at a kink: loads and all derivatives are one-sided. Values that
    drive phi are continuous.
    """
    table = np.zeros((len(times), len(model.profiles), 3))
    if not table.size:
        return table
    driving = _driving(model)
    inner = np.array(times)
    inner[[0, -1]] = ends
    for k, profile in enumerate(model.profiles):
        for order, at in enumerate((times, inner, inner) if driving[k] else (inner,)):
            table[:, k, order] = profile.over(at, order)
    return table


def _driving(model):
    """True for each profile that drives rows of phi."""
    driving = np.zeros(len(model.profiles), bool)
    driving[model.motor_profiles] = driving[model.path_profiles] = True
    return driving


def gain_table(model, times, drives, h):
    """Increments of each profile in each step of size h, (steps, profiles, 3): of value, of value - h rate, of rate.

    Differences. For profiles that drive phi the more accurate integrals of the second derivative, if both agree to round-off.
    """
    return _gains(model, times[:-1], times[1:], drives[:-1], drives[1:], np.full(len(times) - 1, h))


def stage_tables(model, starts, times, edge, h):
    """(drives (k, s + 1, profiles, 3) at the starts (k,) of steps and the times (k, s) of their stages, gains (k, s, profiles, 3) between).

    h (s,): times of the stages since the start of the step. edge: the first start, or a time beside it inside the step at a kink.
    """
    at = np.column_stack([starts, times])
    drives = drive_table(model, at.ravel(), (edge, at[-1, -1])).reshape(*at.shape, -1, 3)
    before, after = np.broadcast_to(drives[:, :1], drives[:, 1:].shape), drives[:, 1:]
    flat = (-1, *drives.shape[2:])
    gains = _gains(model, np.repeat(starts, len(h)), times.ravel(), before.reshape(flat), after.reshape(flat), np.tile(h, len(starts)))
    return drives, gains.reshape(after.shape)


def _gains(model, begin, times, before, after, h):
    """The changes of the driving profiles over steps, (steps, profiles, ...), to full accuracy relative to the change."""
    gains, lost = np.empty(before.shape), np.zeros(before.shape[:2], bool)
    if gains.size:
        driving = _driving(model)
        change_each(driving, h, times, before, after, gains, lost)
        for k in np.flatnonzero(driving):
            rows = np.flatnonzero(lost[:, k])
            if rows.size:
                second = model.profiles[k].over(begin[rows, None] + h[rows, None] * AT, 2)
                sharpen_each(k, rows, second, h, times, before, after, gains)
    return gains


@entry
def change_each(driving, h, times, before, after, gains, lost):
    """Gains by differences (steps, profiles, 3). lost: True if they may have lost digits."""
    for i in range(h.shape[0]):
        for k in range(driving.shape[0]):
            lost[i, k] = change(driving[k], h[i], times[i], before[i, k], after[i, k], gains[i, k])


@entry
def sharpen_each(profile, rows, second, h, times, before, after, gains):
    """`sharpen` the gains of a profile in some steps; second (rows, 4): its second derivatives."""
    for e in range(rows.shape[0]):
        i = rows[e]
        sharpen(h[i], times[i], before[i, profile], after[i, profile], second[e], gains[i, profile])


@part
def sizes(t, before, after):
    """Size of the numbers whose differences are the gains of value and rate."""
    return abs(before[0]) + abs(after[0]) + abs(t * after[1]), abs(before[1]) + abs(after[1]) + abs(t * after[2])


@part
def change(driving, h, t, before, after, gain):
    """Fill the gain of a profile in a step of h to t by differences. True if it drives phi and may have lost digits."""
    gain[0], gain[2] = after[0] - before[0], after[1] - before[1]
    gain[1] = gain[0] - h * before[1]
    value, rate = sizes(t, before, after)
    return driving and (abs(gain[0]) < SMALL * value or abs(gain[2]) < SMALL * rate)


@part
def sharpen(h, t, before, after, second, gain):
    """Replace the gain by integrals of the second derivative (4,), if both agree to round-off."""
    total = late = 0.0
    for i in range(4):
        total += second[i] * WEIGHTS[i]
        late += second[i] * LATE[i]
    rate, ahead = h * total, h * h * late
    whole, (size, size_of_rate) = h * before[1] + ahead, sizes(t, before, after)
    if abs(whole - gain[0]) <= 16 * EPS * size and abs(rate - gain[2]) <= 16 * EPS * size_of_rate:
        gain[0], gain[1], gain[2] = whole, ahead, rate


@pack
class Moves(NamedTuple):
    """The profiles of a scene as numbers, list after list. driving: as of `_driving`.

    POLYNOMIAL: coefficients. SINE: amplitudes of value and derivatives, angular frequency, phase. MOVE: first value, span, duration, start time,
    amplitudes of value and derivatives, coefficients.
    """

    kind: np.ndarray
    start: np.ndarray
    numbers: np.ndarray
    driving: np.ndarray


def moves(model):
    """(Moves of a scene, True if all of its profiles have a formula, not samples, and are in it)."""
    kinds, rows = [], []
    for profile in model.profiles:
        kind, *numbers = profile.formula or ("",)
        if kind == "sine":
            w = 2 * np.pi * numbers[1]
            numbers = [numbers[0], numbers[0] * w, -numbers[0] * w * w, w, numbers[2]]
        elif kind in SHAPES:
            begin, end, duration, start = numbers
            span = end - begin
            numbers = [begin, span, duration, start, span, span / duration, span / duration**2, *SHAPES[kind]]
        elif kind == SAMPLES:
            numbers = []
        kinds.append({"polynomial": POLYNOMIAL, "sine": SINE}.get(kind, MOVE))
        rows.append(np.array(numbers, float))
    start = np.cumsum([0, *map(len, rows)])
    return Moves(np.array(kinds, np.int64), start, np.concatenate([*rows, np.zeros(0)]), _driving(model)), all(map(len, rows))


@part
def profile_at(moves, profile, t, order):
    """Derivative of an order 0, 1 or 2 of a profile of Moves."""
    x = moves.numbers[moves.start[profile] : moves.start[profile + 1]]
    if moves.kind[profile] == SINE:
        angle = x[3] * t + x[4]
        return x[order] * (np.cos(angle) if order == 1 else np.sin(angle))
    if moves.kind[profile] == POLYNOMIAL:
        return series(x, order, t)
    s = (t - x[3]) / x[2]
    if not 0.0 < s < 1.0:
        return 0.0 if order else (x[1] if s >= 1.0 else 0.0) + x[0]
    return x[4 + order] * series(x[7:], order, s) + (0.0 if order else x[0])


@part
def series(coefficients, order, argument):
    """`c_0 + c_1 x + c_2 x^2 + ...` at the argument x, or its first or second derivative."""
    total = 0.0
    for k in range(coefficients.shape[0] - 1, order - 1, -1):
        factor = coefficients[k] if order == 0 else coefficients[k] * k if order == 1 else coefficients[k] * k * (k - 1)
        total = total * argument + factor
    return total


@part
def take_step(moves, h, begin, inner, times, nodes, drives, gains):
    """Fill drives (s + 1, profiles, 3) and gains, from row 1 on, of a step of h from `begin` with stages at `nodes` (s,) of it, at times (s,).

    inner: begin, or a time beside it inside the step at a kink.
    """
    second = np.empty(4)
    for k in range(moves.kind.shape[0]):
        for order in range(3):
            drives[0, k, order] = profile_at(moves, k, begin if order == 0 and moves.driving[k] else inner, order)
        for i in range(nodes.shape[0]):
            t, late, now, gain = times[i], nodes[i] * h, drives[i + 1, k], gains[i + 1, k]
            for order in range(3):
                now[order] = profile_at(moves, k, t, order)
            if change(moves.driving[k], late, t, drives[0, k], now, gain):
                for e in range(4):
                    second[e] = profile_at(moves, k, begin + late * AT[e], 2)
                sharpen(late, t, drives[0, k], now, second, gain)


class Increments:
    """Change of phi and rate = phi_q v + phi_t of a scene in one step of h from (q, v) at t0 to t1. ends: as of `drive_table`."""

    def __init__(self, model, t0, t1, ends, h, q, v):
        """A step from (q, v) at t0 to t1 = t0 + h. ends: t0 and t1, or times just within the step beside a kink."""
        times = np.array([t0, t1])
        drives = drive_table(model, times, ends)
        self.model, self.h, self.drives = model, h, drives[0]
        self.gain = gain_table(model, times, drives, h)[0]
        self.dz, self.vz = model.dz(q), model.dz(v)

    def __call__(self, dd, dv, phi, rate):
        """(phi, rate), (m,) each, at the end of the step, from those at its start; q changes by h v + dd and v by dv."""
        phi, rate = phi.copy(), rate.copy()
        points = np.stack([self.dz, self.vz, self.model.dz(dd), self.model.dz(dv)])
        joints.joint_change(self.model.arrays.links, self.drives, self.gain, self.h, points, phi, rate)
        return phi, rate
