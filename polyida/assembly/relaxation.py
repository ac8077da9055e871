"""Viscoelastic plates of a scene: the relaxed strains x as states, of full plates at the points of the elements, of reduced ones in y (reduced_kernels.py).

Of each term (g, tau) of a plate's Prony series `x' = (E - x) / tau`, E Green's strain, and the stress is `S = D : (E - sum g x)`. As all
states they are velocities of coordinates of mass `mass`, `x = unit v`, behind all others: `mass (a - (E - x) / (tau unit)) = 0`.

With `dv = c_v dq` and c = c_m/c_v these coordinates are eliminated from a step's system. Their residuals r become the strains
`e = unit tau r / (mass (1 + c tau))`, and with B = dE/dq

    r of the nodes += B^T D sum g e,   D -> kappa D, kappa = 1 - sum g / (1 + c tau),   unit c_v dq = B dq / (1 + c tau) - e

so that the pattern and the frames of the plates' factor stay as they are. E of a reduced plate is y - y_0, and D its form: since Green's
strain is linear in y, the same relaxation as of the full plate in the span of its fields.

Bodies are numbered as in Relaxation: full plates, then bodies of few coordinates.
"""

from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.assembly import reduced_kernels
from polyida.assembly.arrays import SceneArrays, cells_of, material_of
from polyida.element import kernels
from polyida.element.operator import Blocks
from polyida.element.relaxation import change_of_strain, relax, strain_square
from polyida.errors import DONE
from polyida.jit import entry, fast, pack, part, served
from polyida.jit.intrinsics import LANES, call, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import copy_matrix, put
from polyida.linear.lu import summed
from polyida.validation import pairs_of


@part
def strains_of(relaxation, body):
    """Number of strains of a body in each of its terms; 0 without any."""
    return (relaxation.start[body + 1] - relaxation.start[body]) // max(1, relaxation.terms[body + 1] - relaxation.terms[body])


@part
def relax_body(scene, body, moved, half, viscous_strain, force, strain):
    """Relax the strains of a body, full plate or of few coordinates, by the kernel `relax` of its kind."""
    s = scene.plates
    o = s.body_node.shape[0] - 1
    if body >= o:
        reduced_kernels.relax(scene.reduced, body - o, moved, half, viscous_strain, force, strain)
    else:
        relax(cells_of(s, body), material_of(s, body), moved, half, viscous_strain, force, strain)


@part
def change_strain(scene, body, moved, along, strain):
    """Fill the change of the strains of a body along a velocity, by the kernel `change_of_strain` of its kind."""
    s = scene.plates
    o = s.body_node.shape[0] - 1
    if body >= o:
        reduced_kernels.change_of_strain(scene.reduced, body - o, moved, along, strain)
    else:
        change_of_strain(cells_of(s, body), moved, along, strain)


@part
def square(scene, body, strain):
    """Integral of E : D : E of a strain over a body, J."""
    s = scene.plates
    o = s.body_node.shape[0] - 1
    if body >= o:
        return reduced_kernels.strain_square(scene.reduced, body - o, strain)
    first = s.body_operator[body]
    return strain_square(s.weights[s.at[first, 3] : s.at[first + 1, 3]], material_of(s, body), strain)


@part
def pairs_of_body(scene, body):
    """(first pair, end) of q that move a body."""
    s, c = scene.plates, scene.reduced
    o = s.body_node.shape[0] - 1
    return (c.pair[body - o], c.pair[body - o + 1]) if body >= o else (s.body_node[body], s.body_node[body + 1])


@part
def take_viscous_strain(relaxation, body, v, viscous_strain):
    """viscous_strain = sum g x of a body, from the velocities v (numbers,)."""
    at, count = 2 * relaxation.first + relaxation.start[body], viscous_strain.shape[0]
    viscous_strain[:] = 0.0
    for k in range(relaxation.terms[body], relaxation.terms[body + 1]):
        add_real(viscous_strain, relaxation.share[k] * relaxation.unit[body], v[at : at + count], 0)
        at += count


