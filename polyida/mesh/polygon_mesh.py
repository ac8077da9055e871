"""PolygonMesh: points, polygons in offset form and named boundary sections, and the figures of merit of a mesh."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.mesh import checks, topology
from polyida.mesh.sections import Section, select
from polyida.validation import named_keywords


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


@named_keywords
@dataclass(frozen=True, eq=False, repr=False)
class PolygonMesh:
    """A plane mesh of polygons. Immutable: the arrays are read-only copies of what was given.

    points (n_nodes, 2) in m; nodes: the corner nodes of all cells, one cell after the other, each counter-clockwise;
    offsets (n_cells + 1): cell i has the corners nodes[offsets[i]:offsets[i + 1]]; sections: name -> node indices;
    supports: node -> (whether x is fixed, whether y is); loads: node -> (Fx, Fy), N: as files bring them, for joints and
    `PointLoad` to be made of; no scene takes them by itself.

    Raises InputError for points that are not finite, nodes out of range, repeated in a cell or used by no cell, cells
    with fewer than three corners, clockwise or crossing themselves, and cells that overlap.
    Convexity is a need of some elements only: see require_convex.
    """

    points: np.ndarray
    nodes: np.ndarray
    offsets: np.ndarray
    sections: dict = field(default_factory=dict)
    supports: dict = field(default_factory=dict)
    loads: dict = field(default_factory=dict)

    def __post_init__(self):
        points = checks.point_array(self.points)
        nodes, offsets = checks.cell_arrays(self.nodes, self.offsets, len(points))
        if not isinstance(self.sections, Mapping):
            raise InputError(f"mesh sections are {self.sections!r}; they must be a dictionary, name -> node indices")
        named = {str(name): checks.section_nodes(name, value, len(points)) for name, value in self.sections.items()}
        for name, array in (("points", points), ("nodes", nodes), ("offsets", offsets)):
            object.__setattr__(self, name, array)
        object.__setattr__(self, "sections", MappingProxyType(named))
        object.__setattr__(self, "supports", MappingProxyType(checks.node_pairs("supports", self.supports, len(points), bool)))
        object.__setattr__(self, "loads", MappingProxyType(checks.node_pairs("loads", self.loads, len(points), float)))
        checks.require_valid_cells(self)

    def __reduce__(self):
        return PolygonMesh, (self.points, self.nodes, self.offsets, *map(dict, (self.sections, self.supports, self.loads)))

    def __repr__(self):
        return f"PolygonMesh({self.n_cells} cells, {self.n_nodes} nodes, sections {', '.join(self.sections) or 'none'})"

    @property
    def n_nodes(self) -> int:
        return len(self.points)

    @property
    def n_cells(self) -> int:
        return len(self.offsets) - 1

    def cell(self, i: int) -> NDArray:
        """Corner nodes of cell i, counter-clockwise."""
        if not -self.n_cells <= i < self.n_cells:
            raise InputError(f"mesh has cells 0..{self.n_cells - 1}, not {i}")
        i = i % self.n_cells
        return self.nodes[self.offsets[i] : self.offsets[i + 1]]

    @cached_property
    def cell_areas(self) -> NDArray:
        """(n_cells,), m^2."""
        return topology.areas(self.points, self.nodes, self.offsets)

    @cached_property
    def cell_centroids(self) -> NDArray:
        """(n_cells, 2), m."""
        return topology.centroids(self.points, self.nodes, self.offsets)

    @cached_property
    def area(self) -> float:
        """Sum of the cell areas, m^2."""
        return float(self.cell_areas.sum())

    @cached_property
    def edges(self) -> NDArray:
        """(n_edges, 2) node pairs, each edge once, lower node first."""
        return topology.edges(self.nodes, self.offsets, self.n_nodes)

    @cached_property
    def boundary_edges(self) -> NDArray:
        """(n_boundary_edges, 2) node pairs, directed so that the domain lies on the left."""
        return topology.boundary_edges(self.nodes, self.offsets, self.n_nodes)

    @cached_property
    def boundary_nodes(self) -> NDArray:
        """Sorted nodes on the boundary."""
        return np.unique(self.boundary_edges)

    def quality(self) -> MeshQuality:
        """MeshQuality: edge ratio, angles, vertex counts, convexity, bandwidth, holes."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        ends = self.points[self.edges]
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        angle = 180.0 - np.degrees(topology.turns(self.points, self.nodes, self.offsets))
        vertices = np.diff(self.offsets)
        graph = coo_array((np.ones(len(self.edges)), self.edges.T), shape=(self.n_nodes, self.n_nodes))
        pieces = int(connected_components(graph, directed=False, return_labels=False))
        return MeshQuality(
            cells=self.n_cells,
            nodes=self.n_nodes,
            shortest_edge=float(lengths.min() / lengths.mean()),
            min_angle=float(angle.min()),
            max_angle=float(angle.max()),
            min_vertices=int(vertices.min()),
            max_vertices=int(vertices.max()),
            area_ratio=float(self.cell_areas.min() / self.cell_areas.max()),
            convex=bool(angle.max() < 180.0 - 6e-5),
            half_bandwidth=topology.half_bandwidth(self.nodes, self.offsets),
            pieces=pieces,
            holes=pieces - (self.n_nodes - len(self.edges) + self.n_cells),
        )

    def require_convex(self, tolerance: float = 1e-6) -> None:
        """Raise InputError naming the first corner whose turn (sine of the exterior angle) is not above tolerance."""
        checks.require_convex(self, tolerance)

    def section(self, selector: str | Callable[[NDArray], NDArray] | ArrayLike) -> Section:
        """Section of nodes ordered along the boundary with their tributary lengths.

        selector: a section's name, a function points (n, 2) -> mask (n,), of which the boundary nodes are kept, or
        node indices. Raises InputError when nothing is selected or the name is unknown.
        """
        return select(self, selector)
