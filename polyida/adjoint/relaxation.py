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
    """Fill `relaxation_products` of a body, a plate or one of few coordinates."""
    s = scene.plates
    few = s.body_node.shape[0] - 1
    if body >= few:
        reduced_kernels.relaxation_products(scene.reduced, body - few, displacements, along, viscous_strain, back, force, out)
    else:
        relaxation_products(cells_of(s, body), material_of(s, body), displacements, along, viscous_strain, back, force, out)


@part
def add_products(scene, relaxing, displacements, velocities, along, rotation, stiff, heavy, slowing):
    """Add K^T w, M w and C^T w of relaxation, w = along, and set the frames of the strains."""
    hold_strains(relaxing, along, heavy, rotation)
    speeds, own, slow = velocities.reshape(-1), along.reshape(-1), slowing.reshape(-1)
    for b in range(relaxing.start.shape[0] - 1):
        if relaxing.terms[b] == relaxing.terms[b + 1]:
            continue
        count, first = strains_of(relaxing, b), 2 * relaxing.first + relaxing.start[b]
        viscous_strain, back, pushed = np.empty(count), np.zeros(count), np.empty(count)
        take_viscous_strain(relaxing, b, speeds, viscous_strain)
        for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
            at = first + (k - relaxing.terms[b]) * count
            add_scaled(back, -relaxing.mass / (relaxing.time[k] * relaxing.unit[b]), own[at : at + count])
        multiply_body(scene, b, displacements, along, viscous_strain, back, stiff, pushed)
        for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
            at = first + (k - relaxing.terms[b]) * count
            add_scaled(slow[at : at + count], relaxing.mass / relaxing.time[k], own[at : at + count])
            add_scaled(slow[at : at + count], -relaxing.unit[b] * relaxing.share[k], pushed)


@part
def eliminate_transposed(scene, relaxing, work, displacements, residual):
    """Add the residuals of the strains to those of the nodes in residual (nodes, 2)."""
    if relaxing.share.shape[0] > 0:
        residuals, none = residual.reshape(-1), np.zeros((relaxing.first, 2))
        for b in range(relaxing.start.shape[0] - 1):
            if relaxing.terms[b] == relaxing.terms[b + 1]:
                continue
            count, (first, end) = strains_of(relaxing, b), pairs_of_body(scene, b)
            viscous_strain, sums, back, pushed = np.zeros(count), np.zeros(count, residual.dtype), np.empty(count), np.empty(count)
            for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
                at = 2 * relaxing.first + relaxing.start[b] + (k - relaxing.terms[b]) * count
                add_scaled(
                    sums, 1.0 / (relaxing.unit[b] * work.rates[1] * (1.0 + work.rates[0] * relaxing.time[k])), residuals[at : at + count]
                )
            for p in range(work.parts.shape[0]):
                work.force[:], back[:] = 0.0, 0.0
                add_real(back, 1.0, sums, p)
                multiply_body(scene, b, displacements, none, viscous_strain, back, work.force, pushed)
                for i in range(first, end):
                    for j in range(2):
                        residual[i, j] += work.parts[p] * work.force[i, j]


@part
def recover_transposed(scene, relaxing, work, displacements, residual, dw):
    """Fill the strains' part of dw (nodes, 2), the solution of `S^T dw = residual`, from that of the nodes."""
    if relaxing.share.shape[0] > 0:
        residuals, changes, none = residual.reshape(-1), dw.reshape(-1), np.zeros((relaxing.first, 2))
        for b in range(relaxing.start.shape[0] - 1):
            if relaxing.terms[b] == relaxing.terms[b + 1]:
                continue
            count, (first, end) = strains_of(relaxing, b), pairs_of_body(scene, b)
            zero, pushed = np.zeros(count), np.empty(count)
            for p in range(work.parts.shape[0]):
                for i in range(first, end):
                    for j in range(2):
                        work.force[i, j] = dw[i, j].real if p == 0 else dw[i, j].imag
                multiply_body(scene, b, displacements, work.force, zero, zero, none, pushed)
                for k in range(relaxing.terms[b], relaxing.terms[b + 1]):
                    at = 2 * relaxing.first + relaxing.start[b] + (k - relaxing.terms[b]) * count
                    factor = relaxing.time[k] / (relaxing.mass * work.rates[1] * (1.0 + work.rates[0] * relaxing.time[k]))
                    if p == 0:
                        changes[at : at + count] = 0.0
                        add_scaled(changes[at : at + count], factor, residuals[at : at + count])
                    add_scaled(
                        changes[at : at + count], work.parts[p] * factor * work.rates[1] * relaxing.unit[b] * relaxing.share[k], pushed
                    )


@entry
def sum_works(scene, positions, rates, fields, by_share, by_time, by_strain):
    """Add over frames (nodes, 2) the slopes of w . r, w = fields, in g and tau of all terms, and `-(B w) : D : g x` of each strain."""
    x = scene.relaxation
    none = np.zeros((x.first, 2))
    for frame in range(positions.shape[0]):
        u, speeds, own = positions[frame], rates[frame].reshape(-1), fields[frame].reshape(-1)
        for b in range(x.start.shape[0] - 1):
            if x.terms[b] == x.terms[b + 1]:
                continue
            count, at = strains_of(x, b), 2 * x.first + x.start[b]
            zero, pushed, strain = np.zeros(count), np.empty(count), np.empty(count)
            multiply_body(scene, b, u, fields[frame], zero, zero, none, pushed)
            relax_body(scene, b, u, None, zero, none, strain)
            for k in range(x.terms[b], x.terms[b + 1]):
                rate = x.mass / x.time[k] ** 2
                for j in range(count):
                    work = pushed[j] * x.unit[b] * speeds[at + j]
                    by_share[k] -= work
                    by_strain[x.start[b] + j] -= x.share[k] * work
                    by_time[k] -= rate * (speeds[at + j] - strain[j] / x.unit[b]) * own[at + j]
                at += count


def relaxation_works(model, work):
    """({body: slopes of w . r in its (g, tau), (terms, 2)}, {full plate: works of the forces of relaxation at factor 1, (cells,)})."""
    x, contributions = model.arrays.relaxation, model.once(CellContributions, of_shape=True)
    by_share, by_time, by_strain = np.zeros(len(x.share)), np.zeros(len(x.share)), np.zeros(x.start[-1])
    states = (np.ascontiguousarray(each, float).reshape(-1, model.n_nodes, 2) for each in (work.q, work.v, work.w))
    sum_works(model.arrays, *states, by_share, by_time, by_strain)
    slopes, cell_works, first = {}, {}, 0
    for b, body in enumerate(model.all_bodies):
        terms = slice(x.terms[b], x.terms[b + 1])
        slopes[body.name] = np.stack([by_share[terms], by_time[terms]], axis=1)
        if b < len(model.bodies):
            weights, factors = len(body.operator.weights), body.factors[0]
            if body.name in model.strains:
                points = by_strain[x.start[b] : x.start[b] + 3 * weights].reshape(-1, 3, LANES).sum(axis=1).ravel()
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