@fast
def add_real(out, factor, numbers, imaginary):
    """out += factor times the real parts of numbers, or if imaginary is 1 the imaginary ones. A loop over whole arrays becomes one over vectors."""
    for j in range(out.shape[0]):
        out[j] += factor * (numbers[j].real if imaginary == 0 else numbers[j].imag)


@fast
def add_scaled(out, factor, numbers):
    """Add factor times the numbers to out."""
    for j in range(out.shape[0]):
        out[j] += factor * numbers[j]


@entry
def add_relaxation(scene, moved, half, v, still, residual):
    """Add to residual (n / 2, 2) the forces of relaxation on the nodes, and behind them the residuals of the relaxing strains, without inertia.

    half: as of `relax`. v (n / 2, 2): velocities, of the strains these over `unit`. still: factor of the strain in the equations of the
    relaxing strains, 0 for the part that is linear in v.
    """
    x, speeds, forces = scene.relaxation, v.reshape(-1), residual.reshape(-1)
    for b in range(x.start.shape[0] - 1):
        if x.terms[b] == x.terms[b + 1]:
            continue
        count = strains_of(x, b)
        viscous_strain, strain = np.empty(count), np.empty(count)
        take_viscous_strain(x, b, speeds, viscous_strain)
        relax_body(scene, b, moved, half, viscous_strain, residual, strain)
        at = 2 * x.first + x.start[b]
        for k in range(x.terms[b], x.terms[b + 1]):
            rate, own = x.mass / x.time[k], forces[at : at + count]
            add_scaled(own, rate, speeds[at : at + count])
            add_scaled(own, -still * rate / x.unit[b], strain)
            at += count


@entry
def add_relaxation_middle(scene, u0, u1, um, vm, residual):
    """Add the forces of relaxation in the middle of a step, with the mean strain of its ends, to the residual."""
    half = np.empty((scene.relaxation.first, 2))
    for i in range(half.shape[0]):
        half[i, 0], half[i, 1] = 0.5 * (u1[i, 0] - u0[i, 0]), 0.5 * (u1[i, 1] - u0[i, 1])
    add_relaxation(scene, um, half, vm, 1.0, residual)


@entry
def add_relaxed_blocks(scene, moved, v, changes, c_q, blocks):
    """Add c_q times what relaxation adds to K; changes (bodies,): kappa - 1."""
    s, x, speeds = scene.plates, scene.relaxation, v.reshape(-1)
    few = s.body_node.shape[0] - 1
    for b in range(changes.shape[0]):
        if x.terms[b] < x.terms[b + 1]:
            viscous_strain = np.empty(strains_of(x, b))
            take_viscous_strain(x, b, speeds, viscous_strain)
            if b >= few:
                reduced_kernels.relaxed_blocks(scene.reduced, b - few, moved, viscous_strain, changes[b], c_q, blocks)
                continue
            o = s.body_operator[b]
            own = Blocks(s.pairs[s.at[o, 4] : s.at[o + 1, 4]], s.body_block[b], blocks)
            kernels.relaxed_tangent(cells_of(s, b), own, material_of(s, b), moved, c_q, viscous_strain, changes[b])


@pack
class Elimination(NamedTuple):
    """Workspace of the solves of a factor. rates: c and c_v; parts: 1, and i if they are complex; strains: the e; r, force: on the nodes;
    whole: of all coordinates. calls: addresses of this, and of two C functions, which are compiled if the scene has such strains; else zero."""

    scene: SceneArrays
    rates: np.ndarray
    parts: np.ndarray
    strains: np.ndarray
    r: np.ndarray
    force: np.ndarray
    whole: np.ndarray
    calls: np.ndarray


def elimination(model, dtype):
    """The Elimination of a scene."""
    x = model.arrays.relaxation
    parts = np.array([1.0, 1j] if np.dtype(dtype).kind == "c" else [1.0])
    (nodes, all_nodes), calls = ((x.first, 2), (model.n_nodes, 2)) if len(x.share) else [(0, 2)] * 2, np.zeros(3, np.int64)
    numbers = np.zeros(2, dtype), parts, np.zeros(x.start[-1], dtype), np.zeros(nodes, dtype), np.zeros(nodes), np.zeros(all_nodes, dtype)
    workspace = Elimination(model.arrays, *numbers, calls)
    if len(x.share):
        calls[:] = workspace.address, *(table_address(function, typeof(workspace)) for function in FUNCTIONS)
    return workspace


