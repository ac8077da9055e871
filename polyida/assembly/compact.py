"""Bodies of few coordinates in compiled code: mass, elastic force and tangent on pairs of q that are points of the complex plane.

Elastic ones, of K vectors z_i, are exact St. Venant-Kirchhoff in a subspace that is closed under rotation: Green's strain is linear in
y = (Re conj(z_i) z_j, i <= j; Im conj(z_i) z_j, i < j), so that `W = d^T form d / 2 + shift^T d`, d = y - y_0, and `s = form d + shift`,

    dW/dz_i += (s_R - i s_I) z_j,   dW/dz_j += (s_R + i s_I) z_i      for each pair i <= j

(Gerstmayr and Ambrosio 2008; Pechstein, Reischl, Gerstmayr 2013). The cost does not depend on the cells of a body.
"""

from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.errors import DONE
from polyida.jit import entry, fast, leaf, pack, part
from polyida.jit.intrinsics import address, call, float_of, integer_of, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import put

FORCE, BLOCKS, MIDDLE = range(3)  # of Compact.calls


@pack
class Compact(NamedTuple):
    """The bodies of few coordinates. The vectors z_i of an elastic body are its pairs from the second on."""

    pair: np.ndarray  # (bodies + 1,) first pair of q
    block: np.ndarray  # (bodies + 1,) first block of the tangent, which is full on a body's pairs
    rest: np.ndarray  # (pairs, 2) z at rest, from the first of these bodies on
    mass_start: np.ndarray
    mass: np.ndarray  # (., 2) complex: Hermitian matrices, row by row
    axis: np.ndarray  # (pairs, 2) complex weights of the vector that turns with the body; zero without
    form_start: np.ndarray
    form: np.ndarray  # of elastic bodies
    shift_start: np.ndarray
    shift: np.ndarray
    drag: np.ndarray  # mass-proportional damping, 1/s
    viscosity: np.ndarray  # s
    calls: np.ndarray  # (3,) addresses of the kernels of elastic bodies, see `provide`


@leaf
def vectors(c, b):
    """(first pair of the vectors z_i, their number, size of y); no vectors for a rigid body."""
    size = c.shift_start[b + 1] - c.shift_start[b]
    return c.pair[b] + 1, (c.pair[b + 1] - c.pair[b] - 1 if size else 0), size


@leaf
def lesser(a, b):
    """The smaller of two; nan if one is nan."""
    return a if a < b or a != a else b


@part
def add_mass(c, b, factor, a, r):
    """r += factor M a of body b."""
    first, count, at = c.pair[b], c.pair[b + 1] - c.pair[b], c.mass_start[b]
    for i in range(count):
        x = y = 0.0
        for j in range(count):
            p, n = c.mass[at + i * count + j, 0], c.mass[at + i * count + j, 1]
            x += p * a[first + j, 0] - n * a[first + j, 1]
            y += p * a[first + j, 1] + n * a[first + j, 0]
        r[first + i, 0] += factor * x
        r[first + i, 1] += factor * y


@part
def place(c, first, count, u, z):
    """z (count, 2) of a body's vectors at displacements u."""
    for i in range(count):
        for k in range(2):
            z[i, k] = c.rest[first - c.pair[0] + i, k] + u[first + i, k]


@part
def quadratic(count, x, w, y):
    """y = half of (conj(x_i) w_j + conj(w_i) x_j): the products of z for x = w = z, half their rates for x = z, w = z'."""
    real, imag = 0, count * (count + 1) // 2
    for i in range(count):
        for j in range(i, count):
            y[real] = 0.5 * (x[i, 0] * w[j, 0] + x[i, 1] * w[j, 1] + w[i, 0] * x[j, 0] + w[i, 1] * x[j, 1])
            real += 1
            if i < j:
                y[imag] = 0.5 * (x[i, 0] * w[j, 1] - x[i, 1] * w[j, 0] + w[i, 0] * x[j, 1] - w[i, 1] * x[j, 0])
                imag += 1


@part
def strained(c, b, u, d):
    """d = y - y_0 at displacements u, as the sum of terms linear and quadratic in u, without cancellation."""
    first, count, _ = vectors(c, b)
    rest, moved, linear = c.rest[first - c.pair[0] :], u[first:], np.empty(d.shape[0])
    quadratic(count, rest, moved, linear)
    quadratic(count, moved, moved, d)
    for e in range(d.shape[0]):
        d[e] += 2.0 * linear[e]


