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
CORNERS, POINTS, FIRST_CORNER, FIRST_GRADIENT, FIRST_WEIGHT = range(5)  # columns of Cells.layout, a row for each block of LANES cells
STRAIN, STRAIN_RATE, VIRTUAL = range(3)  # the fields E, E + viscosity E' and D
VALUE, BY_X, BY_Y = range(3)  # terms of a linear fit
FIELDS, TERMS, COMPONENTS = 3, 3, 3  # numbers of fields, of terms of a fit, and of components (xx, xy, yy) of a field


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
    """The cells with three points for each triangle, the linear fits to their neighbours, and scratch for the fields of a frame."""

    cells: Cells  # of the ReferenceOperator with three points
    lane_cells: np.ndarray  # (blocks LANES,) number of the cell in each lane
    places: np.ndarray  # (points, 2, LANES) of its points from the cells' centroids, m
    near: np.ndarray  # (cells + 1,) the first of the neighbours of a cell, itself included
    neighbours: np.ndarray  # (near[-1],) numbers of cells
    shares: np.ndarray  # (near[-1], TERMS) share of the mean of a neighbour in the terms of the cell's fit
    fields: np.ndarray  # (points, FIELDS, COMPONENTS, LANES) of a frame
    means: np.ndarray  # (cells, FIELDS, COMPONENTS) of the fields


@fast
def field_at(point, field):
    """Position of a field at a point in the flat Fits.fields."""
    return (FIELDS * point + field) * COMPONENTS * LANES


@fast
def fit_at(field, term, component):
    """Position of a component of a term of the fit to a field, in the flat fit (FIELDS, TERMS, COMPONENTS, LANES)."""
    return ((field * TERMS + term) * COMPONENTS + component) * LANES


@entry
def cell_errors(fits, material, displacements, velocities, multipliers, factor, out):
    """out (2, cells) += the parts with three points of one frame: those of the fields, and of the gaps to the fits.

    displacements, velocities, multipliers w (nodes, 2). factor: dJ/dW.
    """
    evaluate_fields(fits, material, displacements, velocities, multipliers)
    add_errors(fits, material, factor, out)


