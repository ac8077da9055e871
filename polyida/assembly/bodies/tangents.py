"""Tangents of bodies of few coordinates in compiled code: mass, damping and the exact slope of their elastic force."""

from functools import partial

import numpy as np

from polyida.assembly.bodies.compact import place, quadratic, strained, stresses, vectors
from polyida.jit import part

fast = partial(part, fastmath={"contract", "reassoc", "nsz"})


@part
def blocks(c, u, v, c_m, c_v, c_q, out):
    """out (nnz, 2, 2) += `c_m M + c_v dg/dv + c_q dg/dq` of all, where it is made anew: zero before on their blocks."""
    for b in range(c.drag.shape[0]):
        count = c.pair[b + 1] - c.pair[b]
        factor = c_m + c_v * c.drag[b]
        for i in range(count):
            for j in range(count):
                x, y = factor * c.mass[c.mass_start[b] + i * count + j, 0], factor * c.mass[c.mass_start[b] + i * count + j, 1]
                at = c.block[b] + i * count + j
                out[at, 0, 0] += x
                out[at, 1, 1] += x
                out[at, 0, 1] -= y
                out[at, 1, 0] += y
        if vectors(c, b)[2] and (c_q != 0.0 or c_v * c.viscosity[b] != 0.0):
            elastic_blocks(c, b, u, v, c_v, c_q, out)


@part
def elastic_blocks(c, b, u, v, c_v, c_q, out):
    """The elastic and viscous part of `blocks`: curvature of y under s, and (dy/dz)^T form (...)."""
    first, count, size = vectors(c, b)
    s, d, z = np.zeros(size), np.empty(size), np.empty((count, 2))
    here, ahead = np.zeros((size, 2 * count)), np.zeros((size, 2 * count))
    place(c, first, count, u, z)
    slopes(count, z, 1.0, here)
    slopes(count, z, c_q + c_v * c.viscosity[b], ahead)
    if c_q != 0.0:
        strained(c, b, u, d)
        if c.viscosity[b] != 0.0:
            rate, moving = np.empty(size), v[first : first + count]
            quadratic(count, z, moving, rate)
            for e in range(size):
                d[e] += 2.0 * c.viscosity[b] * rate[e]
            slopes(count, moving, c_q * c.viscosity[b], ahead)
        stresses(c, b, d, s)
        for e in range(size):
            s[e] = c_q * (s[e] + c.shift[c.shift_start[b] + e])
        curve(count, s, c.block[b], out)
    stiff = np.zeros((2 * count, size))
    product(c.form[c.form_start[b] : c.form_start[b + 1]].reshape((size, size)), ahead, stiff)
    project(count, here, stiff, c.block[b], out)


@part
def slopes(count, z, factor, out):
    """out (numbers of y, 2 count) += factor dy/dz; of z' instead of z that of y'."""
    at = 0
    for i in range(count):
        for j in range(i, count):
            for k in range(2):
                out[at, 2 * i + k] += factor * z[j, k]
                out[at, 2 * j + k] += factor * z[i, k]
            at += 1
    for i in range(count):
        for j in range(i + 1, count):
            out[at, 2 * i] += factor * z[j, 1]
            out[at, 2 * i + 1] -= factor * z[j, 0]
            out[at, 2 * j] -= factor * z[i, 1]
            out[at, 2 * j + 1] += factor * z[i, 0]
            at += 1


@part
def curve(count, s, first, out):
    """The blocks' part of s d2y/dz2; a body's vectors are its pairs from the second on."""
    at, wide = 0, count + 1
    for i in range(count):
        for j in range(i, count):
            for k in range(2):
                out[first + (i + 1) * wide + j + 1, k, k] += s[at]
                out[first + (j + 1) * wide + i + 1, k, k] += s[at]
            at += 1
    for i in range(count):
        for j in range(i + 1, count):
            one, other = first + (i + 1) * wide + j + 1, first + (j + 1) * wide + i + 1
            out[one, 0, 1] += s[at]
            out[one, 1, 0] -= s[at]
            out[other, 1, 0] += s[at]
            out[other, 0, 1] -= s[at]
            at += 1


@fast
def product(form, slopes, out):
    """out += (form slopes)^T, slopes with few entries in a row."""
    for f in range(slopes.shape[0]):
        for i in range(slopes.shape[1]):
            if slopes[f, i] != 0.0:
                for e in range(form.shape[0]):
                    out[i, e] += form[f, e] * slopes[f, i]


@part
def project(count, here, stiff, first, out):
    """The blocks' part of here^T stiff^T."""
    for e in range(here.shape[0]):
        for i in range(2 * count):
            if here[e, i] != 0.0:
                for j in range(2 * count):
                    out[first + (i // 2 + 1) * (count + 1) + j // 2 + 1, i % 2, j % 2] += here[e, i] * stiff[j, e]