@fast
def stresses(c, b, factor, d):
    """factor form d, of the size of y, from an array d that may be longer."""
    size = c.shift_start[b + 1] - c.shift_start[b]
    form, s = c.form[c.form_start[b] : c.form_start[b + 1]], np.empty(size)
    for e in range(size):
        total = 0.0
        for f in range(size):
            total += form[e * size + f] * d[f]
        s[e] = factor * total
    return s


@part
def push(count, first, s, z, r):
    """r += (dy/dz)^T s on the vectors z (count, 2) of a body."""
    real, imag = 0, count * (count + 1) // 2
    for i in range(count):
        for j in range(i, count):
            a, b = s[real], s[imag] if i < j else 0.0
            r[first + i, 0] += a * z[j, 0] + b * z[j, 1]
            r[first + i, 1] += a * z[j, 1] - b * z[j, 0]
            r[first + j, 0] += a * z[i, 0] - b * z[i, 1]
            r[first + j, 1] += a * z[i, 1] + b * z[i, 0]
            real, imag = real + 1, imag + (i < j)


@leaf
def turn(c, b, u, rotation):
    """Fill rotation on a body's pairs with the vector that turns with it, (1, 0) without one; return its square, nan if u is nan."""
    x = y = some = 0.0
    for i in range(c.pair[b], c.pair[b + 1]):
        k = i - c.pair[0]
        p, n, zx, zy = c.axis[k, 0], c.axis[k, 1], c.rest[k, 0] + u[i, 0], c.rest[k, 1] + u[i, 1]
        x += p * zx - n * zy
        y += p * zy + n * zx
        some += abs(p) + abs(n)
    if some == 0.0:
        x += 1.0
    if rotation.shape[0]:
        for i in range(c.pair[b], c.pair[b + 1]):
            rotation[i, 0], rotation[i, 1] = x, y
    return x * x + y * y


@part
def forces(c, u, a, r, rotation):
    """r += M a + dW/dz of all; rotation: as of `turn`. Returns the least square of a frame's vector, 1e300 without bodies."""
    least = 1e300
    for b in range(c.drag.shape[0]):
        add_mass(c, b, 1.0, a, r)
        least = lesser(least, turn(c, b, u, rotation))
        if vectors(c, b)[2]:
            call(c.calls[FORCE], address(c), b, address(u), address(r), 0, 0, 0, 0)
    return least


@part
def forces_middle(c, h, u0, u1, um, vm, a, r, rotation):
    """The same at the middle of a step of h, with damping. s is that of the mean strain of the ends, which conserves the energy."""
    least = 1e300
    for b in range(c.drag.shape[0]):
        add_mass(c, b, 1.0, a, r)
        if c.drag[b] != 0.0:
            add_mass(c, b, c.drag[b], vm, r)
        least = lesser(least, lesser(turn(c, b, u1, rotation), turn(c, b, um, rotation)))
        if vectors(c, b)[2]:
            call(c.calls[MIDDLE], address(c), b, integer_of(h), address(u0), address(u1), address(um), address(r), 0)
    return least


@part
def pairs_at(c, number):
    """The array (pairs, 2) at an address."""
    return carray(pointer(number), (c.pair[c.pair.shape[0] - 1], 2))


@entry
def elastic_force(c, b, displacements, forces, d, e, f, g):
    """r += dW/dz of elastic body b."""
    u, size = pairs_at(c, displacements), vectors(c, b)[2]
    change = np.empty(size)
    strained(c, b, u, change)
    push_elastic(c, b, u, change, forces)
    return DONE


@part
def push_elastic(c, b, u, change, forces):
    """r += (dy/dz)^T (form change + shift) of elastic body b at displacements u."""
    s = stresses(c, b, 1.0, change)
    for k in range(s.shape[0]):
        s[k] += c.shift[c.shift_start[b] + k]
    push_placed(c, b, u, s, pairs_at(c, forces))


@part
def push_placed(c, b, u, s, r):
    """r += (dy/dz)^T s of body b at displacements u."""
    first, count, _ = vectors(c, b)
    z = np.empty((count, 2))
    place(c, first, count, u, z)
    push(count, first, s, z, r)


@entry
def elastic_force_middle(c, b, step, start, end, middle, forces, g):
    """The same in the middle of a step, with viscosity."""
    size, lag = vectors(c, b)[2], c.viscosity[b] / float_of(step)
    before, change = np.empty(size), np.empty(size)
    strained(c, b, pairs_at(c, start), before)
    strained(c, b, pairs_at(c, end), change)
    for k in range(size):
        change[k] = 0.5 * (before[k] + change[k]) + lag * (change[k] - before[k])
    push_elastic(c, b, pairs_at(c, middle), change, forces)
    return DONE


