"""The adjoint of viscoelastic plates: products with the matrices of relaxation, its transposed elimination, and slopes in Prony series.

In the notation of assembly/relaxation.py, r_u and r_x the residuals of nodes and relaxed strains, with `E' = B u'`:

    dr_u/du = geometric stiffness of the stress -D : sum g x,   dr_u/dv_x = -unit g B^T D,
    dr_x/du = -mass / (tau unit) B,                             dr_x/dv_x = mass / tau

With `S = c_m M + c_v C + K` and c = c_m/c_v the solution of `S^T w = right` is that of the nodes' matrix, D -> kappa D, which is symmetric:

    right_u += B^T sum right_x / (unit c_v (1 + c tau)),   w_x = tau / (mass c_v (1 + c tau)) (right_x + c_v unit g D B w_u)
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from polyida.adjoint.parameter import PartParameter
from polyida.assembly import reduced_kernels
from polyida.assembly.arrays import cells_of, material_of
from polyida.assembly.equilibrium import hold_strains
from polyida.assembly.factors import CellContributions
from polyida.assembly.relaxation import add_real, add_scaled, pairs_of_body, relax_body, strains_of, take_viscous_strain
from polyida.body.body import Body
from polyida.body.plate import Plate
from polyida.element.relaxation import relaxation_products
from polyida.jit import entry, part, shared
from polyida.jit.intrinsics import LANES


@shared
def multiply_body(scene, body, displacements, along, viscous_strain, back, force, out):
    """Add to force the products of the stress -D : viscous_strain of a body, and fill out with the change of its stress.

        force += (geometric stiffness of the stress -D : viscous_strain) along + B^T back,    out = D B along

    displacements, along, force (nodes, 2); viscous_strain, back, out (strains,) of the body, as in element/relaxation.py.
    """
    arrays = scene.plates
    plates = arrays.body_node.shape[0] - 1  # the bodies after them are reduced ones
    if body >= plates:
        reduced_kernels.relaxation_products(scene.reduced, body - plates, displacements, along, viscous_strain, back, force, out)
    else:
        relaxation_products(cells_of(arrays, body), material_of(arrays, body), displacements, along, viscous_strain, back, force, out)


@part
def term_start(relaxing, body, term, count):
    """The first entry of a term's relaxed strains in a vector (n,); count: number of strains of the body."""
    return 2 * relaxing.first + relaxing.start[body] + (term - relaxing.terms[body]) * count


@part
def add_products(scene, relaxing, displacements, velocities, along, rotation, stiff, heavy, slowing):
    """Add K^T w to stiff, M w to heavy and C^T w to slowing of relaxation, w = along, and set the frames of the strains in rotation.

    All arrays are (nodes, 2). The rows of the relaxed strains in them are those of the head, transposed.
    """
    hold_strains(relaxing, along, heavy, rotation)
    speeds = velocities.reshape(-1)
    w = along.reshape(-1)
    of_rates = slowing.reshape(-1)  # C^T w
    for b in range(relaxing.start.shape[0] - 1):
        if relaxing.terms[b] == relaxing.terms[b + 1]:
            continue
        count = strains_of(relaxing, b)
        viscous_strain, back, stress_change = np.empty(count), np.zeros(count), np.empty(count)
        take_viscous_strain(relaxing, b, speeds, viscous_strain)
        for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
            at = term_start(relaxing, b, k, count)
            add_scaled(back, -relaxing.mass / (relaxing.time[k] * relaxing.unit[b]), w[at : at + count])
        multiply_body(scene, b, displacements, along, viscous_strain, back, stiff, stress_change)
        for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
            at = term_start(relaxing, b, k, count)
            add_scaled(of_rates[at : at + count], relaxing.mass / relaxing.time[k], w[at : at + count])
            add_scaled(of_rates[at : at + count], -relaxing.unit[b] * relaxing.share[k], stress_change)


@part
def eliminate_transposed(scene, relaxing, work, displacements, residual):
    """Add the residuals of the relaxed strains to those of the nodes, both in residual (nodes, 2), for the elimination of the strains.

        right_u += B^T sum right_x / (unit c_v (1 + c tau))

    work: the Elimination of a factor: rates (c, c_v), parts (1,) or (1, i) of complex numbers, scratch force (nodes, 2).
    """
    if relaxing.share.shape[0] == 0:
        return
    residuals, none = residual.reshape(-1), np.zeros((relaxing.first, 2))
    for b in range(relaxing.start.shape[0] - 1):
        if relaxing.terms[b] == relaxing.terms[b + 1]:
            continue
        count, (first_node, end_node) = strains_of(relaxing, b), pairs_of_body(scene, b)
        viscous_strain, sums, back, stress_change = np.zeros(count), np.zeros(count, residual.dtype), np.empty(count), np.empty(count)
        for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
            at = term_start(relaxing, b, k, count)
            factor = 1.0 / (relaxing.unit[b] * work.rates[1] * (1.0 + work.rates[0] * relaxing.time[k]))
            add_scaled(sums, factor, residuals[at : at + count])
        for p in range(work.parts.shape[0]):
            work.force[:], back[:] = 0.0, 0.0
            add_real(back, 1.0, sums, p)
            multiply_body(scene, b, displacements, none, viscous_strain, back, work.force, stress_change)
            for i in range(first_node, end_node):
                for j in range(2):
                    residual[i, j] += work.parts[p] * work.force[i, j]