@entry
def eliminate(work, moved, residual):
    """The residuals of the nodes without the strains, from those of all coordinates residual (nodes, 2) at the displacements `moved`; residual itself without strains."""
    if work.calls[0] == 0:
        return residual
    copy_matrix(residual, work.whole)
    call(work.calls[1], (work.calls[0], moved))
    return work.r


@entry
def recover(work, moved, dq):
    """Fill the corrections of the strains behind `eliminate`, from those of the nodes, in dq (nodes, 2)."""
    if work.calls[0] != 0:
        copy_matrix(dq, work.whole)
        call(work.calls[2], (work.calls[0], moved))
        copy_matrix(work.whole, dq)


@part
def nodal(work, at):
    """The array (nodes, 2) at an address."""
    return carray(pointer(at), work.whole.shape)


@part
def eliminate_whole(work, moved):
    """Fill work.r, the residuals of the nodes, from those of all coordinates in work.whole, at the displacements `moved`."""
    scene, x, r = work.scene, work.scene.relaxation, work.whole
    copy_matrix(r[: x.first], work.r)
    residuals = r.reshape(-1)[2 * x.first :]
    for body in range(x.start.shape[0] - 1):
        if x.terms[body] == x.terms[body + 1]:
            continue
        count, at, (first, end) = strains_of(x, body), x.start[body], pairs_of_body(scene, body)
        viscous_strain, strain = np.empty(count), np.empty(count)
        for k in range(x.terms[body], x.terms[body + 1]):
            factor = x.unit[body] * x.time[k] / (x.mass * (1.0 + work.rates[0] * x.time[k]))
            put(factor, residuals[at : at + count], work.strains[at : at + count])
            at += count
        for p in range(work.parts.shape[0]):
            viscous_strain[:], work.force[:], at = 0.0, 0.0, x.start[body]
            for k in range(x.terms[body], x.terms[body + 1]):
                add_real(viscous_strain, x.share[k], work.strains[at : at + count], p)
                at += count
            relax_body(scene, body, moved, None, viscous_strain, work.force, strain)
            for i in range(first, end):
                work.r[i, 0] -= work.parts[p] * work.force[i, 0]
                work.r[i, 1] -= work.parts[p] * work.force[i, 1]
    return DONE


@part
def recover_whole(work, moved):
    """Fill the corrections of the strains in work.whole, from those of the nodes there, at the displacements `moved`."""
    scene, x, dq = work.scene, work.scene.relaxation, work.whole
    changes, c_v = dq.reshape(-1)[2 * x.first :], work.rates[1]
    for body in range(x.start.shape[0] - 1):
        if x.terms[body] == x.terms[body + 1]:
            continue
        count, (first, end) = strains_of(x, body), pairs_of_body(scene, body)
        strain = np.empty(count)
        for p in range(work.parts.shape[0]):
            for i in range(first, end):
                for k in range(2):
                    work.force[i, k] = dq[i, k].real if p == 0 else dq[i, k].imag
            change_strain(scene, body, moved, work.force, strain)
            at = x.start[body]
            for k in range(x.terms[body], x.terms[body + 1]):
                own = changes[at : at + count]
                if p == 0:
                    put(-1.0 / (x.unit[body] * c_v), work.strains[at : at + count], own)
                add_scaled(own, work.parts[p] / (x.unit[body] * c_v * (1.0 + work.rates[0] * x.time[k])), strain)
                at += count
    return DONE


FUNCTIONS = served(eliminate_whole, first=nodal), served(recover_whole, first=nodal)


