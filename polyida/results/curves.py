"""Lines of cells and boundaries as they are drawn: sides of order 2 are parabolas."""

from typing import NamedTuple

import numpy as np

from polyida.mesh import topology

QUARTER = np.array([0.375, 0.75, -0.125])  # of the nodes of a side, at a quarter of it: nearest corner, middle, other corner


class Curves(NamedTuple):
    """Lines of cells and boundary: nodes and points between the nodes of sides of order 2, which are parabolas.

    nodes, offsets: of the cells, as of `connectivity`; edges (k, 2) of the boundary. Points are numbered behind all nodes; sides (points, 3):
    of each the nearest corner, the middle node and the other corner.
    """

    nodes: np.ndarray
    offsets: np.ndarray
    edges: np.ndarray
    sides: np.ndarray

    def places(self, positions):
        """Positions (nodes, 2), m, followed by those of points within curved sides."""
        if not len(self.sides):
            return positions
        return np.concatenate([positions, np.einsum("k,pkd->pd", QUARTER, positions[self.sides])])

    def polygons(self, positions):
        """Corners (corners, 2) of every cell as a list, at node positions (nodes, 2)."""
        return np.split(self.places(positions)[self.nodes], self.offsets[1:-1]) if len(self.nodes) else []

    def outlines(self, positions):
        """Boundary edges as segments (edges, 2, 2), m, at these positions of the nodes."""
        return self.places(positions)[self.edges]


def curves_of_mesh(mesh):
    """The Curves of all cells of a mesh, which draw their edges."""
    return curves_of([(mesh, 0)], mesh.nodes.astype(int), mesh.offsets.astype(int))


def curves_of(meshes, nodes, offsets):
    """The Curves of all meshes [(mesh, number of its first node)] together.

    nodes, offsets: the corners of all their cells, as of Curves. Cells of order 2 get points within their sides, which are inserted into
    nodes and offsets.
    """
    edges, sides, halves = [np.zeros((0, 2), int)], [np.zeros((0, 3), int)], [np.zeros((0, 2), int)]
    new = sum(mesh.n_nodes for mesh, _ in meshes)
    for mesh, first in meshes:
        if mesh.order == 1:
            edges.append(mesh.boundary_edges + first)
            continue
        half, points = mesh.edges.astype(np.int64), new + np.arange(len(mesh.edges))
        is_middle = mesh.middle_nodes[half[:, 0]]
        middle, corner = np.where(is_middle, *half.T), np.where(is_middle, *half.T[::-1])
        both = np.bincount(middle, corner, mesh.n_nodes).astype(int)
        place = np.searchsorted(half @ [mesh.n_nodes, 1], np.sort(mesh.boundary_edges).astype(np.int64) @ [mesh.n_nodes, 1])
        start, end = mesh.boundary_edges.T + first
        edges += [np.column_stack([start, points[place]]), np.column_stack([points[place], end])]
        sides.append(np.column_stack([corner, middle, both[middle] - corner]) + first)
        halves.append(half + first)
        new += len(points)
    sides, halves = np.concatenate(sides), np.concatenate(halves)
    if len(halves):
        nodes, offsets = topology.inserted(nodes, offsets, halves, new - len(halves) + np.arange(len(halves)))
    return Curves(nodes, offsets, np.concatenate(edges), sides)
