"""Error of a quantity of a run from the meshes of full plates of Wachspress elements, as a sum over cells.

Wachspress cells are not Galerkin: one point for each triangle of the fan integrates their strain energy too small, which cancels most of the error
of their stiffness. With w the multipliers of r, E Green's strain, D = sym(F^T grad w), S = C : (E + viscosity E'), the run put into the
equations of an elastic plate leaves, for each step,

    -[(S* - S) : (D* - D)]_3  +  [S : D]_3  -  [S : D]_element

[.]_3: integral over a cell with three points for each triangle and the gradients of the shape functions there, shifted to their exact mean;
*: the linear fit, by least squares, to the means of the cell and of its neighbours. Where J is of the strain energy W, dJ/dW times
`1/2 [E : C : E]_3 - 1/2 [E : C : E]_element - 1/2 [(E* - E) : C : (E* - E)]_3` is added.
"""

import numpy as np
from scipy.sparse import csr_array

from polyida.element import cell_products
from polyida.element.elements import fan_points, wachspress_of_three
from polyida.element.operator import build
from polyida.jit import entry, part
from polyida.jit.intrinsics import LANES
from polyida.mesh import topology
from polyida.objective.peak_stress import add_cell_energies

OWN = 3.0  # weight of the cell itself in a fit; its neighbours have 1


@part
def differences(corners, first, m, x, out):
    """out (m, 2, LANES): x at the corners of a block of cells, less that at their last corner."""
    for i in range(m):
        for a in range(2):
            for k in range(LANES):
                out[i, a, k] = x[corners[first + i * LANES + k], a] - x[corners[first + m * LANES + k], a]


@part
def gradient(gradients, start, m, apart, h):
    """h (4, LANES) = dx/dX at one point."""
    h[:] = 0.0
    for i in range(m):
        g = start + 2 * i * LANES
        for k in range(LANES):
            x, y = gradients[g + k], gradients[g + LANES + k]
            h[0, k] += apart[i, 0, k] * x
            h[1, k] += apart[i, 0, k] * y
            h[2, k] += apart[i, 1, k] * x
            h[3, k] += apart[i, 1, k] * y


@part
def symmetric(h, share, d, out):
    """out (3, LANES) = sym((I + share H)^T D) as (11, 22, 2 12)."""
    for k in range(LANES):
        f11, f12, f21, f22 = 1.0 + share * h[0, k], share * h[1, k], share * h[2, k], 1.0 + share * h[3, k]
        out[0, k] = f11 * d[0, k] + f21 * d[2, k]
        out[1, k] = f12 * d[1, k] + f22 * d[3, k]
        out[2, k] = f11 * d[1, k] + f21 * d[3, k] + f12 * d[0, k] + f22 * d[2, k]


@part
def add_work(c, nu, weight, sign, x, y, total):
    """total (LANES,) += sign weight x : C : y."""
    for k in range(LANES):
        normal = x[0, k] * y[0, k] + x[1, k] * y[1, k] + nu * (x[0, k] * y[1, k] + x[1, k] * y[0, k])
        total[k] += sign * weight[k] * c * (normal + 0.5 * (1.0 - nu) * x[2, k] * y[2, k])


@part
def gaps(fit, place, value, out):
    """out (3, LANES) = what linear fits (3, 3, LANES), their values and slopes for each component, are above the values at places (2, LANES)."""
    for i in range(3):
        for k in range(LANES):
            out[i, k] = fit[0, i, k] + fit[1, i, k] * place[0, k] + fit[2, i, k] * place[1, k] - value[i, k]


