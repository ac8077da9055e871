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
from polyida.jit import entry, fast, leaf, pack, part, served
from polyida.jit.intrinsics import call, float_of, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import put

FORCE, BLOCKS, MIDDLE = range(3)  # of ReducedArrays.calls


@pack
class ReducedArrays(NamedTuple):
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
def vectors(bodies, body):
    """(first pair of the vectors z_i, their number, size of y); no vectors for a rigid body."""
    size = bodies.shift_start[body + 1] - bodies.shift_start[body]
    return bodies.pair[body] + 1, (bodies.pair[body + 1] - bodies.pair[body] - 1 if size else 0), size


@leaf
def lesser(one, other):
    """The smaller of two; nan if one is nan."""
    return one if one < other or one != one else other


@part
def add_mass(bodies, body, factor, a, residual):
    """residual += factor M a of a body."""
    first, count, at = bodies.pair[body], bodies.pair[body + 1] - bodies.pair[body], bodies.mass_start[body]
    for i in range(count):
        x = y = 0.0
        for j in range(count):
            p, n = bodies.mass[at + i * count + j, 0], bodies.mass[at + i * count + j, 1]
            x += p * a[first + j, 0] - n * a[first + j, 1]
            y += p * a[first + j, 1] + n * a[first + j, 0]
        residual[first + i, 0] += factor * x
        residual[first + i, 1] += factor * y


@part
def place(bodies, first, count, moved, z):
    """z (count, 2) of a body's vectors at the displacements `moved`."""
    for i in range(count):
        for k in range(2):
            z[i, k] = bodies.rest[first - bodies.pair[0] + i, k] + moved[first + i, k]


@part
def quadratic(count, one, along, out):
    """out = half of (conj(x_i) w_j + conj(w_i) x_j), x = one, w = along: the products of z for x = w = z, half their rates for x = z, w = z'."""
    real, imag = 0, count * (count + 1) // 2
    for i in range(count):
        for j in range(i, count):
            out[real] = 0.5 * (one[i, 0] * along[j, 0] + one[i, 1] * along[j, 1] + along[i, 0] * one[j, 0] + along[i, 1] * one[j, 1])
            real += 1
            if i < j:
                out[imag] = 0.5 * (one[i, 0] * along[j, 1] - one[i, 1] * along[j, 0] + along[i, 0] * one[j, 1] - along[i, 1] * one[j, 0])
                imag += 1


@part
def strained(bodies, body, u, change):
    """change = y - y_0 at displacements u, as the sum of terms linear and quadratic in u, without cancellation."""
    first, count, _ = vectors(bodies, body)
    rest, moved, linear = bodies.rest[first - bodies.pair[0] :], u[first:], np.empty(change.shape[0])
    quadratic(count, rest, moved, linear)
    quadratic(count, moved, moved, change)
    for e in range(change.shape[0]):
        change[e] += 2.0 * linear[e]


@fast
def stresses(bodies, body, factor, change):
    """factor form change, of the size of y, from an array that may be longer."""
    size = bodies.shift_start[body + 1] - bodies.shift_start[body]
    form, s = bodies.form[bodies.form_start[body] : bodies.form_start[body + 1]], np.empty(size)
    for e in range(size):
        total = 0.0
        for f in range(size):
            total += form[e * size + f] * change[f]
        s[e] = factor * total
    return s


@part
def push(count, first, stress, z, residual):
    """residual += (dy/dz)^T stress on the vectors z (count, 2) of a body."""
    real, imag = 0, count * (count + 1) // 2
    for i in range(count):
        for j in range(i, count):
            a, b = stress[real], stress[imag] if i < j else 0.0
            residual[first + i, 0] += a * z[j, 0] + b * z[j, 1]
            residual[first + i, 1] += a * z[j, 1] - b * z[j, 0]
            residual[first + j, 0] += a * z[i, 0] - b * z[i, 1]
            residual[first + j, 1] += a * z[i, 1] + b * z[i, 0]
            real, imag = real + 1, imag + (i < j)