@part
def momentum(c, a, r):
    """r += M a of all."""
    for b in range(c.drag.shape[0]):
        add_mass(c, b, 1.0, a, r)


@part
def add_damping(c, u, v, r):
    """Add the damping forces of all bodies to r: `drag M v + viscosity (dy/dz)^T form y'`."""
    for b in range(c.drag.shape[0]):
        if c.drag[b] != 0.0:
            add_mass(c, b, c.drag[b], v, r)
        first, count, size = vectors(c, b)
        if size and c.viscosity[b] != 0.0:
            rate, z = np.empty(size), np.empty((count, 2))
            place(c, first, count, u, z)
            quadratic(count, z, v[first : first + count], rate)
            for e in range(size):
                rate[e] *= 2.0 * c.viscosity[b]
            push(count, first, stresses(c, b, 1.0, rate), z, r)


@part
def energy(c, u):
    """Elastic energy of all, J."""
    total = 0.0
    for b in range(c.drag.shape[0]):
        total += body_energy(c, b, u)
    return total


@part
def body_energy(c, b, u):
    """Elastic energy of body b, J."""
    total, size = 0.0, vectors(c, b)[2]
    if size:
        d = np.empty(size)
        strained(c, b, u, d)
        s = stresses(c, b, 1.0, d)
        for e in range(size):
            total += d[e] * (0.5 * s[e] + c.shift[c.shift_start[b] + e])
    return total


@entry
def energies(c, frames, out):
    """Fill out (frames, bodies) with the elastic energy, J, of each body at displacements (frames, nodes, 2)."""
    for k in range(frames.shape[0]):
        for b in range(c.drag.shape[0]):
            out[k, b] = body_energy(c, b, frames[k])


@part
def blocks(c, u, v, c_m, c_v, c_q, out):
    """out (nnz, 2, 2) += `c_m M + c_v dg/dv + c_q dg/dq` of all."""
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
            call(c.calls[BLOCKS], address(c), b, address(u), address(v), integer_of(c_v), integer_of(c_q), address(out), 0)


@entry
def elastic_blocks(c, b, displacements, velocities, factor_v, factor_q, blocks, g):
    """The elastic and viscous part of `blocks`: curvature of y under s, and (dy/dz)^T form (...)."""
    u, v, c_v, c_q = pairs_at(c, displacements), pairs_at(c, velocities), float_of(factor_v), float_of(factor_q)
    out, (first, count, size) = carray(pointer(blocks), (c.block[c.block.shape[0] - 1], 2, 2)), vectors(c, b)
    d, z = np.empty(size), np.empty((count, 2))
    slopes, factored = np.zeros((size, 2 * count)), np.zeros((size, 2 * count))
    place(c, first, count, u, z)
    add_y_jacobian(count, z, 1.0, slopes)
    add_y_jacobian(count, z, c_q + c_v * c.viscosity[b], factored)
    if c_q != 0.0:
        strained(c, b, u, d)
        if c.viscosity[b] != 0.0:
            rate, moving = np.empty(size), v[first : first + count]
            quadratic(count, z, moving, rate)
            for e in range(size):
                d[e] += 2.0 * c.viscosity[b] * rate[e]
            add_y_jacobian(count, moving, c_q * c.viscosity[b], factored)
        s = stresses(c, b, 1.0, d)
        for e in range(size):
            s[e] = c_q * (s[e] + c.shift[c.shift_start[b] + e])
        curve(count, s, c.block[b], out)
    stiffen(c, b, slopes, factored, out)
    return DONE


KERNELS = {FORCE: elastic_force, BLOCKS: elastic_blocks, MIDDLE: elastic_force_middle}


def provide(c, *wanted):
    """Compile kernels of elastic bodies, if there are any: scenes without such bodies do without them."""
    for number in wanted if len(c.shift) else ():
        c.calls[number] = table_address(KERNELS[number], typeof(c))


@part
def stiffen(c, b, slopes, factored, out):
    """Add slopes^T form factored of body b to the blocks."""
    _, count, size = vectors(c, b)
    stiff = np.zeros((2 * count, size))
    product(c.form[c.form_start[b] : c.form_start[b + 1]].reshape((size, size)), factored, stiff)
    project(count, slopes, stiff, c.block[b], out)