@entry
def cell_errors(layout, corners, gradients, weights, cells, places, near, neighbours, shares, c, nu, viscosity, u, v, w, factor, work, out):
    """out (cells,) += the parts with three points of one frame.

    layout, corners, gradients, weights, cells: of the ReferenceOperator with three points; places (points, 2, LANES); near (cells + 1,): first of
    the neighbours of a cell and of their shares (., 3) in its fit. u, v, w (nodes, 2). factor: dJ/dW. work: (points, 3, 3, LANES) of E, E + viscosity
    E' and D, and (cells, 3, 3) of their means.
    """
    fields, means = work
    most = 0
    for b in range(layout.shape[0]):
        most = max(most, layout[b, 0])
    du, dv, dw, h, d = (np.empty((most, 2, LANES)), np.empty((most, 2, LANES)), np.empty((most, 2, LANES)), np.empty((4, LANES)), np.empty((4, LANES)))
    fit, sums, x, y, total = np.empty((3, 3, 3, LANES)), np.empty((3, 3, LANES)), np.empty((3, LANES)), np.empty((3, LANES)), np.empty(LANES)
    at = 0
    for b in range(layout.shape[0]):
        m, start, weight = layout[b, 0] - 1, layout[b, 3], layout[b, 4]
        differences(corners, layout[b, 2], m, u, du)
        differences(corners, layout[b, 2], m, w, dw)
        if viscosity != 0.0:
            differences(corners, layout[b, 2], m, v, dv)
        sums[:], total[:] = 0.0, 0.0
        for p in range(layout[b, 1]):
            one = fields[at]
            gradient(gradients, start + 2 * p * m * LANES, m, du, h)
            symmetric(h, 0.5, h, one[0])
            one[1] = one[0]
            if viscosity != 0.0:
                gradient(gradients, start + 2 * p * m * LANES, m, dv, d)
                symmetric(h, 1.0, d, x)
                one[1] += viscosity * x
            gradient(gradients, start + 2 * p * m * LANES, m, dw, d)
            symmetric(h, 1.0, d, one[2])
            for k in range(LANES):
                total[k] += weights[weight + p * LANES + k]
            for f in range(3):
                for i in range(3):
                    for k in range(LANES):
                        sums[f, i, k] += weights[weight + p * LANES + k] * one[f, i, k]
            at += 1
        for k in range(LANES):
            if total[k] > 0.0:
                means[cells[b * LANES + k]] = sums[:, :, k] / total[k]
    at = 0
    for b in range(layout.shape[0]):
        fit[:], total[:] = 0.0, 0.0
        for k in range(LANES):
            for n in range(near[cells[b * LANES + k]], near[cells[b * LANES + k] + 1]):
                for f in range(3):
                    for j in range(3):
                        for i in range(3):
                            fit[f, j, i, k] += shares[n, j] * means[neighbours[n], f, i]
        for p in range(layout[b, 1]):
            one, weight = fields[at], weights[layout[b, 4] + p * LANES : layout[b, 4] + (p + 1) * LANES]
            gaps(fit[1], places[at], one[1], x)
            gaps(fit[2], places[at], one[2], y)
            add_work(c, nu, weight, 1.0, one[1], one[2], total)
            add_work(c, nu, weight, -1.0, x, y, total)
            if factor != 0.0:
                gaps(fit[0], places[at], one[0], x)
                add_work(c, nu, weight, 0.5 * factor, one[0], one[0], total)
                add_work(c, nu, weight, -0.5 * factor, x, x, total)
            at += 1
        for k in range(LANES):
            out[cells[b * LANES + k]] += total[k]


class MeshError:
    """The shares of the cells of a plate, `cells` (cells,), in the error of its mesh. body: the placed plate."""

    def __init__(self, body):
        mesh, self.body = body.mesh, body
        modulus, nu = body.plate.material.in_plane
        self.moduli = body.plate.thickness * modulus / (1 - nu**2), nu
        self.fine = three = build(mesh, wachspress_of_three)
        places, numbers = [], three.lane_cells.reshape(-1, LANES)
        for cells, (n, points) in zip(numbers, three.layout[:, :2].tolist()):
            corners = mesh.points[mesh.nodes[mesh.offsets[cells] + np.arange(n)[:, None]]].transpose(0, 2, 1)
            near, _, centroid = fan_points(corners)
            places.append(near - centroid)
        self.places, self.fit = np.ascontiguousarray(np.concatenate(places)), _fits(mesh)
        self.work = np.empty((len(self.places), 3, 3, LANES)), np.empty((mesh.n_cells, 3, 3))
        self.three, self.of_energy = np.zeros((2, mesh.n_cells))
        self.of_element = np.zeros(len(body.operator.lane_cells))

    def add(self, q, v, w, factor):
        """Add states q, v and multipliers w of the model, (count, pairs, 2), with dJ/dW (count,)."""
        body, o, (c, nu), viscosity = self.body, self.body.operator, self.moduli, self.body.plate.material.viscosity
        arrays = *self.fine.force_arrays, self.fine.lane_cells, self.places, *self.fit, c * float(body.factors[0][0]), nu, viscosity
        for u, speed, now, f in zip(*(np.ascontiguousarray(x[:, body.nodes]) for x in (q, v, w)), factor.tolist()):
            cell_errors(*arrays, u, speed, now, f, self.work, self.three)
            cell_products.force_work(*o.force_arrays, 0, c, nu, viscosity, u, speed, now, self.of_element)
            if f:
                add_cell_energies(*o.force_arrays, o.lane_cells, c, nu, u, f, self.of_energy)

    @property
    def cells(self):
        """The shares."""
        return self.three - self.of_energy - np.bincount(self.body.operator.lane_cells, self.of_element, len(self.three))


def _fits(mesh):
    """(first neighbour of each cell (cells + 1,), neighbours, their shares (., 3) in value and slopes of the linear fit of a cell)."""
    cell = topology.corner_cells(mesh.offsets)
    ends = np.sort(topology.directed_edges(mesh.nodes, mesh.offsets), axis=1).astype(np.int64)
    _, edge = np.unique(ends[:, 0] * mesh.n_nodes + ends[:, 1], return_inverse=True)
    incidence = csr_array((np.ones(len(cell)), (cell, edge)))
    pattern = csr_array(incidence @ incidence.T)
    pattern.sort_indices()
    counts, shares = np.diff(pattern.indptr), np.empty((len(pattern.indices), 3))
    for n in np.unique(counts):
        own = np.flatnonzero(counts == n)
        at = pattern.indptr[own][:, None] + np.arange(n)
        others = pattern.indices[at]
        roots = np.sqrt(np.where(others == own[:, None], OWN, 1.0))
        apart = mesh.cell_centroids[others] - mesh.cell_centroids[own][:, None]
        matrix = np.concatenate([np.ones((*others.shape, 1)), apart], axis=2)
        shares[at] = np.swapaxes(np.linalg.pinv(roots[..., None] * matrix) * roots[:, None], 1, 2)
    return pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64), shares