@leaf
def turn(bodies, body, moved, rotation):
    """Overwrite rotation on the pairs of a body with the vector that turns with it; return the vector's square, nan if moved is nan.

    moved (pairs, 2): displacements. The vector is (1, 0) for a body without one. rotation (pairs, 2), or (0, 2): nothing is written.
    """
    x = y = some = 0.0
    for i in range(bodies.pair[body], bodies.pair[body + 1]):
        k = i - bodies.pair[0]
        p, n, zx, zy = bodies.axis[k, 0], bodies.axis[k, 1], bodies.rest[k, 0] + moved[i, 0], bodies.rest[k, 1] + moved[i, 1]
        x += p * zx - n * zy
        y += p * zy + n * zx
        some += abs(p) + abs(n)
    if some == 0.0:
        x += 1.0
    if rotation.shape[0]:
        for i in range(bodies.pair[body], bodies.pair[body + 1]):
            rotation[i, 0], rotation[i, 1] = x, y
    return x * x + y * y


@part
def forces(bodies, moved, a, residual, rotation):
    """residual += M a + dW/dz of all bodies; fill rotation with the vectors that turn with them. Returns their least square, or 1e300."""
    least = 1e300
    for b in range(bodies.drag.shape[0]):
        add_mass(bodies, b, 1.0, a, residual)
        least = lesser(least, turn(bodies, b, moved, rotation))
        if vectors(bodies, b)[2]:
            call(bodies.calls[FORCE], (bodies, b, moved, residual))
    return least


@part
def forces_middle(bodies, h, states, residual, rotation):
    """Add M a, the damping and the elastic force of all bodies at the middle of a step of h. s is that of the mean strain of the ends, which conserves the energy.

    states (5, nodes, 2): displacements at both ends, and those of the middle with their velocities and accelerations.
    """
    u0, u1, um, vm, a, least = states[0], states[1], states[2], states[3], states[4], 1e300
    for b in range(bodies.drag.shape[0]):
        add_mass(bodies, b, 1.0, a, residual)
        if bodies.drag[b] != 0.0:
            add_mass(bodies, b, bodies.drag[b], vm, residual)
        least = lesser(least, lesser(turn(bodies, b, u1, rotation), turn(bodies, b, um, rotation)))
        if vectors(bodies, b)[2]:
            call(bodies.calls[MIDDLE], (bodies, b, h, u0, u1, um, residual))
    return least


@part
def pairs_at(bodies, number):
    """The array (pairs, 2) at an address."""
    return carray(pointer(number), (bodies.pair[bodies.pair.shape[0] - 1], 2))


@part
def number(bodies, bits):
    """The float64 that has these bits."""
    return float_of(bits)


@part
def tangent_at(bodies, at):
    """The blocks (., 2, 2) of the tangent at an address."""
    return carray(pointer(at), (bodies.block[bodies.block.shape[0] - 1], 2, 2))


@part
def elastic_force(bodies, body, moved, residual):
    """residual += dW/dz of an elastic body."""
    change = np.empty(vectors(bodies, body)[2])
    strained(bodies, body, moved, change)
    push_elastic(bodies, body, moved, change, residual)
    return DONE


@part
def push_elastic(bodies, body, moved, change, residual):
    """residual += (dy/dz)^T (form change + shift) of an elastic body at the displacements `moved`."""
    s = stresses(bodies, body, 1.0, change)
    for k in range(s.shape[0]):
        s[k] += bodies.shift[bodies.shift_start[body] + k]
    push_placed(bodies, body, moved, s, residual)


@part
def push_placed(bodies, body, moved, stress, residual):
    """residual += (dy/dz)^T stress of a body at the displacements `moved`."""
    first, count, _ = vectors(bodies, body)
    z = np.empty((count, 2))
    place(bodies, first, count, moved, z)
    push(count, first, stress, z, residual)


@part
def elastic_force_middle(bodies, body, h, u0, u1, um, residual):
    """residual += the elastic force at um in the middle of a step of h, with s of the mean strain of u0 and u1, and the viscous force."""
    size, lag = vectors(bodies, body)[2], bodies.viscosity[body] / h
    before, change = np.empty(size), np.empty(size)
    strained(bodies, body, u0, before)
    strained(bodies, body, u1, change)
    for k in range(size):
        change[k] = 0.5 * (before[k] + change[k]) + lag * (change[k] - before[k])
    push_elastic(bodies, body, um, change, residual)
    return DONE