@fast
def evaluate_fields(fits, material, displacements, velocities, multipliers):
    """Fill fits.fields with E, E + viscosity E' and D at the points, and fits.means with their means over the cells.

    displacements, velocities, multipliers w (nodes, 2). A mean is `sum weight field / sum weight` over the points of a cell.
    """
    cells, lane_cells, fields = fits.cells, fits.lane_cells, fits.fields
    differences, sums = _workspace(cells.layout, 6, 0), np.empty(FIELDS * COMPONENTS * LANES)
    point = 0
    for b in range(cells.layout.shape[0]):
        count, first = cells.layout[b, CORNERS] - 1, cells.layout[b, FIRST_CORNER]  # corners but the last, to which differences are taken
        size, total = 2 * count * LANES, spread(0.0)
        of_w, of_v = differences[size:], differences[2 * size :]
        _differences(displacements, cells.corners, first, 0, count, differences)
        _differences(multipliers, cells.corners, first, 0, count, of_w)
        if material.viscosity != 0.0:
            _differences(velocities, cells.corners, first, 0, count, of_v)
        sums[:] = 0.0
        for p in range(cells.layout[b, POINTS]):
            at = cells.layout[b, FIRST_GRADIENT] + p * size
            weight = load(cells.weights, cells.layout[b, FIRST_WEIGHT] + p * LANES)
            h, d = _gradient(cells.gradients, at, differences, count), _gradient(cells.gradients, at, of_w, count)
            e, virtual = elastic_strain(h), turned(h, d)
            rate = rate_strain(h, _gradient(cells.gradients, at, of_v, count), material.viscosity) if material.viscosity != 0.0 else e
            store(fields, field_at(point, STRAIN), e)
            store(fields, field_at(point, STRAIN_RATE), rate)
            store(fields, field_at(point, VIRTUAL), virtual)
            store(sums, field_at(0, STRAIN), add_weighted(load3(sums, field_at(0, STRAIN)), weight, e))
            store(sums, field_at(0, STRAIN_RATE), add_weighted(load3(sums, field_at(0, STRAIN_RATE)), weight, rate))
            store(sums, field_at(0, VIRTUAL), add_weighted(load3(sums, field_at(0, VIRTUAL)), weight, virtual))
            total = sum_of(total, weight)
            point += 1
        for k in range(LANES):
            if lane(total, k) > 0.0:
                for i in range(FIELDS * COMPONENTS):
                    fits.means[lane_cells[b * LANES + k], i // COMPONENTS, i % COMPONENTS] = sums[i * LANES + k] / lane(total, k)


@fast
def fit_gap(fit, field, place, x):
    """How far the fit to a field is above the field's value x at a place, (xx, xy, yy)."""
    value, by_x, by_y = load3(fit, fit_at(field, VALUE, 0)), load3(fit, fit_at(field, BY_X, 0)), load3(fit, fit_at(field, BY_Y, 0))
    return gap(value, by_x, by_y, place, x)


@fast
def add_errors(fits, material, factor, out):
    """Add the works of the fields and of their gaps to the fits to out (2, cells). factor: dJ/dW.

    out[0] += [S : D]_3 + dJ/dW 1/2 [E : C : E]_3
    out[1] -= [(S* - S) : (D* - D)]_3 + dJ/dW 1/2 [(E* - E) : C : (E* - E)]_3
    """
    cells, lane_cells, fields = fits.cells, fits.lane_cells, fits.fields
    (lam_bar, two_mu), fit = lame(material), np.empty(FIELDS * TERMS * COMPONENTS * LANES)
    point = 0
    for b in range(cells.layout.shape[0]):
        total, gaps = spread(0.0), spread(0.0)
        fill_fit(fits, b, fit)
        for p in range(cells.layout[b, POINTS]):
            weight = load(cells.weights, cells.layout[b, FIRST_WEIGHT] + p * LANES)
            place = load2(fits.places, 2 * point * LANES)
            rate, virtual = load3(fields, field_at(point, STRAIN_RATE)), load3(fields, field_at(point, VIRTUAL))
            rate_gap, virtual_gap = fit_gap(fit, STRAIN_RATE, place, rate), fit_gap(fit, VIRTUAL, place, virtual)
            total = add_work(total, weight, rate, virtual, lam_bar, two_mu)
            gaps = add_work(gaps, weight, rate_gap, virtual_gap, -lam_bar, -two_mu)
            if factor != 0.0:
                half, e = 0.5 * factor, load3(fields, field_at(point, STRAIN))
                strain_gap = fit_gap(fit, STRAIN, place, e)
                total = add_work(total, weight, e, e, half * lam_bar, half * two_mu)
                gaps = add_work(gaps, weight, strain_gap, strain_gap, -half * lam_bar, -half * two_mu)
            point += 1
        for k in range(LANES):
            out[0, lane_cells[b * LANES + k]] += lane(total, k)
            out[1, lane_cells[b * LANES + k]] += lane(gaps, k)


@fast
def fill_fit(fits, block, fit):
    """Fill fit (FIELDS, TERMS, COMPONENTS, LANES), flat, with the linear fits of the cells of a block: `sum over neighbours share mean`."""
    fit[:] = 0.0
    for k in range(LANES):
        cell = fits.lane_cells[block * LANES + k]
        for n in range(fits.near[cell], fits.near[cell + 1]):
            for field in range(FIELDS):
                for component in range(COMPONENTS):
                    mean = fits.means[fits.neighbours[n], field, component]
                    for term in range(TERMS):
                        fit[fit_at(field, term, component) + k] += fits.shares[n, term] * mean


class MeshError:
    """The shares of the cells of a plate in the error of its mesh. body: the placed plate."""

    def __init__(self, body):
        """Build the cells with three points and the fits to their neighbours."""
        self.body = body
        mesh = body.mesh
        modulus, nu = body.plate.material.in_plane
        self.stiffness = body.plate.thickness * modulus / (1 - nu**2)  # N/m, at factor 1
        self.nu = nu
        three = build(mesh, wachspress_of_three)
        places, numbers = [], three.lane_cells.reshape(-1, LANES)
        for cells, n in zip(numbers, three.layout[:, CORNERS].tolist()):
            corners = mesh.points[mesh.nodes[mesh.offsets[cells] + np.arange(n)[:, None]]].transpose(0, 2, 1)
            near, _, centroid = fan_points(corners)
            places.append(near - centroid)
        places = np.ascontiguousarray(np.concatenate(places))
        scratch = np.empty((len(places), 3, 3, LANES)), np.empty((mesh.n_cells, 3, 3))
        self.fits = Fits(three.cells(), three.lane_cells, places, *_fits(mesh), *scratch)
        self.three = np.zeros((2, mesh.n_cells))  # out of `cell_errors`
        self.of_energy = np.zeros(mesh.n_cells)  # 1/2 dJ/dW [E : C : E]_element
        self.of_element = np.zeros(len(body.operator.lane_cells))  # [S : D]_element of the cell in each lane

    def add(self, q, v, w, factor):
        """Add states q, v and multipliers w of the model, (count, pairs, 2), with dJ/dW (count,)."""
        body, operator, viscosity = self.body, self.body.operator, self.body.plate.material.viscosity
        cells = operator.cells()
        of_operator = Material(self.stiffness, self.nu, viscosity)  # the operator's weights hold the factors of the cells
        with_factor = Material(self.stiffness * float(body.factors[0][0]), self.nu, viscosity)
        for u, speeds, multipliers, f in zip(*(np.ascontiguousarray(x[:, body.nodes]) for x in (q, v, w)), factor.tolist()):
            cell_errors(self.fits, with_factor, u, speeds, multipliers, f, self.three)
            cell_products.force_work(cells, of_operator, u, speeds, multipliers[None], self.of_element[None])
            if f:
                add_cell_energies(cells, operator.lane_cells, of_operator, u, f, self.of_energy)

    @property
    def parts(self):
        """Shares of the cells from their integration, and from the gaps to the fits, (2, cells)."""
        of_element = np.bincount(self.body.operator.lane_cells, self.of_element, self.three.shape[1])
        return self.three - np.stack([of_element + self.of_energy, np.zeros_like(of_element)])


def _fits(mesh):
    """(first neighbour of each cell (cells + 1,), neighbours, their shares (., 3) in value and slopes of the linear fit of a cell)."""
    # neighbours of a cell: the cells with a common edge, and itself
    cell = topology.corner_cells(mesh.offsets)
    ends = np.sort(topology.directed_edges(mesh.nodes, mesh.offsets), axis=1).astype(np.int64)
    _, edge = np.unique(ends[:, 0] * mesh.n_nodes + ends[:, 1], return_inverse=True)
    incidence = csr_array((np.ones(len(cell)), (cell, edge)))
    pattern = csr_array(incidence @ incidence.T)
    pattern.sort_indices()
    counts, shares = np.diff(pattern.indptr), np.empty((len(pattern.indices), 3))
    # for all cells with n neighbours: the pseudo-inverse of the rows `weight^(1/2) (1, x, y)` of the neighbours' centroids
    for n in np.unique(counts):
        own = np.flatnonzero(counts == n)
        at = pattern.indptr[own][:, None] + np.arange(n)
        others = pattern.indices[at]
        roots = np.sqrt(np.where(others == own[:, None], OWN, 1.0))
        apart = mesh.cell_centroids[others] - mesh.cell_centroids[own][:, None]
        matrix = np.concatenate([np.ones((*others.shape, 1)), apart], axis=2)
        shares[at] = np.swapaxes(np.linalg.pinv(roots[..., None] * matrix) * roots[:, None], 1, 2)
    return pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64), shares
