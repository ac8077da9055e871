"""Slopes of the relaxation of viscoelastic plates as sparse matrices, and the strains of reduced ones at the points, with numpy.

Strains of a full plate lie in vectors of LANES points: E_11, then E_12, then E_22 of LANES points side by side. The derivatives H = du/dX
of a point are four numbers, H_11, H_12, H_21, H_22. relaxation.py has the equations.
"""

import numpy as np

from polyida.assembly import reduced_kernels
from polyida.jit.intrinsics import LANES
from polyida.linear.lu import summed
from polyida.validation import pairs_of


def slope_entries(model, q, c_v, c_q):
    """Return [(rows, columns, values)] of `c_v dr/dv + c_q dr/dq` of relaxation outside the blocks of the bodies."""
    x, entries = model.arrays.relaxation, []
    for b, body in enumerate(model.all_bodies):
        if x.terms[b] == x.terms[b + 1]:
            continue
        at, first, last = 2 * x.first + x.start[b], 2 * body.pairs.start, 2 * body.pairs.stop
        B, force_slopes = (_strain_slopes if b < len(model.bodies) else _form_slopes)(model, b, q[first:last])
        B, force_slopes = B.tocoo(), force_slopes.tocoo()
        for k in range(x.terms[b], x.terms[b + 1]):
            rate, states = x.mass / x.time[k], at + np.arange(model.strains[body.name].padded)
            # dr of the nodes / d strains
            entries.append((force_slopes.row + first, force_slopes.col + at, -c_v * x.unit[b] * x.share[k] * force_slopes.data))
            # d(rate of a strain) / dq
            entries.append((B.row + at, B.col + first, -c_q * rate / x.unit[b] * B.data))
            # d(rate of a strain) / d strain
            entries.append((states, states, np.full(len(states), c_v * rate)))
            at += len(states)
    return entries


def _strain_slopes(model, b, q):
    """Return (B, B^T D) of full plate b at its q, sparse; B = dE/dq, D: plane moduli times weights.

    With F = 1 + H and E = (F^T F - 1) / 2:

        dE_11 = F_11 dH_11 + F_21 dH_21
        dE_22 = F_12 dH_12 + F_22 dH_22
        dE_12 = (F_12 dH_11 + F_11 dH_12 + F_22 dH_21 + F_21 dH_22) / 2
    """
    plates, body = model.arrays.plates, model.bodies[b]
    weights, gradients = body.operator.weights, model.once(gradient_operators, of_shape=True)[body.name]
    point = np.arange(len(weights))
    f11, f12, f21, f22 = ((gradients @ q).reshape(-1, 4) + (1.0, 0.0, 0.0, 1.0)).T
    e11 = 3 * LANES * (point // LANES) + point % LANES
    e12, e22 = e11 + LANES, e11 + 2 * LANES
    h11, h12, h21, h22 = 4 * point, 4 * point + 1, 4 * point + 2, 4 * point + 3
    changes = [(e11, h11, f11), (e11, h21, f21), (e22, h12, f12), (e22, h22, f22)]
    changes += [(e12, h11, 0.5 * f12), (e12, h12, 0.5 * f11), (e12, h21, 0.5 * f22), (e12, h22, 0.5 * f21)]
    B = summed(changes, 3 * len(weights), 4 * len(weights)) @ gradients
    stiffness, nu = plates.membrane_stiffness[b] * weights, plates.body_nu[b]
    moduli = [(e11, e11, stiffness), (e22, e22, stiffness), (e11, e22, nu * stiffness), (e22, e11, nu * stiffness)]
    moduli.append((e12, e12, 2.0 * (1.0 - nu) * stiffness))
    return B, B.T @ summed(moduli, 3 * len(weights))


def _form_slopes(model, body, q):
    """Return (B, B^T D) of reduced plate `body` at its q, sparse; B = dy/dq, D: its form. The first pair of q moves it without strain."""
    from scipy.sparse import csr_array

    placed = model.reduced_bodies[body - len(model.bodies)]
    form, z = placed.form[0], pairs_of(placed.rest) + q.reshape(-1, 2)
    slopes = np.zeros((len(form), len(q) - 2))
    reduced_kernels.add_y_jacobian(len(z) - 1, z[1:], 1.0, slopes)
    B = np.hstack([np.zeros((len(form), 2)), slopes])
    return csr_array(B), csr_array(B.T @ form)


def gradient_operators(model):
    """Return {plate: matrix (4 points, 2 nodes), sparse} of viscoelastic plates, reduced ones too; H at the points = matrix displacements.

    H_ak = sum of u_a G_k over the nodes of a cell, G the gradients of the shape functions; the last one is minus the sum of the others.
    """
    from scipy.sparse import coo_array

    operators = {}
    for body in model.drawn:
        if body.name not in model.strains:
            continue
        operator, rows, columns, values = body.operator, [], [], []
        for m, points, corners, gradients, weights, _ in operator.layout:  # LANES cells of m nodes each
            nodes = operator.corners[corners : corners + m * LANES].reshape(m, LANES)
            own = operator.gradients[gradients : gradients + 2 * points * (m - 1) * LANES].reshape(points, m - 1, 2, LANES)
            G = np.concatenate([own, -own.sum(axis=1, keepdims=True)], axis=1)
            at = (weights + LANES * np.arange(points))[:, None, None, None] + np.arange(LANES)
            for a in range(2):
                for k in range(2):
                    rows.append(np.broadcast_to(4 * at[:, :, 0] + 2 * a + k, (points, m, LANES)).ravel())
                    columns.append(np.broadcast_to(2 * nodes + a, (points, m, LANES)).ravel())
                    values.append(G[:, :, k].ravel())
        shape = 4 * len(operator.weights), 2 * operator.n_nodes
        operators[body.name] = coo_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape).tocsr()
    return operators


def fields_at_points(model):
    """Return {reduced plate: derivatives of its fields in x and y at the points, (points, 2, fields), complex} of viscoelastic ones."""
    gradients, result = model.once(gradient_operators, of_shape=True), {}
    for placed in model.reduced_bodies:
        if placed.name in gradients:
            fields = placed.body.shapes()[:, 1:]
            real = gradients[placed.name] @ np.stack([fields.real, fields.imag], axis=1).reshape(-1, fields.shape[1])
            result[placed.name] = np.tensordot([1.0, 1j], real.reshape(-1, 2, 2, fields.shape[1]), (0, 1))
    return result


def viscous_strain_at_points(fields, viscous_strain):
    """Return the strains at the points of a reduced plate, (3 points,), of a change `viscous_strain` of its y.

    With y = products z_i* z_j of its coordinates and fields f_i: E_kl = sum of Re(f_i,k* f_j,l y_ij) / 2. fields: of `fields_at_points`.
    """
    count = fields.shape[2]
    products, upper = np.zeros((count, count), complex), np.triu_indices(count)
    products[upper] = viscous_strain[: len(upper[0])]
    products[np.triu_indices(count, 1)] += 1j * viscous_strain[len(upper[0]) :]
    products += np.triu(products, 1).conj().T
    e = 0.5 * np.einsum("pki,ij,plj->klp", fields.conj(), products, fields, optimize=True).real
    strains = np.stack([e[0, 0], 0.5 * (e[0, 1] + e[1, 0]), e[1, 1]])
    return strains.reshape(3, -1, LANES).transpose(1, 0, 2).ravel()
