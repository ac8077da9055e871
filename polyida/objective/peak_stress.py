"""Peak stress of the material and strain energy of bodies as objectives."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polyida.assembly import equilibrium
from polyida.assembly.arrays import INDICES
from polyida.assembly.build import reduced_arrays
from polyida.assembly.factors import CellContributions
from polyida.element import kernels as element
from polyida.element.cell_products import _add_forces
from polyida.element.kernels import _differences, _gradient, _scatter_balanced, _workspace, lame
from polyida.element.material import add_energy, carried, determinant, second_piola, strain
from polyida.element.operator import Material
from polyida.errors import InputError
from polyida.jit import entry
from polyida.jit.intrinsics import LANES, lane, load, store, traced, zeros2
from polyida.model.guarded import guard
from polyida.objective.objective import Slopes, run_of
from polyida.objective.time_mean import TimeMean, chosen, deforming, named, power, power_mean, relative
from polyida.results.motion import von_mises
from polyida.validation import is_number, named_keywords, settle


@named_keywords
@dataclass(frozen=True, eq=False)
class PeakStress(TimeMean):
    """`(time mean of the area mean of s^p)^(1/p)`, Pa, s the von Mises stress of a cell, as `run.von_mises` of an elastic plate.

    Viscous stress and the relaxation of viscoelastic plates are left out. J is below the largest stress and approaches it as p grows:
    `largest(run)` is at most `(T A / (w a))^(1/p)` times J, with the trapezoidal weight w of the frame and the area a of the cell that have
    it, T and A being their sums. With factors f of stiffness, s is `f^power` times the stress of the solid material at the strain of the
    cell.

    Parameters
    ----------
    plate : str, Plate or Reduced, optional
        By default all.
    p : float
        Order of the means, 1 or more.
    power : float, 0 to 1
        1: the stress of the scaled cells, as `run.von_mises`. Designs by densities need less, such as 0.2: the stress of scaled cells that
        share a given load does not depend on their factor, so that a limit of it allows a plate without material.

    Raises
    ------
    InputError
        For p below 1 and a power out of range; of a run if the plate is not in its scene.
    """

    plate: Any = None
    _of_material = True
    p: float = 8.0
    power: float = 1.0

    def __post_init__(self):
        """Check p and power. Raises InputError for wrong ones."""
        settle(self, p=power("PeakStress", self.p))
        if not (is_number(self.power) and 0 <= self.power <= 1):
            raise InputError(f"PeakStress: power = {self.power!r:.100} must be a number from 0 to 1")

    def named(self, model: Any) -> PeakStress:
        """Return the objective with the name of its plate instead of the plate."""
        return replace(self, plate=named(model, self.plate))

    def largest(self, run: Any) -> float:
        """Return the largest von Mises stress of all cells and frames, Pa."""
        run = run_of("PeakStress", run)
        model = guard(run.model, "PeakStress")
        moved, bodies = (model.nodal(np.asarray(q, float)) for q in run.q), self._bodies(model)
        return float(max(body.von_mises(body.stress(u)).max() for u in moved for body in bodies))

    def _bodies(self, model):
        """The CellStress of each chosen plate. Raises InputError for quadratic cells."""
        known = deforming(model) if model.is_scene else {}
        known = {body.name: body for body in model.drawn if body.name in known}
        if quadratic := [name for name, body in known.items() if body.plate.order == 2]:
            raise InputError(
                f"PeakStress: {quadratic[0]!r} has quadratic cells, order = 2; only the stress of linear ones is differentiated"
            )
        return [CellStress(body, self.power) for body in chosen("PeakStress", model, self.plate, known)]

    def _evaluator(self, model, span):
        """The function of Frames that gives the area means of the stress and the way back to Slopes."""
        bodies = self._bodies(model)
        areas = np.concatenate([body.operator.areas for body in bodies])
        share, splits = areas / areas.sum(), np.cumsum([body.operator.n_cells for body in bodies])[:-1]

        def evaluate(frames):
            """Area means of the stress in the frames, and the function to Slopes."""
            moved = [model.nodal(q) for q in frames.q]
            stresses = [[body.stress(u) for body in bodies] for u in moved]
            sizes = np.array([np.concatenate([body.von_mises(one) for body, one in zip(bodies, each)]) for each in stresses])
            means = np.array([power_mean(share, s, self.p) for s in sizes])

            def to_slopes(factor):
                """ds/dvm = share (vm / s)^(p - 1)."""
                rates = [relative(one, mean) ** (self.p - 1.0) for one, mean in zip(sizes, means)]
                toward = factor[:, None] * share * np.array(rates).reshape(sizes.shape)
                pulls = zip(moved, stresses, (np.split(one, splits) for one in toward))
                pull = [model.of_nodal(_pull(bodies, *each)) for each in pulls]
                works = np.split(np.sum(toward * sizes, axis=0), splits)
                direct = [slopes for body, work in zip(bodies, works) if body.body in model.bodies for slopes in body.by_parameters(work)]
                return Slopes(q=np.array(pull).reshape(-1, model.n), direct=dict(direct))

            return lambda: means, to_slopes

        return evaluate


def _pull(bodies, u, stresses, adjoint):
    """Forces on the nodes (nodes, 2): the slope in u of the sum of adjoints times von Mises stresses of all bodies."""
    forces = np.zeros_like(u)
    for body, stress, one in zip(bodies, stresses, adjoint):
        body.pull(u, stress, one, forces)
    return forces


class CellStress:
    """The stress of the cells of a body at displacements u (nodes, 2) of all meshes."""

    def __init__(self, body, power=1.0):
        """Store the moduli of a plate in its plane, and `share` (cells,), by which the von Mises stress is multiplied.

        share: the stiffness factors of the cells to the power `power - 1`. body: the plate in a model.
        """
        modulus, nu = body.plate.material.in_plane
        self.power = power
        self.share = body.factors[0] ** (power - 1.0)
        self.body = body
        self.operator = body.operator
        self.moduli = (modulus / (1 - nu**2), nu)
        self.across = body.plate.material.across

    def von_mises(self, stress):
        """(cells,), Pa, times the share of the factors."""
        return self.share * von_mises(stress, self.across * (stress[:, 0] + stress[:, 1]))

    def stress(self, u):
        """Cauchy stress of the cells, (cells, 3): xx, yy, xy, Pa."""
        operator, out = self.operator, np.empty((self.operator.n_cells, 3))
        element.stress(operator.cells(self.body.nodes.start), operator.lane_cells, operator.areas, Material(*self.moduli), u, out)
        return out

    def pull(self, u, stress, adjoint, forces):
        """forces (nodes, 2) += the slope in u of `adjoint (cells,) . von Mises stress`; no slope where that is zero."""
        xx, yy, xy = stress.T
        zz, size = self.across * (xx + yy), self.von_mises(stress) / self.share
        out = self.across * (2.0 * zz - xx - yy)
        squares = np.stack([2.0 * xx - yy - zz + out, 2.0 * yy - xx - zz + out, 6.0 * xy])
        toward = squares * np.divide(self.share * adjoint, 2.0 * size * self.operator.areas, out=np.zeros_like(size), where=size > 0)
        by_lanes = np.moveaxis(toward[:, self.operator.lane_cells].reshape(3, -1, LANES), 0, 1)
        arrays = self.operator.cells(), np.ascontiguousarray(by_lanes), Material(*self.moduli)
        add_stress_forces(*arrays, np.ascontiguousarray(u[self.body.nodes]), forces[self.body.nodes])

    def by_parameters(self, work):
        """(parameter, slope) of a sum whose parts `work` (cells,) grow with the stress of the cells."""
        yield f"{self.body.name}.stiffness", self.power * work / self.body.factors[0]
        yield f"{self.body.name}.E", float(work.sum()) / self.body.plate.material.E


@named_keywords
@dataclass(frozen=True, eq=False)
class StrainEnergy(TimeMean):
    """Time mean of the strain energy, J, of all bodies or of one, as `run.energy.strain` of elastic ones.

    With factors of cells it is the energy of the scaled cells. The relaxation of viscoelastic plates is left out.

    Parameters
    ----------
    plate : str, Plate or Body, optional
        A body that deforms; by default all.

    Raises
    ------
    InputError
        Of a run if the body is not in its scene.
    """

    plate: Any = None
    _of_material = True

    def named(self, model: Any) -> StrainEnergy:
        """Return the objective with the name of its body instead of the body."""
        return replace(self, plate=named(model, self.plate))

    def _evaluator(self, model, span):
        """A function of Frames that returns a pair of functions: one gives the strain energies, and to_slopes the Slopes.

        The first takes no argument and gives an array; the second takes dJ/d(strain energy) of the frames, (count,). span: unused.
        """
        elastic = Elastic(model, chosen("StrainEnergy", model, self.plate, deforming(model)))

        def evaluate(frames):
            """(function without arguments that gives the strain energies of the frames, function to_slopes)."""

            def to_slopes(factor):
                """The Slopes of J, from dJ/d(strain energy) of the frames, (count,)."""
                energies = {body.name: np.asarray(factor, float) for body in elastic.plates}
                return Slopes(q=elastic.forces(frames.q, factor), direct=elastic.by_parameters(frames.q, factor), energies=energies)

            return lambda: elastic.energies(frames.q), to_slopes

        return evaluate


class Elastic:
    """The elastic energy of some bodies of a scene and its slopes, by the scene's kernels on arrays of these bodies alone."""

    def __init__(self, model, bodies):
        """Copy the scene's arrays with the chosen bodies alone."""
        self.model, names = model, {body.name for body in bodies}
        self.plates = [body for body in model.bodies if body.name in names]
        self.own = [own for own in model.own_forces if own.strain and own.name in names]
        s, numbers = model.arrays.plates, [k for k, body in enumerate(model.bodies) if body.name in names]
        of_bodies = {name: getattr(s, name)[numbers] for name in s._fields if name.startswith("body_")}
        self.arrays = model.arrays._replace(
            plates=s._replace(**of_bodies, weight=np.zeros_like(s.weight), load_drive=s.load_drive[:0]),
            links=model.arrays.links._replace(gravity=np.zeros(2)),
            reduced=reduced_arrays([_body(placed, names) for placed in model.reduced_bodies], int(model.arrays.reduced.pair[0]), 0),
        )
        self.still = np.zeros((model.n_nodes, 2))
        self.none = np.zeros(model.m)
        self.drives = model.drives(0.0)

    def energies(self, q):
        """Strain energies of frames q (count, n), (count,), J."""
        values = np.empty(len(q))
        fill_energies(self.arrays, _pairs(q, self.model), values)
        return values + sum(np.array([own.energy(own.places(each)) for each in q]) for own in self.own)

    def forces(self, q, factor):
        """factor (count,) times their slopes in q, (count, n)."""
        model, result = self.model, np.empty((len(q), *self.still.shape))
        scratch = np.empty(model.m), np.empty((2, model.n_points, 2))
        fill_forces(self.arrays, self.drives, _pairs(q, model), (self.still, self.none), np.asarray(factor, float), scratch, result)
        result = result.reshape(len(q), -1)
        for own in self.own:
            for each, f, r in zip(q, factor, result):
                x = own.places(each)
                r -= f * (own.A.T @ own.forces(0.0, x, np.zeros_like(x)).ravel())
        return result

    def by_parameters(self, q, factor):
        """{parameter: slope of the sum of factor times energy} over frames q (count, n)."""
        slopes = {}
        for body in self.plates:
            cells = _cell_energies(self.model, body, q, factor)
            slopes[f"{body.name}.stiffness"] = cells
            whole = float(body.factors[0] @ cells)
            slopes |= {f"{body.name}.E": whole / body.plate.material.E, f"{body.name}.thickness": whole / body.plate.thickness}
        return slopes