@entry
def relaxation_energies(scene, moved, v):
    """(energy of relaxation beyond that of the strain E alone, J, the power that each body dissipates (bodies,), W).

    W = sum of E : D : E / 2 over the points with `g_0 E : D : E + sum g (E - x) : D : (E - x)` in place of E : D : E; the power is
    `sum g (E - x) : D : (E - x) / tau`.
    """
    x, speeds = scene.relaxation, v.reshape(-1)
    total, powers, none = 0.0, np.zeros(x.start.shape[0] - 1), np.zeros((x.first, 2))
    for b in range(powers.shape[0]):
        if x.terms[b] < x.terms[b + 1]:
            count, at = strains_of(x, b), 2 * x.first + x.start[b]
            strain, viscous_strain = np.empty(count), np.zeros(count)
            relax_body(scene, b, moved, None, viscous_strain, none, strain)
            for k in range(x.terms[b], x.terms[b + 1]):
                for j in range(count):
                    viscous_strain[j] = strain[j] - x.unit[b] * speeds[at + j]
                size = square(scene, b, viscous_strain)
                total += 0.5 * x.share[k] * (size - square(scene, b, strain))
                powers[b] += x.share[k] * size / x.time[k]
                at += count
    return total, powers


def stiffness_changes(model, c):
    """kappa - 1 of each body, (bodies,); c real or complex."""
    x = model.arrays.relaxation
    each = x.share / (1.0 + c * x.time)
    return np.array([-each[a:b].sum() for a, b in zip(x.terms, x.terms[1:])])


def relaxed_velocities(model, q):
    """The velocities (n,) of a model in the reference configuration whose strains have relaxed, x = E."""
    x, r = model.arrays.relaxation, np.zeros((model.n_nodes, 2))
    add_relaxation(model.arrays, q.reshape(-1, 2), None, np.zeros_like(r), 1.0, r)
    v, residuals, at = np.zeros(model.n), r.ravel(), 2 * x.first
    for placed in model.strains.values():
        for _, time in placed.terms:
            end = at + placed.padded
            v[at:end] = -time / x.mass * residuals[at:end]
            at = end
    return v


def slope_entries(model, q, c_v, c_q):
    """[(rows, columns, values)] of `c_v dr/dv + c_q dr/dq` of relaxation outside the blocks of the bodies."""
    x, parts = model.arrays.relaxation, []

    for b, body in enumerate(model.all_bodies):
        if x.terms[b] == x.terms[b + 1]:
            continue
        at, first, last = 2 * x.first + x.start[b], 2 * body.pairs.start, 2 * body.pairs.stop
        B, viscous_strains = (_strain_slopes if b < len(model.bodies) else _form_slopes)(model, b, q[first:last])
        B, viscous_strains = B.tocoo(), viscous_strains.tocoo()
        for k in range(x.terms[b], x.terms[b + 1]):
            rate, states = x.mass / x.time[k], at + np.arange(model.strains[body.name].padded)
            parts.append((viscous_strains.row + first, viscous_strains.col + at, -c_v * x.unit[b] * x.share[k] * viscous_strains.data))
            parts.append((B.row + at, B.col + first, -c_q * rate / x.unit[b] * B.data))
            parts.append((states, states, np.full(len(states), c_v * rate)))
            at += len(states)
    return parts


