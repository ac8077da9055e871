"""The compiled loop of the backward sweep: one step after the other on a stale factor, refined with the exact products."""

from functools import partial
from typing import NamedTuple

import numpy as np

from polyida.compiled import entry, pack, part
from polyida.gradient.scene import products
from polyida.gradient.scene.corrections import correct, hold
from polyida.integrate.alpha.step import FRESHEN, SLOW, pairs
from polyida.integrate.stepping.ended import DONE, REFACTOR, SINGULAR

fast = partial(part, fastmath={"contract", "reassoc", "nsz"})

Q, V, A, AHEAD = range(4)  # rows of what is sent
CONTRACTION, AGE, SEEN, SOLVES = range(4)
MARKS = 4
TERMS = 3  # differences of w that predict the next


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
    """What goes from step to step: sent (4, n), the last w (n,) and mu (m,), their backward differences (TERMS + 1, .) and marks."""

    sent: np.ndarray
    w: np.ndarray
    mu: np.ndarray
    differences: np.ndarray
    differences_mu: np.ndarray
    gram: np.ndarray
    share: np.ndarray
    marks: np.ndarray


@pack
class Trial(NamedTuple):
    """right, r, w, dw (n,), mu, dmu, rows (m,)."""

    now: np.ndarray
    rows: np.ndarray


RIGHT, R, W, DW = range(4)
MU, DMU, PHI = range(3)


def empty(n, m):
    """(Memory, Trial)."""
    shares = np.zeros(TERMS)
    memory = Memory(
        np.zeros((4, n)), np.zeros(n), np.zeros(m), np.zeros((TERMS + 1, n)), np.zeros((TERMS + 1, m)), np.zeros((TERMS, TERMS)), shares, np.zeros(MARKS)
    )
    return memory, Trial(np.zeros((4, n)), np.zeros((3, m)))


@fast
def begin(p, f, k, y, z):
    """The right-hand side of step k, and the prediction of w and mu."""
    right, w, sent = z.now[RIGHT], z.now[W], y.sent
    b = 1.0 / (p.beta * p.h * p.h)
    for i in range(right.shape[0]):
        right[i] = -sent[Q, i] - p.to_v * sent[V, i] - p.to_a * sent[A, i] - b * sent[AHEAD, i]
    add_slope(f.j_q, k, -1.0, right)
    add_slope(f.j_v, k, -p.to_v, right)
    add_slope(f.j_a, k, -p.to_a, right)
    for i in range(w.shape[0]):
        w[i] = y.w[i]
    for e in range(TERMS):
        if y.share[e] != 0.0:
            for i in range(w.shape[0]):
                w[i] += y.share[e] * y.differences[e, i]
    for i in range(y.mu.shape[0]):
        z.rows[MU, i] = y.mu[i]
        for e in range(TERMS):
            z.rows[MU, i] += y.share[e] * y.differences_mu[e, i]


@fast
def add_slope(j, k, factor, out):
    """out += factor j[k], unless j is (0, .)."""
    if j.shape[0]:
        for i in range(out.shape[0]):
            out[i] += factor * j[k, i]


@fast
def residual(p, f, k, x, z):
    """r = S^T w + B^T mu - right and phi = B w + j_lam; the root of the sum of r^2."""
    r, right, stiff, heavy = pairs(z.now[R]), pairs(z.now[RIGHT]), x.stiff, x.heavy
    for i in range(r.shape[0]):
        for e in range(2):
            r[i, e] = stiff[i, e] + p.to_a * heavy[i, e] - right[i, e]
    if x.slowing.shape[0]:
        for i in range(r.shape[0]):
            for e in range(2):
                r[i, e] += p.to_v * x.slowing[i, e]
    for i in range(x.rows.shape[0]):
        z.rows[PHI, i] = x.rows[i]
    add_slope(f.j_lam, k, 1.0, z.rows[PHI])


@fast
def add_correction(z):
    """w += dw, mu += dmu; the sums of dw^2 and w^2."""
    w, dw = z.now[W], z.now[DW]
    moved = size = 0.0
    for i in range(w.shape[0]):
        w[i] += dw[i]
        moved += dw[i] * dw[i]
        size += w[i] * w[i]
    for i in range(z.rows.shape[1]):
        z.rows[MU, i] += z.rows[DMU, i]
    return np.sqrt(moved), np.sqrt(size)


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


@fast
def shift(now, last, differences):
    """Backward differences of one value more: differences[e] is of order e + 1."""
    for i in range(now.shape[0]):
        value = now[i] - last[i]
        last[i] = now[i]
        for e in range(differences.shape[0]):
            before = differences[e, i]
            differences[e, i] = value
            value -= before


