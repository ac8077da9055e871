"""Error of a quantity of a run from the meshes of full plates of Wachspress elements, as a sum over cells.

Wachspress cells are not Galerkin: one point for each triangle of the fan integrates their strain energy too small, which cancels most of
the error of their stiffness. With w the multipliers of r, E Green's strain, D = sym(F^T grad w), S = C : (E + viscosity E'), the run put
into the equations of an elastic plate leaves, for each step,

    -[(S* - S) : (D* - D)]_3  +  [S : D]_3  -  [S : D]_element

[.]_3: integral over a cell with three points for each triangle and the gradients of the shape functions there, shifted to their exact mean;
*: the linear fit, by least squares, to the means of the cell and of its neighbours. Where J is of the strain energy W, dJ/dW times
`1/2 [E : C : E]_3 - 1/2 [E : C : E]_element - 1/2 [(E* - E) : C : (E* - E)]_3` is added.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array

from polyida.element import cell_products
from polyida.element.cell_products import symmetric_part
from polyida.element.elements import fan_points, wachspress_of_three
from polyida.element.kernels import _differences, _gradient, _workspace, lame
from polyida.element.material import second_piola, strain, two_state_strain
from polyida.element.operator import Cells, Material, build
from polyida.jit import entry, fast
from polyida.jit.intrinsics import LANES, lane, load, load2, load3, spread, store, traced
from polyida.mesh import topology
from polyida.objective.peak_stress import add_cell_energies

OWN = 3.0  # weight of the cell itself in a fit; its neighbours have 1


@traced(3)
def rate_strain(h, d, viscosity):
    """Strain plus viscosity times its rate, `E + viscosity E'`, as (xx, xy, yy), of a displacement gradient h and its rate d."""
    return two_state_strain(h, d, viscosity, 0.0)


@traced(3)
def elastic_strain(h):
    """Green-Lagrange strain E, as (xx, xy, yy), of a displacement gradient h."""
    return strain(h)


@traced(3)
def turned(h, d):
    """The change `sym(F^T D)` of the strain along D, F = I + H, as (xx, xy, yy)."""
    return symmetric_part(h, d)


@traced(3)
def add_weighted(total, weight, x):
    """The sum `total + weight x` of tuples, entry by entry."""
    return tuple(t + weight * y for t, y in zip(total, x))


@traced(3)
def gap(value, by_x, by_y, place, x):
    """How far a linear field is above x at a place."""
    return tuple(v + a * place[0] + b * place[1] - y for v, a, b, y in zip(value, by_x, by_y, x))


@traced(1)
def sum_of(x, y):
    """The sum `x + y` of two values in lanes."""
    return x + y


@traced(1)
def add_work(total, weight, x, y, lam_bar, two_mu):
    """total + weight x : C : y."""
    s11, s12, s22 = second_piola(x, lam_bar, two_mu)
    return total + weight * (s11 * y[0] + s22 * y[2] + 2.0 * s12 * y[1])


class Fits(NamedTuple):
    """The cells with three points and the linear fits to their neighbours.

    cells, lane_cells: of the ReferenceOperator; places (points, 2, LANES): of its points from the cells' centroids; near (cells + 1,):
    first of the neighbours of a cell and of their shares (., 3) in its fit. fields (points, 3, 3, LANES): E, E + viscosity E' and D of a
    frame; means (cells, 3, 3): of these.
    """

    cells: Cells
    lane_cells: np.ndarray
    places: np.ndarray
    near: np.ndarray
    neighbours: np.ndarray
    shares: np.ndarray
    fields: np.ndarray
    means: np.ndarray


@entry
def cell_errors(fits, material, displacements, velocities, multipliers, factor, out):
    """out (2, cells) += the parts with three points of one frame: those of the fields, and of the gaps to the fits.

    displacements, velocities, multipliers w (nodes, 2). factor: dJ/dW.
    """
    evaluate_fields(fits, material, displacements, velocities, multipliers)
    add_errors(fits, material, factor, out)


@fast
def evaluate_fields(fits, material, displacements, velocities, multipliers):
    """Fill fits.fields with E, E + viscosity E' and D at the points, and fits.means with their means over the cells."""
    cells, lane_cells, fields, third, at = fits.cells, fits.lane_cells, fits.fields, 3 * LANES, 0
    differences, sums = _workspace(cells.layout, 6, 0), np.empty(9 * LANES)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        size, total = 2 * m * LANES, spread(0.0)
        of_w, of_v = differences[size:], differences[2 * size :]
        _differences(displacements, cells.corners, first, 0, m, differences)
        _differences(multipliers, cells.corners, first, 0, m, of_w)
        if material.viscosity != 0.0:
            _differences(velocities, cells.corners, first, 0, m, of_v)
        sums[:] = 0.0
        for p in range(cells.layout[b, 1]):
            g, weight = cells.layout[b, 3] + p * size, load(cells.weights, cells.layout[b, 4] + p * LANES)
            h, d = _gradient(cells.gradients, g, differences, m), _gradient(cells.gradients, g, of_w, m)
            e, slope = elastic_strain(h), turned(h, d)
            moving = rate_strain(h, _gradient(cells.gradients, g, of_v, m), material.viscosity) if material.viscosity != 0.0 else e
            store(fields, 3 * at * third, e)
            store(fields, (3 * at + 1) * third, moving)
            store(fields, (3 * at + 2) * third, slope)
            store(sums, 0, add_weighted(load3(sums, 0), weight, e))
            store(sums, third, add_weighted(load3(sums, third), weight, moving))
            store(sums, 2 * third, add_weighted(load3(sums, 2 * third), weight, slope))
            total = sum_of(total, weight)
            at += 1
        for k in range(LANES):
            if lane(total, k) > 0.0:
                for i in range(9):
                    fits.means[lane_cells[b * LANES + k], i // 3, i % 3] = sums[i * LANES + k] / lane(total, k)


@fast
def add_errors(fits, material, factor, out):
    """Add the works of the fields and of their gaps to the fits to out (2, cells). factor: dJ/dW."""
    cells, lane_cells, fields, third, at = fits.cells, fits.lane_cells, fits.fields, 3 * LANES, 0
    (lam_bar, two_mu), fit = lame(material), np.empty(27 * LANES)
    for b in range(cells.layout.shape[0]):
        total, gaps = spread(0.0), spread(0.0)
        fill_fit(fits, b, fit)
        for p in range(cells.layout[b, 1]):
            weight, place = load(cells.weights, cells.layout[b, 4] + p * LANES), load2(fits.places, 2 * at * LANES)
            e, x, y = load3(fields, 3 * at * third), load3(fields, (3 * at + 1) * third), load3(fields, (3 * at + 2) * third)
            over_x = gap(load3(fit, 3 * third), load3(fit, 4 * third), load3(fit, 5 * third), place, x)
            over_y = gap(load3(fit, 6 * third), load3(fit, 7 * third), load3(fit, 8 * third), place, y)
            total = add_work(total, weight, x, y, lam_bar, two_mu)
            gaps = add_work(gaps, weight, over_x, over_y, -lam_bar, -two_mu)
            if factor != 0.0:
                half, over_e = 0.5 * factor, gap(load3(fit, 0), load3(fit, third), load3(fit, 2 * third), place, e)
                total = add_work(total, weight, e, e, half * lam_bar, half * two_mu)
                gaps = add_work(gaps, weight, over_e, over_e, -half * lam_bar, -half * two_mu)
            at += 1
        for k in range(LANES):
            out[0, lane_cells[b * LANES + k]] += lane(total, k)
            out[1, lane_cells[b * LANES + k]] += lane(gaps, k)


@fast
def fill_fit(fits, block, fit):
    """Fill fit, (3 fields, value and two slopes, 3 components, LANES), with the linear fits of the cells of a block."""
    fit[:] = 0.0
    for k in range(LANES):
        cell = fits.lane_cells[block * LANES + k]
        for n in range(fits.near[cell], fits.near[cell + 1]):
            for i in range(9):
                x = fits.means[fits.neighbours[n], i // 3, i % 3]
                for j in range(3):
                    fit[((i // 3 * 3 + j) * 3 + i % 3) * LANES + k] += fits.shares[n, j] * x


class MeshError:
    """The shares of the cells of a plate in the error of its mesh. body: the placed plate."""

    def __init__(self, body):
        """Build the cells with three points and the fits to their neighbours."""
        mesh, self.body = body.mesh, body
        modulus, nu = body.plate.material.in_plane
        self.moduli = body.plate.thickness * modulus / (1 - nu**2), nu
        three = build(mesh, wachspress_of_three)
        places, numbers = [], three.lane_cells.reshape(-1, LANES)
        for cells, n in zip(numbers, three.layout[:, 0].tolist()):
            corners = mesh.points[mesh.nodes[mesh.offsets[cells] + np.arange(n)[:, None]]].transpose(0, 2, 1)
            near, _, centroid = fan_points(corners)
            places.append(near - centroid)
        places = np.ascontiguousarray(np.concatenate(places))
        scratch = np.empty((len(places), 3, 3, LANES)), np.empty((mesh.n_cells, 3, 3))
        self.fits = Fits(three.cells(), three.lane_cells, places, *_fits(mesh), *scratch)
        self.three = np.zeros((2, mesh.n_cells))
        self.of_energy = np.zeros(mesh.n_cells)
        self.of_element = np.zeros(len(body.operator.lane_cells))

    def add(self, q, v, w, factor):
        """Add states q, v and multipliers w of the model, (count, pairs, 2), with dJ/dW (count,)."""
        body, o, (c, nu), viscosity = self.body, self.body.operator, self.moduli, self.body.plate.material.viscosity
        cells, material, whole = o.cells(), Material(c, nu, viscosity), Material(c * float(body.factors[0][0]), nu, viscosity)
        for u, speed, now, f in zip(*(np.ascontiguousarray(x[:, body.nodes]) for x in (q, v, w)), factor.tolist()):
            cell_errors(self.fits, whole, u, speed, now, f, self.three)
            cell_products.force_work(cells, material, u, speed, now[None], self.of_element[None])
            if f:
                add_cell_energies(cells, o.lane_cells, material, u, f, self.of_energy)

    @property
    def parts(self):
        """Shares of the cells from their integration, and from the gaps to the fits, (2, cells)."""
        of_element = np.bincount(self.body.operator.lane_cells, self.of_element, self.three.shape[1])
        return self.three - np.stack([of_element + self.of_energy, np.zeros_like(of_element)])


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
