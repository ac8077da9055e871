"""Figures of merit of a mesh."""

from dataclasses import dataclass

import numpy as np

from polyida.mesh import topology


@dataclass(frozen=True)
class MeshQuality:
    """shortest_edge: shortest over mean edge; angles in degrees; half_bandwidth in nodes; holes = 1 - (V - E + F)
    for a mesh in one piece."""

    cells: int
    nodes: int
    shortest_edge: float
    min_angle: float
    max_angle: float
    min_vertices: int
    max_vertices: int
    area_ratio: float
    convex: bool
    half_bandwidth: int
    pieces: int
    holes: int


def quality(mesh):
    """MeshQuality of a PolygonMesh; area_ratio is the smallest over the largest cell area."""
    ends = mesh.points[mesh.edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    angle = 180.0 - np.degrees(topology.turns(mesh.points, mesh.nodes, mesh.offsets))
    vertices = np.diff(mesh.offsets)
    pieces = _pieces(mesh)
    return MeshQuality(
        cells=mesh.n_cells,
        nodes=mesh.n_nodes,
        shortest_edge=float(lengths.min() / lengths.mean()),
        min_angle=float(angle.min()),
        max_angle=float(angle.max()),
        min_vertices=int(vertices.min()),
        max_vertices=int(vertices.max()),
        area_ratio=float(mesh.cell_areas.min() / mesh.cell_areas.max()),
        convex=bool(angle.max() < 180.0 - 6e-5),
        half_bandwidth=topology.half_bandwidth(mesh.nodes, mesh.offsets),
        pieces=pieces,
        holes=pieces - (mesh.n_nodes - len(mesh.edges) + mesh.n_cells),
    )


def _pieces(mesh):
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(mesh.edges)), mesh.edges.T), shape=(mesh.n_nodes, mesh.n_nodes))
    return int(connected_components(graph, directed=False, return_labels=False))
