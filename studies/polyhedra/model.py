"""Bodies of polyhedra as a pi.Model: pins, hinges, point masses, gravity, dead loads, and nodes that are held."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.sparse import bsr_array, csr_array, eye_array, kron

import polyida as pi
from polyhedra.elements import Cells, cells_of, forces, rotations, tangent
from polyhedra.factor import Turned, fronts_of


class Point(NamedTuple):
    """A point of a body: the mean of its nodes with weights {node: weight} of the sum 1, as `Mesh.side` has them."""

    body: int
    weights: dict


class Pin(NamedTuple):
    """A spherical joint: two Points, or a Point and a place in space, (3,), coincide. Two pins are a hinge."""

    a: object
    b: object


class Polyhedra(pi.Model):
    """q: displacements of the nodes that are free, (3 n,), body after body.

    meshes: one for each body. masses: [(Point, kg)]. loads: [(Point, force (3,))], dead. held: [(body, node, displacement (3,))].
    E, rho: numbers, for gradients. lumped: masses in the nodes, or the consistent mass matrix.
    """

    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)
    uniform_units = flexible = True
    parameters = ("E", "rho")

    def __init__(self, meshes, material, gravity=(0.0, 0.0, 0.0), pins=(), masses=(), loads=(), held=(), lumped=True):
        self.E, self.nu, self.rho, self.gravity = material.E, material.nu, material.rho, np.array(gravity, float)
        starts = np.append(0, np.cumsum([len(mesh.points) for mesh in meshes]))
        fixed = {int(starts[body] + node): displacement for body, node, displacement in held}
        free = np.setdiff1d(np.arange(starts[-1]), list(fixed))
        self.number = np.empty(starts[-1], np.int64)
        self.number[np.append(free, np.array(list(fixed), int))] = np.arange(starts[-1])
        self.starts, self.meshes, self.count, self.n = starts, meshes, len(free), 3 * len(free)
        self.held = np.array(list(fixed.values()), float).reshape(-1, 3)
        self.points = np.concatenate([mesh.points for mesh in meshes])
        self.places = self.points[free]
        self.extent, self.free_fall = float(np.ptp(self.points, axis=0).max()), float(np.linalg.norm(gravity))
        parts = [cells_of(mesh) for mesh in meshes]
        first = np.append(0, np.cumsum(np.concatenate([np.diff(cells.first) for cells, _ in parts])))
        nodes = np.concatenate([self.number[start + cells.nodes] for start, (cells, _) in zip(starts, parts)])
        self.cells = Cells(first, nodes, *map(np.concatenate, list(zip(*(cells for cells, _ in parts)))[2:]))
        self.attachments, self.m, offset, B = [], 3 * len(pins), [np.zeros(0)], csr_array((3 * len(pins), self.n))
        for k, pin in enumerate(pins):
            rows, sides = slice(3 * k, 3 * k + 3), ((pin.a, 1.0), (pin.b, -1.0))
            offset.append(sum(sign * (self.place(side) if isinstance(side, Point) else np.asarray(side, float)) for side, sign in sides))
            for point, sign in sides:
                if isinstance(point, Point):
                    self.attachments.append((rows, sign, *self.nodes_of(point)))
                    B = B + sign * self._rows(*self.attachments[-1][2:], rows.start)
        self.B, self.offset = csr_array(B), np.concatenate(offset)
        self.pulls = [self._rows(nodes, weights, rows.start).toarray()[rows] for rows, _, nodes, weights in self.attachments]
        self.dead, self.point_masses = np.zeros((self.count, 3)), [(*self.nodes_of(point), float(mass)) for point, mass in masses]
        for point, force in loads:
            nodes, weights = self.nodes_of(point)
            self.dead[nodes] += weights[:, None] * np.asarray(force, float)
        self._set_pattern([matrix for _, matrices in parts for matrix in matrices], lumped)

    def place(self, point, q=None):
        """The place of a Point, (3,), at rest or at q."""
        nodes, weights = self.starts[point.body] + np.array(list(point.weights)), np.array(list(point.weights.values()))
        return weights @ self.points[nodes] + (0.0 if q is None else weights @ self.displacements(q)[self.number[nodes]])

    def nodes_of(self, point):
        """(free nodes, weights) of a Point; InputError if a node is held."""
        nodes = self.number[self.starts[point.body] + np.array(list(point.weights))]
        if (nodes >= self.count).any():
            raise pi.InputError(f"Polyhedra: a point of body {point.body} has held nodes; joints, masses and loads take free ones")
        return nodes, np.array(list(point.weights.values()))

    def _rows(self, nodes, weights, row):
        """(m, n), the mean of nodes in the rows from `row` on."""
        rows, columns = np.tile(np.arange(row, row + 3), len(nodes)), (3 * nodes[:, None] + np.arange(3)).ravel()
        return csr_array((np.repeat(weights, 3), (rows, columns)), (self.m, self.n))

    def _set_pattern(self, consistent, lumped):
        """The nodal pattern (CSR), the block of each pair of corners, and the numbers of the mass matrix on it at density 1 and of point masses."""
        cells, count = self.cells, self.count
        groups = [cells.nodes[a:b] for a, b in zip(cells.first, cells.first[1:])] + [nodes for nodes, _, _ in self.point_masses]
        values = np.concatenate([one.ravel() for one in consistent] + [m * np.outer(w, w).ravel() for _, w, m in self.point_masses])
        pairs = np.concatenate([np.stack([np.repeat(g, len(g)), np.tile(g, len(g))]) for g in groups], axis=1)
        inner = (pairs < count).all(axis=0)
        keys, blocks = np.unique(pairs[0, inner] * count + pairs[1, inner], return_inverse=True)
        self.pairs, self.indices = np.full(len(inner), -1), keys % count
        self.pairs[inner], self.indptr = blocks, np.searchsorted(keys // count, np.arange(count + 1))
        self.nodal = np.bincount(cells.nodes, cells.lumped, len(self.number))[:count]
        of_cells = np.arange(len(values)) < sum(one.size for one in consistent)
        sums = [np.bincount(blocks, np.where(part, values, 0.0)[inner], len(keys)) for part in (of_cells, ~of_cells)]
        self.of_density, self.of_points = sums
        if lumped:
            self.of_density = np.where(keys // count == self.indices, self.nodal[self.indices], 0.0)

    @cached_property
    def fronts(self):
        """The order of elimination of a step matrix, and its fronts."""
        return fronts_of(self.indptr, self.indices, self.places)

    @cached_property
    def nodal_mass(self):
        """Numbers of the mass matrix on the pattern, (nnz,)."""
        return self.rho * self.of_density + self.of_points

    def _matrix(self, values):
        some = values != 0.0
        rows = np.repeat(np.arange(self.count), np.diff(self.indptr))
        return kron(csr_array((values[some], (rows[some], self.indices[some])), (self.count, self.count)), eye_array(3), format="csr")

    @cached_property
    def weight(self):
        """Forces of gravity and dead loads, (n,)."""
        nodal = self.rho * self.nodal
        for nodes, weights, mass in self.point_masses:
            nodal[nodes] += mass * weights
        return (nodal[:, None] * self.gravity + self.dead).ravel()

    def displacements(self, q):
        """Of all nodes in the order of the cells, (nodes, 3)."""
        return np.concatenate([q.reshape(-1, 3), self.held])

    def elastic(self, q):
        """(elastic forces (n,), elastic energy)."""
        f, energy = forces(self.cells, self.E, self.nu, self.displacements(q))
        return f[: self.count].ravel(), energy

    def stiffness_blocks(self, q):
        """Blocks of the tangent on the pattern, (nnz, 3, 3)."""
        return tangent(self.cells, self.pairs, len(self.indices), self.E, self.nu, self.displacements(q))

    def rotations(self, q):
        """Rotations of the free nodes, (nodes, 3, 3)."""
        return rotations(self.cells, self.displacements(q), self.count)

    @cached_property
    def M(self):
        return self._matrix(self.nodal_mass)

    def mass(self, q):
        return self.M

    def force(self, t, q, v):
        return self.elastic(q)[0] - self.weight

    def phi(self, t, q):
        return self.B @ q + self.offset

    def phi_q(self, t, q):
        return self.B

    def force_q(self, t, q, v):
        return bsr_array((self.stiffness_blocks(q), self.indices, self.indptr), shape=(self.n, self.n)).tocsr()

    def potential(self, q):
        return self.elastic(q)[1] - self.weight @ q

    def potentials(self, q):
        return -self.weight @ q, self.elastic(q)[1]

    def step_matrix(self):
        return Turned(self)

    def residual_p(self, name, t, q, v, a, lam):
        if name == "E":
            return self.elastic(q)[0] / self.E
        return self._matrix(self.of_density) @ a - (self.nodal[:, None] * self.gravity).ravel()
