"""Small meshes, and a body on its own: the kernels called with thickness and material chosen once."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from polyida.element import elements, kernels
from polyida.element.operator import Blocks, Material


def mesh(points, cells):
    """A mesh from points (N, 2) and lists of corner nodes."""
    offsets = np.append(0, np.cumsum([len(cell) for cell in cells]))
    return SimpleNamespace(
        points=np.array(points, dtype=float), nodes=np.concatenate(cells).astype(np.int32), offsets=offsets.astype(np.int32)
    )


def polygon(n, seed=0):
    """One strictly convex polygon: n points on an ellipse at jittered angles."""
    angles = 2 * np.pi * (np.arange(n) + 0.6 * np.random.default_rng(seed).random(n)) / n
    return mesh(np.c_[1.3 * np.cos(angles), 0.8 * np.sin(angles)], [np.arange(n)])


def quads(nx, ny, length=1.0, height=1.0, jitter=0.0, seed=0):
    """nx by ny quadrilaterals, their inner nodes moved at random by `jitter` of the spacing."""
    x, y = np.meshgrid(np.linspace(0, length, nx + 1), np.linspace(-height / 2, height / 2, ny + 1), indexing="ij")
    points = np.stack([x, y], axis=-1)
    shift = np.random.default_rng(seed).uniform(-jitter, jitter, (nx - 1, ny - 1, 2)) * [length / nx, height / ny]
    points[1:-1, 1:-1] += shift
    node = np.arange(x.size).reshape(x.shape)
    cells = np.stack([node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]], axis=-1).reshape(-1, 4)
    return mesh(points.reshape(-1, 2), list(cells))


def mixed(length=1.0, height=1.0, cells=60, seed=2):
    """Polygons of 3 to 8 corners and more: a Voronoi diagram of random seeds cut by the box, its short edges collapsed,
    a few of its cells halved into triangles and rests."""
    cells_of, points = _voronoi(np.random.default_rng(seed).random((cells, 2)) * [length, height], length, height)
    points, cells_of = _collapse(points, cells_of, 0.2 * np.sqrt(length * height / cells))
    halves = [
        part
        for k, cell in enumerate(cells_of)
        for part in ((cell[:3], np.r_[cell[0], cell[2:]]) if k % 5 == 0 and len(cell) > 4 else (cell,))
    ]
    return mesh(points, halves)


def _voronoi(seeds, length, height):
    from scipy.spatial import Voronoi

    mirrors = [seeds * [-1, 1], seeds * [1, -1], [2 * length, 0] + seeds * [-1, 1], [0, 2 * height] + seeds * [1, -1]]
    diagram = Voronoi(np.vstack([seeds, *mirrors]))
    cells = []
    for k, centre in enumerate(seeds):
        cell = np.array(diagram.regions[diagram.point_region[k]])
        away = diagram.vertices[cell] - centre
        cells.append(cell[np.argsort(np.arctan2(away[:, 1], away[:, 0]))])
    return cells, diagram.vertices


def _collapse(points, cells, shortest):
    """Merge nodes that lie closer than `shortest` and drop unused ones; a corner of the box keeps its place."""
    used = np.unique(np.concatenate(cells))
    distance = np.linalg.norm(points[used, None] - points[used], axis=-1)
    first = np.argmax(distance < shortest, axis=1)
    merged = np.full(len(points), -1)
    merged[used] = used[first]
    cells = [merged[cell] for cell in cells]
    cells = [cell[cell != np.roll(cell, 1)] for cell in cells]
    kept, numbers = np.unique(np.concatenate(cells), return_inverse=True)
    splits = np.cumsum([len(cell) for cell in cells])[:-1]
    return points[kept], np.split(numbers, splits)


class Body:
    """One operator with its material; `padding` nodes of other bodies lie before it."""

    E, NU, THICKNESS = 2.0e5, 0.3, 0.02
    RIGID, ZERO, LEAST = 1e-24, 1e-12, 1e-6  # energy of a rigid motion over E t; zero and other eigenvalues at rest over the largest

    def __init__(self, mesh, padding=0, operator=elements.wachspress):
        self.points, self.op, self.first = np.asarray(mesh.points), operator(mesh), padding
        self.c1 = self.THICKNESS * self.E / (1 - self.NU**2)

    def material(self, viscosity=0.0):
        """The Material."""
        return Material(self.c1, self.NU, viscosity)

    def displacement(self, function):
        """Displacements from a function of the points, after the padding."""
        u = np.zeros((self.first + self.op.n_nodes, 2))
        u[self.first :] = function(self.points)
        return u

    def force(self, u):
        """Internal force and rotation sums of the body's nodes, and the status."""
        f, rotation = np.zeros_like(u), np.zeros_like(u)
        status = kernels.internal_force(self.op.cells(self.first), self.material(), u, f, rotation)
        assert not f[: self.first].any() and not rotation[: self.first].any()
        return f[self.first :], rotation[self.first :], status

    def energy(self, u):
        """Strain energy."""
        return kernels.strain_energy(self.op.cells(self.first), self.material(), u)

    def tangent(self, u, scale=1.0):
        """Dense tangent (2 n, 2 n) of the body."""
        op, before = self.op, 5
        blocks = np.zeros((before + len(op.indices), 2, 2))
        kernels.tangent(op.cells(self.first), Blocks(op.pairs, before, blocks), self.material(), u, scale)
        assert not blocks[:before].any()
        return self.dense(blocks[before:])

    def dense(self, blocks):
        """Dense matrix (2 n, 2 n) from blocks on the pattern; (n, n) from numbers on it."""
        op = self.op
        rows = np.repeat(np.arange(op.n_nodes), np.diff(op.indptr))
        if blocks.ndim == 1:
            dense = np.zeros((op.n_nodes, op.n_nodes))
            dense[rows, op.indices] = blocks
            return dense
        dense = np.zeros((op.n_nodes, 2, op.n_nodes, 2))
        dense[rows, :, op.indices] = blocks
        return dense.reshape(2 * op.n_nodes, -1)

    def stress(self, u):
        """Cauchy stress of the cells."""
        out = np.full((self.op.n_cells, 3), np.nan)
        material = Material(self.c1 / self.THICKNESS, self.NU)
        kernels.stress(self.op.cells(self.first), self.op.lane_cells, self.op.areas, material, u, out)
        return out