def _pairs(q, model):
    """Coordinates q (frames, n) as pairs (frames, pairs, 2), contiguous floats."""
    return np.ascontiguousarray(q, float).reshape(-1, model.n_nodes, 2)


def _body(placed, names):
    """A copy of a body of few coordinates, without elastic form unless it has one of these names."""
    other = copy(placed)
    other.form = placed.form if placed.name in names else None
    return other


def _cell_energies(model, body, q, factor):
    """Sum over frames q (count, n) of factor times the energy of every cell of a plate at a factor of 1, (cells,), J."""
    s, number = model.arrays.plates, model.bodies.index(body)
    u, operator, material = (
        q.reshape(len(q), -1, 2)[:, body.nodes],
        body.operator,
        Material(s.membrane_stiffness[number], s.body_nu[number]),
    )
    slopes = np.zeros(operator.n_cells)
    for one, f in zip(u, factor):
        add_cell_energies(operator.cells(), operator.lane_cells, material, np.ascontiguousarray(one), f, slopes)
    return slopes / body.factors[0] + _stabilised(model, number, u, factor)


def _stabilised(model, number, u, factor):
    """Sum over frames of factor times the stabilisation energy of every cell of a plate at a factor of 1, (cells,), J.

    It is 0 without stabilisation, else `-t tr(C) S_ij |u_i - u_j|^2 / 4` of every pair of nodes.
    """
    scale, operator = model.arrays.plates.body_stabilisation[number], model.bodies[number].operator
    if not scale:
        return 0.0
    shares = model.once(CellContributions, of_shape=True)
    rows, squares = np.repeat(np.arange(operator.n_nodes), np.diff(operator.indptr)), np.zeros(len(shares.plates.stabilisation))
    apart = squares[slice(*shares.plates.at[number : number + 2, INDICES])]
    for one, f in zip(u, factor):
        apart += f * np.sum((one[rows] - one[operator.indices]) ** 2, axis=1)
    return -0.25 * scale * shares.by_plate(shares.stabilisation.slopes(squares, shares.first[-1]))[model.bodies[number].name]


