"""Normal force, shear force and bending moment through a cut of a plate."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from polyida.assembly.factors import CellContributions
from polyida.assembly.placement import gravity_at
from polyida.assembly.scene_model import SceneModel
from polyida.body.plate import Plate
from polyida.element.operator import Material
from polyida.element.relaxation import relax
from polyida.errors import InputError
from polyida.io.frames import each
from polyida.jit.intrinsics import LANES
from polyida.mesh import PolygonMesh
from polyida.reprs import brief
from polyida.validation import complex_of_pairs, pairs_of, vector2

ROUND = 1e-9  # of a plate's size: cells that reach over a line by less end there


class Slivers:
    """The parts of cells on the wrong side of a line, as masses at their centroids.

    ahead (cells,): True for the cells that count as ahead of the line through `place` with the normal `way`, (2,) in the scene at rest. Those
    ahead have slivers of negative mass behind the line, the others of positive mass ahead of it. Places and accelerations are interpolated
    with the mean gradient of the cell.
    """

    def __init__(self, body, gravity, place, way, ahead):
        """Cut the cells that the line crosses; gravity: of the scene. Each sliver has a mass and weights of its cell's nodes."""
        material, mesh, operator = body.plate.material, body.mesh, body.operator
        distance = (body.points - place) @ way
        density, entries, masses = material.rho * body.plate.thickness, [], []
        first, near = mesh.offsets[:-1], ROUND * np.ptp(distance)
        low, high = (least.reduceat(distance[mesh.nodes], first) for least in (np.minimum, np.maximum))
        for cell in np.flatnonzero((low < -near) & (high > near)):  # those that the line crosses
            corners = slice(mesh.offsets[cell], mesh.offsets[cell + 1])
            nodes, side = mesh.nodes[corners], -1.0 if ahead[cell] else 1.0
            points = body.points[nodes]
            area, centroid = _clipped(points, side * distance[nodes])
            weights = 1.0 / len(nodes) + operator.mean_gradients[corners] @ (centroid - points.mean(axis=0))
            entries += [(len(masses), node, weight) for node, weight in zip(nodes, weights)]
            masses.append(side * density * body.factors[1][cell] * area)
        rows, columns, values = np.array(entries, float).reshape(-1, 3).T
        self.weights = csr_array((values, (rows.astype(int), columns.astype(int))), (len(masses), mesh.n_nodes))
        self.mass = np.array(masses)[:, None]
        self.gravity, self.drag = gravity, material.mass_damping
        self.rest = body.points

    def forces(self, t, v, a):
        """Inertia forces less weight and damping, (slivers, 2), N, from the nodes' velocities and accelerations, (nodes, 2)."""
        return self.mass * (self.weights @ (a + self.drag * v) - gravity_at(self.gravity, t))

    def places(self, u):
        """Their places, (slivers, 2), m, from the nodes' displacements."""
        return self.weights @ (self.rest + u)


def _clipped(points, distance):
    """(area, centroid) of the part of a polygon where the distance of its corners from a line, interpolated, is positive."""
    corners = []
    for i in range(len(points)):
        if distance[i - 1] * distance[i] < 0:
            s = distance[i - 1] / (distance[i - 1] - distance[i])
            corners.append(points[i - 1] + s * (points[i] - points[i - 1]))
        if distance[i] >= 0:
            corners.append(points[i])
    arms = np.array(corners) - corners[0]
    parts = 0.5 * (arms[:-1, 0] * arms[1:, 1] - arms[:-1, 1] * arms[1:, 0])
    return parts.sum(), corners[0] + parts @ (arms[:-1] + arms[1:]) / (3.0 * parts.sum())


@dataclass(frozen=True, eq=False)
class SectionForces:
    """Forces of the part of a plate ahead of a cut on the part behind it, over frames.

    Along a bar at rest with the load (px, py) per length, s towards `direction`: `normal' = -px`, `shear' = -py`, `moment' = -shear`.

    Parameters
    ----------
    normal : (frames,) float, N
        Along `direction`; positive in tension.
    shear : (frames,) float, N
        Along `direction` rotated by +90 degrees.
    moment : (frames,) float, N m
        Counter-clockwise, about `point`.
    point, direction : (frames, 2) float
        The place, m, and the normal of the cut, moved with its nodes as one rigid set.
    """

    normal: NDArray
    shear: NDArray
    moment: NDArray
    point: NDArray
    direction: NDArray

    __repr__ = brief


def section_forces(motion, plate, at, normal, frame=None):
    """The SectionForces of a plate, by name or itself, at a place and normal of its mesh, over all frames or in one."""
    cut = Cut(motion.model, _body(motion.model, plate), at, normal)
    if frame is not None:
        return _section_forces(
            np.array(cut(float(motion.t[frame]), *(np.asarray(x[frame], float) for x in (motion.q, motion.v, motion.a))))
        )
    states = zip(motion.t, each(motion.q), each(motion.v), each(motion.a))
    return _section_forces(np.array([cut(*state) for state in states]).reshape(-1, 7))


def _section_forces(values):
    """SectionForces of an array (..., 7): normal, shear, moment, point (2), direction (2)."""
    return SectionForces(values[..., 0], values[..., 1], values[..., 2], values[..., 3:5], values[..., 5:])