class Virtual(Body):
    """A body of virtual elements: constant strains and stabilisation together."""

    RIGID, ZERO, LEAST = 1e-13, 1e-13, 1e-3

    def __init__(self, mesh, padding=0, tau=0.1):
        super().__init__(mesh, padding, partial(elements.virtual, tau=tau))
        self.factor = elements.plane_trace(self.c1, self.NU)
        self.on_pattern = self.op.indptr, self.op.indices, self.op.stabilisation, self.factor, padding

    def force(self, u):
        f, (constant, rotation, status) = np.zeros_like(u), super().force(u)
        kernels.stabilisation_force(*self.on_pattern, u, f)
        assert not f[: self.first].any()
        return constant + f[self.first :], rotation, status

    def energy(self, u):
        return super().energy(u) + kernels.stabilisation_energy(*self.on_pattern, u)

    def tangent(self, u, scale=1.0):
        return super().tangent(u, scale) + scale * self.factor * np.kron(self.dense(self.op.stabilisation), np.eye(2))


@pytest.fixture
def body():
    """Body(mesh, padding)."""
    return Body


@pytest.fixture
def flexible():
    """Virtual(mesh, padding, tau)."""
    return Virtual


def hanging():
    """Six cells: nodes on the middle of sides, and an L with a reentrant corner."""
    points = [[0, 0], [1, 0], [2, 0], [1, 0.5], [2, 0.5], [0, 1], [1, 1], [2, 1], [1, 2], [2, 2], [0, 3], [1, 3], [2, 3], [0.5, 1]]
    cells = [[0, 1, 3, 6, 13, 5], [1, 2, 4, 3], [3, 4, 7, 6], [5, 13, 6, 7, 9, 8, 11, 10], [8, 9, 12], [8, 12, 11]]
    return mesh(points, cells)


@pytest.fixture
def meshes():
    """The functions that make meshes."""
    return SimpleNamespace(mesh=mesh, polygon=polygon, quads=quads, mixed=mixed, hanging=hanging)


SHAPES = {"mixed": mixed, "quads": lambda: quads(5, 4, jitter=0.3), **{f"{n}-gon": lambda n=n: polygon(n) for n in (3, 4, 5, 6, 7, 8, 30)}}


@pytest.fixture(params=SHAPES)
def shape(request):
    """Every mesh in turn."""
    return SHAPES[request.param]()


OF_VIRTUAL = {"virtual mixed": mixed, "virtual hanging": hanging} | {f"virtual {n}-gon": lambda n=n: polygon(n) for n in (3, 4, 5, 8, 30)}


@pytest.fixture(params=[*SHAPES, *OF_VIRTUAL])
def plate(request):
    """A body of either element on every mesh in turn, two nodes of another body before it."""
    if request.param in SHAPES:
        return Body(SHAPES[request.param](), 2)
    made = Virtual(OF_VIRTUAL[request.param](), 2)
    made.LEAST = Body.LEAST if request.param == "virtual mixed" else Virtual.LEAST
    return made