# Kernels beside those of element/kernels.py, with their arguments; the nodes of the body begin at 0.


@entry
def fill_energies(scene, positions, out):
    """Fill out (frames,) with the elastic energy, J, of a scene's bodies at positions (frames, pairs, 2)."""
    for k in range(positions.shape[0]):
        out[k] = equilibrium.strain_energy(scene, positions[k])


@entry
def fill_forces(scene, drives, positions, zeros, factor, scratch, out):
    """Fill out (frames, pairs, 2) with factor (frames,) times the residual g(0, q, 0) at the positions q of each frame, without constraint
    forces.

    zeros: of a (pairs, 2) and lam (m,); scratch: of phi (m,) and points (2, points, 2).
    """
    a, lam = zeros
    phi, points = scratch
    for k in range(positions.shape[0]):
        equilibrium.equilibrium(scene, drives, positions[k], a, lam, out[k], phi, a[:0], points[0], points[1])
        for i in range(out.shape[1]):
            out[k, i, 0], out[k, i, 1] = factor[k] * out[k, i, 0], factor[k] * out[k, i, 1]


@entry
def add_cell_energies(cells, lane_cells, material, displacements, factor, out):
    """out (cells,) += factor times the strain energy of every cell, J."""
    lam_bar, two_mu = lame(material)
    workspace = _workspace(cells.layout, 2, 0)
    for b in range(cells.layout.shape[0]):
        m = cells.layout[b, 0] - 1
        _differences(displacements, cells.corners, cells.layout[b, 2], 0, m, workspace)
        state = zeros2()
        for p in range(cells.layout[b, 1]):
            h = _gradient(cells.gradients, cells.layout[b, 3] + 2 * p * m * LANES, workspace, m)
            state = add_energy(state, h, load(cells.weights, cells.layout[b, 4] + p * LANES), lam_bar, two_mu)
        for k in range(LANES):
            out[lane_cells[b * LANES + k]] += factor * lane(state[0], k)


