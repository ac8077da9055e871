"""The compiled loop of the backward sweep: one step after the other on a stale factor, refined with the exact products."""

from functools import partial
from typing import NamedTuple

import numpy as np

from polyida.adjoint.scene import products
from polyida.adjoint.scene.corrections import correct, hold
from polyida.errors import DONE, REFACTOR, SINGULAR
from polyida.integrate.alpha.step import SLOW, nearest, pairs
from polyida.jit import entry, pack, part

fast = partial(part, fastmath={"contract", "reassoc", "nsz"})

Q, V, A, AHEAD = range(4)  # rows of what is sent
CONTRACTION, AGE, SOLVES, REACH, SEEN, SHARE = range(6)
MARKS = 7
FRESHEN = 30  # steps after which the contraction is measured again
WILD = 16.0  # shares of differences, from which on they tell nothing: w has grown out of what was nothing
SAMPLES = 300  # coordinates by which shares are found
ROUND_OFF = 1e-9  # of |w|: corrections that need no longer fall
NOTHING = 1e-14  # of what w would be without constraints: corrections of a w that these hold to zero


@pack
class Method(NamedTuple):
    """Numbers of the method at one h; enough: the error of w, over |w|, that is left; most: corrections of a step with one factor."""

    h: float
    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    to_a: float
    to_v: float
    enough: float
    most: int


@pack
class Frames(NamedTuple):
    """The steps' ends, (count, .), and the objective's slopes there, (0, .) where they are zero."""

    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    j_q: np.ndarray
    j_v: np.ndarray
    j_a: np.ndarray
    j_lam: np.ndarray


@pack
class Memory(NamedTuple):
    """What goes from step to step: sent (4, n) and marks.

    w (3, n), mu (3, m): those of the last step and their backward differences, of first and second order. SHARE: those of the
    differences in the prediction; SEEN: steps since there was nothing to predict from; REACH: the largest |w| yet that no
    constraint held.
    """

    sent: np.ndarray
    w: np.ndarray
    mu: np.ndarray
    marks: np.ndarray


@pack
class Trial(NamedTuple):
    """What a step works on: `now` (4, n), `rows` (3, m)."""

    now: np.ndarray
    rows: np.ndarray


@pack
class Found(NamedTuple):
    """What the steps leave: w (count, n), mu (count, m), and y and z (count, n), or (0, n) where they are not wanted."""

    w: np.ndarray
    mu: np.ndarray
    y: np.ndarray
    z: np.ndarray


W, RIGHT, R, DW = range(4)  # rows of Trial.now
MU, DMU, PHI = range(3)  # of Trial.rows


def empty(n, m):
    """(Memory, Trial)."""
    return Memory(np.zeros((4, n)), np.zeros((3, n)), np.zeros((3, m)), np.zeros(MARKS)), Trial(np.zeros((4, n)), np.zeros((3, m)))


def forget(memory):
    """Predict nothing from what was before."""
    memory.w[:], memory.mu[:], memory.marks[SEEN:] = 0.0, 0.0, 0.0


@fast
def begin(p, f, k, y, z):
    """The right-hand side of step k, and what is expected of w and mu."""
    right, sent, marks = z.now[RIGHT], y.sent, y.marks
    b = 1.0 / (p.beta * p.h * p.h)
    for i in range(right.shape[0]):
        right[i] = -sent[Q, i] - p.to_v * sent[V, i] - p.to_a * sent[A, i] - b * sent[AHEAD, i]
    add_slope(f.j_q, k, -1.0, right)
    add_slope(f.j_v, k, -p.to_v, right)
    add_slope(f.j_a, k, -p.to_a, right)
    ahead(marks[SHARE], marks[SHARE + 1], y.w, z.now[W])
    ahead(marks[SHARE], marks[SHARE + 1], y.mu, z.rows[MU])


@fast
def ahead(first, second, past, out):
    """What is expected next, of a value and its differences."""
    for i in range(out.shape[0]):
        out[i] = past[0, i] + first * past[1, i] + second * past[2, i]


@fast
def add_slope(j, k, factor, out):
    """out += factor j[k], unless j is (0, .)."""
    if j.shape[0]:
        for i in range(out.shape[0]):
            out[i] += factor * j[k, i]


@fast
def residual(p, f, k, x, z):
    """r = S^T w + B^T mu - right and phi = B w + j_lam."""
    r, right = pairs(z.now[R]), pairs(z.now[RIGHT])
    for i in range(r.shape[0]):
        for e in range(2):
            r[i, e] = x.stiff[i, e] + p.to_a * x.heavy[i, e] - right[i, e]
    if x.slowing.shape[0]:
        for i in range(r.shape[0]):
            for e in range(2):
                r[i, e] += p.to_v * x.slowing[i, e]
    for i in range(x.rows.shape[0]):
        z.rows[PHI, i] = x.rows[i]
    add_slope(f.j_lam, k, 1.0, z.rows[PHI])


@fast
def add_correction(z):
    """w += dw, mu += dmu; the sums of |dw| and |w|, whose squares may be too small for a number."""
    w, dw = z.now[W], z.now[DW]
    moved = size = 0.0
    for i in range(w.shape[0]):
        w[i] += dw[i]
        moved += abs(dw[i])
        size += abs(w[i])
    for i in range(z.rows.shape[1]):
        z.rows[MU, i] += z.rows[DMU, i]
    return moved, size