@part
def momentum(bodies, a, residual):
    """residual += M a of all."""
    for b in range(bodies.drag.shape[0]):
        add_mass(bodies, b, 1.0, a, residual)


@part
def add_damping(bodies, moved, v, residual):
    """Add the damping forces of all bodies to residual: `drag M v + viscosity (dy/dz)^T form y'`."""
    for b in range(bodies.drag.shape[0]):
        if bodies.drag[b] != 0.0:
            add_mass(bodies, b, bodies.drag[b], v, residual)
        first, count, size = vectors(bodies, b)
        if size and bodies.viscosity[b] != 0.0:
            rate, z = np.empty(size), np.empty((count, 2))
            place(bodies, first, count, moved, z)
            quadratic(count, z, v[first : first + count], rate)
            for e in range(size):
                rate[e] *= 2.0 * bodies.viscosity[b]
            push(count, first, stresses(bodies, b, 1.0, rate), z, residual)


@part
def energy(bodies, moved):
    """Elastic energy of all, J."""
    total = 0.0
    for b in range(bodies.drag.shape[0]):
        total += body_energy(bodies, b, moved)
    return total


@part
def body_energy(bodies, body, moved):
    """Elastic energy of a body, J."""
    total, size = 0.0, vectors(bodies, body)[2]
    if size:
        d = np.empty(size)
        strained(bodies, body, moved, d)
        s = stresses(bodies, body, 1.0, d)
        for e in range(size):
            total += d[e] * (0.5 * s[e] + bodies.shift[bodies.shift_start[body] + e])
    return total


@entry
def energies(bodies, frames, out):
    """Fill out (frames, bodies) with the elastic energy, J, of each body at displacements (frames, nodes, 2)."""
    for k in range(frames.shape[0]):
        for b in range(bodies.drag.shape[0]):
            out[k, b] = body_energy(bodies, b, frames[k])


@part
def blocks(bodies, moved, v, c_m, c_v, c_q, out):
    """out (nnz, 2, 2) += `c_m M + c_v dg/dv + c_q dg/dq` of all."""
    for b in range(bodies.drag.shape[0]):
        count = bodies.pair[b + 1] - bodies.pair[b]
        factor = c_m + c_v * bodies.drag[b]
        for i in range(count):
            for j in range(count):
                x, y = (
                    factor * bodies.mass[bodies.mass_start[b] + i * count + j, 0],
                    factor * bodies.mass[bodies.mass_start[b] + i * count + j, 1],
                )
                at = bodies.block[b] + i * count + j
                out[at, 0, 0] += x
                out[at, 1, 1] += x
                out[at, 0, 1] -= y
                out[at, 1, 0] += y
        if vectors(bodies, b)[2] and (c_q != 0.0 or c_v * bodies.viscosity[b] != 0.0):
            call(bodies.calls[BLOCKS], (bodies, b, moved, v, c_v, c_q, out))


@part
def elastic_blocks(bodies, body, moved, v, c_v, c_q, out):
    """The elastic and viscous part of `blocks`: curvature of y under s, and (dy/dz)^T form (...)."""
    first, count, size = vectors(bodies, body)
    d, z = np.empty(size), np.empty((count, 2))
    slopes, factored = np.zeros((size, 2 * count)), np.zeros((size, 2 * count))
    place(bodies, first, count, moved, z)
    add_y_jacobian(count, z, 1.0, slopes)
    add_y_jacobian(count, z, c_q + c_v * bodies.viscosity[body], factored)
    if c_q != 0.0:
        strained(bodies, body, moved, d)
        if bodies.viscosity[body] != 0.0:
            rate, moving = np.empty(size), v[first : first + count]
            quadratic(count, z, moving, rate)
            for e in range(size):
                d[e] += 2.0 * bodies.viscosity[body] * rate[e]
            add_y_jacobian(count, moving, c_q * bodies.viscosity[body], factored)
        s = stresses(bodies, body, 1.0, d)
        for e in range(size):
            s[e] = c_q * (s[e] + bodies.shift[bodies.shift_start[body] + e])
        curve(count, s, bodies.block[body], out)
    stiffen(bodies, body, slopes, factored, out)
    return DONE