@traced(4)
def _stress_slope(h, g, weight, lam_bar, two_mu):
    """weight d(G : sigma)/dF, g = (Gxx, Gyy, 2 Gxy).

    tau = F S F^T,  sigma = tau / det F,  d(G : sigma) = (2 G F S + F D : (F^T G F) - (G : sigma) det F F^-T) / det F : dF
    """
    f11, f12, f21, f22 = 1.0 + h[0], h[1], h[2], 1.0 + h[3]
    shear, det = 0.5 * g[2], determinant(h)
    s = second_piola(strain(h), lam_bar, two_mu)
    n = g[0] * f11 + shear * f21, g[0] * f12 + shear * f22, shear * f11 + g[1] * f21, shear * f12 + g[1] * f22
    a = f11 * n[0] + f21 * n[2], f11 * n[1] + f21 * n[3], f12 * n[1] + f22 * n[3]
    moved = carried(h, second_piola(a, lam_bar, two_mu))
    ratio = (s[0] * a[0] + 2.0 * (s[1] * a[1]) + s[2] * a[2]) / det
    stretched = n[0] * s[0] + n[1] * s[1], n[0] * s[1] + n[1] * s[2], n[2] * s[0] + n[3] * s[1], n[2] * s[1] + n[3] * s[2]
    turned = f22, 0.0 - f21, 0.0 - f12, f11
    return tuple(weight / det * (2.0 * x + y - ratio * z) for x, y, z in zip(stretched, moved, turned))


@entry
def add_stress_forces(cells, toward, material, displacements, nodal_force):
    """nodal_force (nodes, 2) += the slope in displacements of the sum over cells of `toward . int (sxx, syy, sxy)`, as kernels.stress has
    it.

    toward (blocks, 3, LANES): numbers of each cell, 1/m^2 times what the sum is in.
    """
    lam_bar, two_mu = lame(material)
    workspace = _workspace(cells.layout, 4, 0)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        force, size = workspace[2 * m * LANES :], 2 * m * LANES
        _differences(displacements, cells.corners, first, 0, m, workspace)
        for k in range(0, size, 2 * LANES):
            store(force, k, zeros2())
        at = 3 * b * LANES
        adjoint = load(toward, at), load(toward, at + LANES), load(toward, at + 2 * LANES)
        for p in range(cells.layout[b, 1]):
            g = cells.layout[b, 3] + p * size
            h, weight = _gradient(cells.gradients, g, workspace, m), load(cells.weights, cells.layout[b, 4] + p * LANES)
            _add_forces(force, cells.gradients, g, _stress_slope(h, adjoint, weight, lam_bar, two_mu), size)
        _scatter_balanced(force, cells.corners, first, 0, m, nodal_force)