def _strain_slopes(model, b, q):
    """(B, B^T D) of full plate number b at its nodes' displacements q (2 nodes,), both sparse.

    B = dE/dq (3 points, 2 nodes), E at the points; D the moduli times weights of the points, so that B^T D e is the force of a strain e.
    """
    plates, body = model.arrays.plates, model.bodies[b]
    weights, gradients = body.operator.weights, model.once(gradient_operators, of_shape=True)[body.name]
    point = np.arange(len(weights))
    f11, f12, f21, f22 = ((gradients @ q).reshape(-1, 4) + (1.0, 0.0, 0.0, 1.0)).T
    e11 = 3 * LANES * (point // LANES) + point % LANES
    e12, e22, h = e11 + LANES, e11 + 2 * LANES, 4 * point
    changes = [(e11, h, f11), (e11, h + 2, f21), (e22, h + 1, f12), (e22, h + 3, f22)]
    changes += [(e12, h + k, 0.5 * f) for k, f in enumerate((f12, f11, f22, f21))]
    B = summed(changes, 3 * len(weights), 4 * len(weights)) @ gradients
    w, nu = plates.membrane_stiffness[b] * weights, plates.body_nu[b]
    moduli = [(e11, e11, w), (e22, e22, w), (e11, e22, nu * w), (e22, e11, nu * w), (e12, e12, 2.0 * (1.0 - nu) * w)]
    return B, B.T @ summed(moduli, 3 * len(weights))


def _form_slopes(model, body, q):
    """(B, B^T D) of a reduced plate at its displacements q, both sparse: B = dy/dq (strains, pairs x 2), D its form, (strains, strains).

    body: its number, as in Relaxation, full plates first. The columns of the first pair are zero.
    """
    from scipy.sparse import csr_array

    placed = model.reduced_bodies[body - len(model.bodies)]
    form, z = placed.form[0], pairs_of(placed.rest) + q.reshape(-1, 2)
    slopes = np.zeros((len(form), len(q) - 2))
    reduced_kernels.add_y_jacobian(len(z) - 1, z[1:], 1.0, slopes)
    B = np.hstack([np.zeros((len(form), 2)), slopes])
    return csr_array(B), csr_array(B.T @ form)


def gradient_operators(model):
    """{plate: H of its points as a linear function of its nodes' displacements, (4 weights, 2 nodes), sparse} of viscoelastic plates, reduced ones too."""
    from scipy.sparse import coo_array

    operators = {}
    for body in model.drawn:
        if body.name not in model.strains:
            continue
        o, rows, columns, values = body.operator, [], [], []
        for m, points, corners, gradients, weights, _ in o.layout:
            nodes = o.corners[corners : corners + m * LANES].reshape(m, LANES)
            own = o.gradients[gradients : gradients + 2 * points * (m - 1) * LANES].reshape(points, m - 1, 2, LANES)
            G = np.concatenate([own, -own.sum(axis=1, keepdims=True)], axis=1)
            at = (weights + LANES * np.arange(points))[:, None, None, None] + np.arange(LANES)
            for a in range(2):  # H_ak = sum of u_a G_k
                for k in range(2):
                    rows.append(np.broadcast_to(4 * at[:, :, 0] + 2 * a + k, (points, m, LANES)).ravel())
                    columns.append(np.broadcast_to(2 * nodes + a, (points, m, LANES)).ravel())
                    values.append(G[:, :, k].ravel())
        shape = 4 * len(o.weights), 2 * o.n_nodes
        operators[body.name] = coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape).tocsr()
    return operators


def fields_at_points(model):
    """{reduced plate: derivatives of its fields in x and y at the points, (points, 2, fields), complex} of viscoelastic ones."""
    gradients, result = model.once(gradient_operators, of_shape=True), {}
    for placed in model.reduced_bodies:
        if placed.name in gradients:
            fields = placed.body.shapes()[:, 1:]
            real = gradients[placed.name] @ np.stack([fields.real, fields.imag], axis=1).reshape(-1, fields.shape[1])
            result[placed.name] = np.tensordot([1.0, 1j], real.reshape(-1, 2, 2, fields.shape[1]), (0, 1))
    return result


def viscous_strain_at_points(fields, viscous_strain):
    """The strains at the points (3 weights,) of a reduced plate that a change `viscous_strain` of its y means; fields: of `fields_at_points`."""
    count = fields.shape[2]
    products, upper = np.zeros((count, count), complex), np.triu_indices(count)
    products[upper] = viscous_strain[: len(upper[0])]
    products[np.triu_indices(count, 1)] += 1j * viscous_strain[len(upper[0]) :]
    products += np.triu(products, 1).conj().T
    e = 0.5 * np.einsum("pki,ij,plj->klp", fields.conj(), products, fields, optimize=True).real
    strains = np.stack([e[0, 0], 0.5 * (e[0, 1] + e[1, 0]), e[1, 1]])
    return strains.reshape(3, -1, LANES).transpose(1, 0, 2).ravel()