class Cut:
    """A straight cut across a plate.

    The cells that are mostly ahead form a plate of their own; the residual r = M a + g of that plate at the nodes that it shares with the
    other cells is their force on it. Slivers between these nodes and the line are moved to their side with their inertia, weight and damping.
    So the forces are in exact equilibrium with inertia and loads of the part ahead. Raises InputError if the cut divides nothing.
    """

    def __init__(self, model, body, at, normal):
        """Divide the plate `body` of a scene at the line through `at` across `normal`, both in the axes of its mesh."""
        label, mesh = f"section_forces: {body.name}", body.mesh
        at, way = vector2(label, "at", at), vector2(label, "normal", normal)
        if not np.hypot(*way) > 0:
            raise InputError(f"{label}: normal = {normal!r} must not be zero")
        turn = np.exp(1j * body.plate.angle)
        place, way = turn * complex(*at) + complex(*body.plate.origin), turn * complex(*way) / np.hypot(*way)
        ahead = _ahead(mesh, (mesh.points + body.plate.origin - pairs_of(place)) @ pairs_of(way))
        self.nodes, part = _part(body.plate.mesh, ahead)
        self.cut = np.flatnonzero(np.isin(self.nodes, mesh.nodes[np.repeat(~ahead, np.diff(mesh.offsets))]))
        if not self.cut.size:
            raise InputError(f"{label}: a cut at {at.tolist()} across {normal!r} does not part the plate")
        self.body, self.place, self.way = body, place, way
        solid = SceneModel({body.name: replace(body.plate, mesh=part)}, model.gravity, without_strains=True)
        self.ahead = solid.with_factors(**{body.name: tuple(factor[ahead] for factor in body.factors)})
        self.rest = complex_of_pairs(self.ahead.reference[self.cut])
        self.slivers = Slivers(body, model.gravity, pairs_of(place), pairs_of(way), ahead)
        self.strains = model.strains.get(body.name)
        if self.strains:
            b, plates, contributions = model.bodies.index(body), model.arrays.plates, model.once(CellContributions, of_shape=True)
            first = sum(len(other.operator.weights) for other in model.bodies[:b])
            of_cells = contributions.weight_cells[first : first + len(body.operator.weights)] - contributions.first[b]
            self.strains_ahead = np.repeat(ahead[of_cells].reshape(-1, 1, LANES), 3, axis=1).ravel()
            self.material = Material(plates.membrane_stiffness[b], plates.body_nu[b])

    def __call__(self, t, q, v, a):
        """normal, shear, moment, point x and y, direction x and y at an instant."""
        u, speeds, a = (x.reshape(-1, 2)[self.body.nodes] for x in (q, v, a))
        residual = self.ahead.residual(t, *(x[self.nodes].ravel() for x in (u, speeds, a)), np.zeros(0)).reshape(-1, 2)[self.cut]
        if self.strains:
            viscous_strain, forces = self.strains_ahead * self.strains.viscous_strain_of(v), np.zeros_like(u)
            relax(self.body.operator.cells(), self.material, u, None, viscous_strain, forces, np.empty_like(viscous_strain))
            residual = residual + forces[self.nodes][self.cut]
        x = self.rest + complex_of_pairs(u[self.nodes][self.cut])
        turn = np.vdot(self.rest - self.rest.mean(), x - x.mean())
        turn /= abs(turn) or 1.0
        point, way = x.mean() + turn * (self.place - self.rest.mean()), turn * self.way
        forces = -complex_of_pairs(np.concatenate([residual, self.slivers.forces(t, speeds, a)]))
        arms = np.concatenate([x, complex_of_pairs(self.slivers.places(u))]) - point
        through = way.conjugate() * forces.sum()
        return through.real, through.imag, np.vdot(arms, forces).imag, point.real, point.imag, way.real, way.imag


def _ahead(mesh, distance):
    """The cells that are ahead of a line by the mean of their corners' distances (nodes,); near an end by all of them, or by one."""
    corners, first, near = distance[mesh.nodes], mesh.offsets[:-1], ROUND * np.ptp(distance)
    ahead = np.add.reduceat(corners, first) > 0
    if ahead.all():
        return np.minimum.reduceat(corners, first) >= -near
    return ahead if ahead.any() else np.maximum.reduceat(corners, first) > near


def _part(mesh, chosen):
    """(nodes of the chosen cells; mesh of these cells, None without any); chosen: (cells,) mask."""
    corners = mesh.nodes[np.repeat(chosen, np.diff(mesh.offsets))]
    nodes, numbers = np.unique(corners, return_inverse=True)
    offsets = np.concatenate([[0], np.cumsum(np.diff(mesh.offsets)[chosen])])
    return nodes, PolygonMesh(mesh.points[nodes], numbers, offsets, order=mesh.order) if chosen.any() else None


def _body(model, plate: Any):
    """The placed body of a full plate of a model; plate: its name or the Plate itself. Raises InputError."""
    known = {body.name: body for body in model.bodies}
    name = next((name for name, body in known.items() if body.plate is plate), plate)
    if isinstance(name, str) and name in known:
        return known[name]
    label = getattr(plate, "label", None) or repr(plate)
    label = f"plate {plate.name!r} is not in the scene" if isinstance(plate, Plate) else f"no full plate is called {label:.100}"
    raise InputError(f"section_forces: {label}; known: {', '.join(map(repr, known)) or 'none'}")