KERNELS = {
    FORCE: served(elastic_force, pairs_at, pairs_at),
    BLOCKS: served(elastic_blocks, pairs_at, pairs_at, number, number, tangent_at),
    MIDDLE: served(elastic_force_middle, number, pairs_at, pairs_at, pairs_at, pairs_at),
}


def provide(bodies, *wanted):
    """Compile kernels of elastic bodies, if there are any: scenes without such bodies do without them."""
    for number in wanted if len(bodies.shift) else ():
        bodies.calls[number] = table_address(KERNELS[number], typeof(bodies))


@part
def stiffen(bodies, body, slopes, factored, out):
    """Add slopes^T form factored of a body to the blocks."""
    _, count, size = vectors(bodies, body)
    stiff = np.zeros((2 * count, size))
    product(bodies.form[bodies.form_start[body] : bodies.form_start[body + 1]].reshape((size, size)), factored, stiff)
    project(count, slopes, stiff, bodies.block[body], out)


@part
def relaxed_blocks(bodies, body, moved, viscous_strain, change, c_q, out):
    """Add to the tangent's blocks `out` c_q times what relaxation adds to K of a body at the displacements `moved`.

    That is the curvature of y under -form viscous_strain, and `change` times (dy/dz)^T form dy/dz.
    """
    first, count, size = vectors(bodies, body)
    z, slopes, factored = np.empty((count, 2)), np.zeros((size, 2 * count)), np.zeros((size, 2 * count))
    place(bodies, first, count, moved, z)
    add_y_jacobian(count, z, 1.0, slopes)
    add_y_jacobian(count, z, c_q * change, factored)
    curve(count, stresses(bodies, body, -c_q, viscous_strain), bodies.block[body], out)
    stiffen(bodies, body, slopes, factored, out)


@part
def relax(bodies, body, moved, half, viscous_strain, residual, out):
    """Add (dy/dz)^T (-form viscous_strain) of a body to residual, and store d at `moved` in out, in whose last place is 0 if d has an odd size.

    half: as of element/relaxation.py; y is quadratic, and its mean at `moved` - half and moved + half is that at `moved` plus y(half).
    """
    first, count, size = vectors(bodies, body)
    out[:] = 0.0
    strained(bodies, body, moved, out[:size])
    add_half(half, first, count, out[:size])
    push_placed(bodies, body, moved, stresses(bodies, body, -1.0, viscous_strain), residual)


@part
def add_half(half, first, count, out):
    """out += y(half), unless it is None."""
    if half is not None:
        y = np.empty(out.shape[0])
        quadratic(count, half[first : first + count], half[first : first + count], y)
        for e in range(out.shape[0]):
            out[e] += y[e]


@part
def change_of_strain(bodies, body, moved, along, out):
    """Store the change of y at `moved` along the velocities `along` in out."""
    first, count, size = vectors(bodies, body)
    z = np.empty((count, 2))
    place(bodies, first, count, moved, z)
    out[:] = 0.0
    quadratic(count, z, along[first : first + count], out[:size])
    for e in range(size):
        out[e] *= 2.0


@part
def relaxation_products(bodies, body, moved, along, viscous_strain, back, residual, out):
    """Add the change of (dy/dz)^T (-form viscous_strain) along the velocities `along`, and (dy/dz)^T back, to residual, and store form times the change of y along w in out."""
    first, count, size = vectors(bodies, body)
    push(count, first, stresses(bodies, body, -1.0, viscous_strain), along[first : first + count], residual)
    push_placed(bodies, body, moved, back, residual)
    change, out[:] = np.empty(size), 0.0
    change_of_strain(bodies, body, moved, along, change)
    put(1.0, stresses(bodies, body, 1.0, change), out)


@part
def strain_square(bodies, body, change):
    """The square of a change of strains in the norm of the elastic energy, `change^T form change`, J."""
    s, total = stresses(bodies, body, 1.0, change), 0.0
    for e in range(s.shape[0]):
        total += change[e] * s[e]
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
def curve(count, stress, first, out):
    """Add stress d2y/dz2 to the blocks."""
    real, imag, wide = 0, count * (count + 1) // 2, count + 1
    for i in range(count):
        for j in range(i, count):
            a, b = stress[real], stress[imag] if i < j else 0.0
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