@part
def learn(y, z):
    """Take up w and mu; how the next ones are predicted: by the shares of the differences that would have been nearest now."""
    fit(y, z.now[W])
    y.marks[SEEN] += 1.0
    shift(z.now[W], y.w, y.differences)
    shift(z.rows[MU], y.mu, y.differences_mu)
    for e in range(TERMS):
        if e >= y.marks[SEEN] - 1.0:
            y.share[e] = 0.0


@fast
def fit(y, w):
    """Shares of the old differences that are nearest to what w has moved by."""
    g, s, d = y.gram, y.share, y.differences
    n, stride = w.shape[0], 1
    for a in range(TERMS):
        s[a] = 0.0
        for b in range(TERMS):
            g[a, b] = 0.0
    for i in range(0, n, stride):
        t = w[i] - y.w[i]
        for a in range(TERMS):
            s[a] += t * d[a, i]
            for b in range(a + 1):
                g[a, b] += d[a, i] * d[b, i]
    solve_fit(g, s)


@part
def solve_fit(g, s):
    """s <- g^-1 s by Cholesky, shares of differences that depend on earlier ones 0."""
    count = TERMS
    for a in range(TERMS):
        whole = g[a, a]
        for b in range(a):
            for e in range(b):
                g[a, b] -= g[a, e] * g[b, e]
            g[a, b] /= g[b, b]
            g[a, a] -= g[a, b] * g[a, b]
        if not g[a, a] > 1e-10 * whole:
            count = a
            break
        g[a, a] = np.sqrt(g[a, a])
    for a in range(count, TERMS):
        s[a] = 0.0
    for a in range(count):
        for b in range(a):
            s[a] -= g[a, b] * s[b]
        s[a] /= g[a, a]
    for a in range(count - 1, -1, -1):
        for b in range(a + 1, count):
            s[a] -= g[b, a] * s[b]
        s[a] /= g[a, a]


@part
def refine(s, c, room, p, damp, laws, drives, f, k, x, y, z):
    """Solve step k: how it ended; x holds the products of its w."""
    u, v, w, dw, lam = pairs(f.q[k]), pairs(f.v[k]), pairs(z.now[W]), pairs(z.now[DW]), f.lam[k]
    begin(p, f, k, y, z)
    products.hold_state(s, laws, drives, u, v, lam, x)
    products.body_products(s, damp, u, v, w, x.rotation, x)
    hold(s.links, c, room, drives, p.to_a, p.to_v, x)
    none, last = x.rotation[:0], 0.0
    for iteration in range(p.most):
        products.point_products(s.links, laws, room.slopes, w, z.rows[MU], x)
        residual(p, f, k, x, z)
        if not correct(s.links, c, room, pairs(z.now[R]), z.rows[PHI], dw, z.rows[DMU]):
            return SINGULAR
        y.marks[SOLVES] += 1.0
        moved, size = add_correction(z)
        products.body_products(s, damp, u, v, w, none, x)
        if settled(p, y.marks, moved, size, last, iteration):
            products.point_products(s.links, laws, room.slopes, w, z.rows[MU], x)
            return DONE
        if last > 0.0 and not moved <= SLOW * last:
            return REFACTOR
        last = moved
    return REFACTOR


@part
def settled(p, marks, moved, size, last, iteration):
    """Whether what is left of a correction by `moved` after one by `last` is small enough."""
    if last > 0.0:
        rate = moved / last
        marks[CONTRACTION], marks[AGE] = max(rate, (0.5 if iteration == 1 else 1.0) * marks[CONTRACTION]), 0.0
    rate = marks[CONTRACTION]
    known = last > 0.0 or marks[AGE] < FRESHEN
    return known and rate < 1.0 and moved * rate / (1.0 - rate) <= p.enough * size


@entry
def stretch(s, c, room, p, damp, laws, drives, f, last, x, y, z, w, mu):
    """Steps backward from the one before `last`; w (count, n), mu (count, m) of them. Returns (the first step that is done, how it ended)."""
    for k in range(last - 1, -1, -1):
        ended = refine(s, c, room, p, damp, laws, drives[k], f, k, x, y, z)
        if ended != DONE:
            return k + 1, ended
        y.marks[AGE] += 1.0
        send(p, f, k, x, y, z)
        learn(y, z)
        for i in range(w.shape[1]):
            w[k, i] = z.now[W, i]
        for i in range(mu.shape[1]):
            mu[k, i] = z.rows[MU, i]
    return 0, DONE