@part
def recover_transposed(scene, relaxing, work, displacements, residual, dw):
    """Fill the relaxed strains' part of dw (nodes, 2), the solution of `S^T dw = residual`, from that of the nodes.

        w_x = tau / (mass c_v (1 + c tau)) (right_x + c_v unit g D B w_u)

    work: as of `eliminate_transposed`.
    """
    if relaxing.share.shape[0] == 0:
        return
    residuals, changes, none = residual.reshape(-1), dw.reshape(-1), np.zeros((relaxing.first, 2))
    for b in range(relaxing.start.shape[0] - 1):
        if relaxing.terms[b] == relaxing.terms[b + 1]:
            continue
        count, (first_node, end_node) = strains_of(relaxing, b), pairs_of_body(scene, b)
        zero, stress_change = np.zeros(count), np.empty(count)
        for p in range(work.parts.shape[0]):
            for i in range(first_node, end_node):
                for j in range(2):
                    work.force[i, j] = dw[i, j].real if p == 0 else dw[i, j].imag
            multiply_body(scene, b, displacements, work.force, zero, zero, none, stress_change)
            for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
                at = term_start(relaxing, b, k, count)
                factor = relaxing.time[k] / (relaxing.mass * work.rates[1] * (1.0 + work.rates[0] * relaxing.time[k]))
                of_stress = work.parts[p] * factor * work.rates[1] * relaxing.unit[b] * relaxing.share[k]
                if p == 0:
                    changes[at : at + count] = 0.0
                    add_scaled(changes[at : at + count], factor, residuals[at : at + count])
                add_scaled(changes[at : at + count], of_stress, stress_change)


@entry
def sum_works(scene, positions, rates, fields, by_share, by_time, by_strain):
    """Add over frames (frames, nodes, 2) the slopes of w . r, w = fields, in g and tau of all terms, and `-(B w) : D : g x` of each strain.

    by_share (terms,): slopes in g; by_time (terms,): slopes in tau, 1/s; by_strain (strains,): works at factor 1.
    """
    relaxing = scene.relaxation
    none = np.zeros((relaxing.first, 2))
    for frame in range(positions.shape[0]):
        u, speeds, w = positions[frame], rates[frame].reshape(-1), fields[frame].reshape(-1)
        for b in range(relaxing.start.shape[0] - 1):
            if relaxing.terms[b] == relaxing.terms[b + 1]:
                continue
            count, first_strain = strains_of(relaxing, b), relaxing.start[b]
            zero, stress_change, strain = np.zeros(count), np.empty(count), np.empty(count)
            multiply_body(scene, b, u, fields[frame], zero, zero, none, stress_change)
            relax_body(scene, b, u, None, zero, none, strain)
            for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
                at = term_start(relaxing, b, k, count)
                rate = relaxing.mass / relaxing.time[k] ** 2
                for j in range(count):
                    work = stress_change[j] * relaxing.unit[b] * speeds[at + j]
                    by_share[k] -= work
                    by_strain[first_strain + j] -= relaxing.share[k] * work
                    by_time[k] -= rate * (speeds[at + j] - strain[j] / relaxing.unit[b]) * w[at + j]


def relaxation_works(model, work):
    """({body: slopes of w . r in its (g, tau), (terms, 2)}, {full plate: works of the forces of relaxation at factor 1, (cells,)}).

    work: AdjointMultipliers of the states and w.
    """
    relaxing, contributions = model.arrays.relaxation, model.once(CellContributions, of_shape=True)
    by_share = np.zeros(len(relaxing.share))
    by_time = np.zeros(len(relaxing.share))
    by_strain = np.zeros(relaxing.start[-1])
    states = (np.ascontiguousarray(each, float).reshape(-1, model.n_nodes, 2) for each in (work.q, work.v, work.w))
    sum_works(model.arrays, *states, by_share, by_time, by_strain)
    slopes, cell_works = {}, {}
    first = 0  # number of the body's first weight
    for b, body in enumerate(model.all_bodies):
        terms = slice(relaxing.terms[b], relaxing.terms[b + 1])
        slopes[body.name] = np.stack([by_share[terms], by_time[terms]], axis=1)
        if b < len(model.bodies):
            weights, factors = len(body.operator.weights), body.factors[0]
            if body.name in model.strains:
                of_body = by_strain[relaxing.start[b] : relaxing.start[b] + 3 * weights]
                points = of_body.reshape(-1, 3, LANES).sum(axis=1).ravel()
                of_cells = contributions.weight_cells[first : first + weights] - contributions.first[b]
                cell_works[body.name] = np.bincount(of_cells, points, len(factors)) / factors
            first += weights
    return slopes, cell_works


@dataclass(frozen=True, eq=False)
class PronySeries(PartParameter):
    """The terms (g, tau) of a viscoelastic plate, (terms, 2). works: `relaxation_works` of AdjointMultipliers."""

    works: Callable

    def slope(self, work):
        """Works of the forces by unit g, and of the rates by unit tau."""
        return self.works(work)[0][self.part]


def series_parameters(model, works):
    """Yield the Prony series of the plates of a scene."""
    for name in model.strains:
        part = model.parts[name]
        path = ("material", "prony") if isinstance(part, Plate) else ("plate", "material", "prony")
        if isinstance(part, Plate) or (isinstance(part, Body) and part.plate is not None):
            yield PronySeries(f"{name}.prony", np.array(model.strains[name].terms), model, name, path, works)