@part
def relaxed_blocks(c, b, u, pull, change, c_q, out):
    """What relaxation adds to c_q K of body b: the curvature of y under -form pull, and `change` times (dy/dz)^T form dy/dz."""
    first, count, size = vectors(c, b)
    z, slopes, factored = np.empty((count, 2)), np.zeros((size, 2 * count)), np.zeros((size, 2 * count))
    place(c, first, count, u, z)
    add_y_jacobian(count, z, 1.0, slopes)
    add_y_jacobian(count, z, c_q * change, factored)
    curve(count, stresses(c, b, -c_q, pull), c.block[b], out)
    stiffen(c, b, slopes, factored, out)


@part
def relax(c, b, u, half, pull, r, out):
    """Add (dy/dz)^T (-form pull) of body b to r, and store d at u in out, in whose last place is 0 if d has an odd size.

    half: as of element/relaxation.py; y is quadratic, and its mean at u - half and u + half is that at u plus y(half).
    """
    first, count, size = vectors(c, b)
    out[:] = 0.0
    strained(c, b, u, out[:size])
    add_half(half, first, count, out[:size])
    push_placed(c, b, u, stresses(c, b, -1.0, pull), r)


@part
def add_half(half, first, count, out):
    """out += y(half), unless it is None."""
    if half is not None:
        y = np.empty(out.shape[0])
        quadratic(count, half[first : first + count], half[first : first + count], y)
        for e in range(out.shape[0]):
            out[e] += y[e]


@part
def change_of_strain(c, b, u, w, out):
    """Store the change of y at u along w in out."""
    first, count, size = vectors(c, b)
    z = np.empty((count, 2))
    place(c, first, count, u, z)
    out[:] = 0.0
    quadratic(count, z, w[first : first + count], out[:size])
    for e in range(size):
        out[e] *= 2.0


@part
def relaxation_products(c, b, u, w, pull, back, r, out):
    """Add the change of (dy/dz)^T (-form pull) along w, and (dy/dz)^T back, to r, and store form times the change of y along w in out."""
    first, count, size = vectors(c, b)
    push(count, first, stresses(c, b, -1.0, pull), w[first : first + count], r)
    push_placed(c, b, u, back, r)
    change, out[:] = np.empty(size), 0.0
    change_of_strain(c, b, u, w, change)
    put(1.0, stresses(c, b, 1.0, change), out)


@part
def strain_square(c, b, d):
    """d^T form d."""
    s, total = stresses(c, b, 1.0, d), 0.0
    for e in range(s.shape[0]):
        total += d[e] * s[e]
    return total


@entry
def add_y_jacobian(count, z, factor, out):
    """out += factor dy/dz, (size of y, 2 count). y is quadratic in z: with z' in place of z the same function gives dy'/dz."""
    real, imag = 0, count * (count + 1) // 2
    for i in range(count):
        for j in range(i, count):
            for k in range(2):
                out[real, 2 * i + k] += factor * z[j, k]
                out[real, 2 * j + k] += factor * z[i, k]
            real += 1
            if i < j:
                out[imag, 2 * i] += factor * z[j, 1]
                out[imag, 2 * i + 1] -= factor * z[j, 0]
                out[imag, 2 * j] -= factor * z[i, 1]
                out[imag, 2 * j + 1] += factor * z[i, 0]
                imag += 1


@part
def curve(count, s, first, out):
    """Add s d2y/dz2 to the blocks."""
    real, imag, wide = 0, count * (count + 1) // 2, count + 1
    for i in range(count):
        for j in range(i, count):
            a, b = s[real], s[imag] if i < j else 0.0
            one, other = first + (i + 1) * wide + j + 1, first + (j + 1) * wide + i + 1
            for k in range(2):
                out[one, k, k] += a
                out[other, k, k] += a
            out[one, 0, 1] += b
            out[one, 1, 0] -= b
            out[other, 1, 0] += b
            out[other, 0, 1] -= b
            real, imag = real + 1, imag + (i < j)


@fast
def product(form, slopes, out):
    """out += (form slopes)^T; rows of slopes have few entries."""
    for f in range(slopes.shape[0]):
        for i in range(slopes.shape[1]):
            if slopes[f, i] != 0.0:
                for e in range(form.shape[0]):
                    out[i, e] += form[f, e] * slopes[f, i]


@part
def project(count, slopes, stiff, first, out):
    """Add slopes^T stiff^T to the blocks."""
    for e in range(slopes.shape[0]):
        for i in range(2 * count):
            if slopes[e, i] != 0.0:
                for j in range(2 * count):
                    out[first + (i // 2 + 1) * (count + 1) + j // 2 + 1, i % 2, j % 2] += slopes[e, i] * stiff[j, e]