@fast
def send(p, f, k, x, y, z):
    """What the step sends to the frame before."""
    sent, stiff, slowing = y.sent, x.stiff.reshape(y.sent.shape[1]), x.slowing.reshape(2 * x.slowing.shape[0])
    add_slope(f.j_q, k, 1.0, sent[Q])
    add_slope(f.j_v, k, 1.0, sent[V])
    if slowing.shape[0]:
        for i in range(sent.shape[1]):
            sent[V, i] += slowing[i]
    h, ahead = p.h, 1.0 / (1.0 - p.alpha_m)
    for i in range(sent.shape[1]):
        b, c = -sent[Q, i] - stiff[i], -sent[V, i]
        a = (h * h * p.beta * b + h * p.gamma * c - sent[AHEAD, i]) * ahead
        sent[Q, i] = -b
        sent[V, i] = -c - h * b
        sent[A, i] = -p.alpha_f * a
        sent[AHEAD, i] = p.alpha_m * a - h * h * (0.5 - p.beta) * b - h * (1.0 - p.gamma) * c


@part
def learn(y, z):
    """Take up w and mu, and how the next ones are predicted."""
    y.marks[SEEN] += 1.0
    fit(y, z.now[W])
    shift(z.now[W], y.w)
    shift(z.rows[MU], y.mu)


@fast
def shift(now, past):
    """Take up one value more, with its backward differences."""
    for i in range(now.shape[0]):
        change = now[i] - past[0, i]
        past[0, i], past[1, i], past[2, i] = now[i], change, change - past[1, i]


@fast
def fit(y, w):
    """Shares of the differences that would have been nearest to what w has moved by; of those of steps that were not there 0."""
    aa = ab = bb = ad = bd = 0.0
    n, past = w.shape[0], y.w
    for i in range(0, n, n // SAMPLES | 1):
        first, second, d = past[1, i], past[2, i], w[i] - past[0, i]
        aa += first * first
        ab += first * second
        bb += second * second
        ad += first * d
        bd += second * d
    first, second = nearest(aa, ab, bb, ad, bd)
    if not abs(first) + abs(second) < WILD:
        first = second = 0.0
    seen = y.marks[SEEN]
    y.marks[SHARE] = first if seen > 3.0 else 1.0 if seen == 3.0 else 0.0
    y.marks[SHARE + 1] = second if seen > 3.0 else 0.0


@part
def refine(s, c, room, p, viscosity, laws, drives, f, k, x, y, z):
    """Solve step k: how it ended; x holds the products of its w."""
    u, v, w, dw, lam = pairs(f.q[k]), pairs(f.v[k]), pairs(z.now[W]), pairs(z.now[DW]), f.lam[k]
    begin(p, f, k, y, z)
    products.hold_state(s, laws, drives, u, v, lam, x)
    products.body_products(s, viscosity, u, v, w, x.rotation, x)
    hold(s.links, c, room, drives, p.to_a, p.to_v, x)
    last = 0.0
    for iteration in range(p.most):
        products.point_products(s.links, laws, room.slopes, w, z.rows[MU], x)
        residual(p, f, k, x, z)
        free = correct(s.links, c, room, pairs(z.now[R]), z.rows[PHI], dw, z.rows[DMU])
        if free < 0.0:
            return SINGULAR
        y.marks[REACH] = max(y.marks[REACH], free)
        y.marks[SOLVES] += 1.0
        moved, size = add_correction(z)
        products.body_products(s, viscosity, u, v, w, x.rotation[:0], x)
        small, hopeless = judge(p, y.marks, moved, size, last, iteration)
        if small:
            products.point_products(s.links, laws, room.slopes, w, z.rows[MU], x)
            return DONE
        if hopeless:
            return REFACTOR
        last = moved
    return REFACTOR


@part
def judge(p, marks, moved, size, last, iteration):
    """Whether what is left of a correction by `moved` after one by `last` is small enough, or round-off, and whether it will never be."""
    measured, rate = last > 0.0, marks[CONTRACTION]
    if measured:
        rate = moved / last
        marks[CONTRACTION], marks[AGE] = max(rate, (0.5 if iteration == 1 else 1.0) * marks[CONTRACTION]), 0.0
    slow = measured and not rate <= SLOW
    small = (measured or marks[AGE] < FRESHEN) and rate < 1.0 and moved * rate / (1.0 - rate) <= p.enough * size
    return small or (slow and moved <= ROUND_OFF * size) or moved <= NOTHING * marks[REACH], slow


@entry
def stretch(s, c, room, p, viscosity, laws, drives, f, last, x, y, z, out):
    """Steps backward from the one before `last`, into out: (the first step that is done, how the one before ended).

    viscosity (plates,): of a damped scene, or None; laws: of force elements, or None. What is None is not compiled.
    """
    for k in range(last - 1, -1, -1):
        ended = refine(s, c, room, p, viscosity, laws, drives[k], f, k, x, y, z)
        if ended != DONE:
            return k + 1, ended
        y.marks[AGE] += 1.0
        send(p, f, k, x, y, z)
        learn(y, z)
        keep(p, k, y, z, out)
    return 0, DONE


@fast
def keep(p, k, y, z, out):
    """Write what step k leaves."""
    for i in range(out.w.shape[1]):
        out.w[k, i] = z.now[W, i]
    for i in range(out.mu.shape[1]):
        out.mu[k, i] = z.rows[MU, i]
    if out.y.shape[0]:
        for i in range(out.y.shape[1]):
            out.y[k, i], out.z[k, i] = -y.sent[Q, i], p.h * y.sent[Q, i] - y.sent[V, i]
