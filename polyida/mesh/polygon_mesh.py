"""PolygonMesh: points, polygons in offset form and named boundary sections; quality measures; the density filter."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.mesh import checks, topology
from polyida.mesh.sections import Section, edges_within, of_whole_sides, select
from polyida.validation import floats, index, instance, named_keywords, number, positive, settle

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class MeshQuality:
    """Quality measures of a mesh.

    Parameters
    ----------
    cells, nodes : int
    shortest_edge : float
        Over the mean edge.
    min_angle, max_angle : float, degrees
    min_vertices, max_vertices : int
        Of a cell.
    area_ratio : float
        Smallest over largest cell area.
    convex : bool
    half_bandwidth : int
        Largest difference of node numbers within a cell.
    pieces, holes : int
        Connected components, and holes = pieces - (V - E + F).
    """

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
    """An immutable plane mesh of simple polygons; its arrays are read-only copies.

    Parameters
    ----------
    points : (n_nodes, 2) float, m
    nodes : (n_corners,) int
        Corner nodes of all cells in succession, each cell counter-clockwise.
    offsets : (n_cells + 1,) int
        Cell i has the corners nodes[offsets[i]:offsets[i + 1]].
    sections : dict of name to node indices
    supports : dict of node to (x fixed, y fixed)
        From files, for joints; a scene does not use them by itself.
    loads : dict of node to (Fx, Fy), N
        From files, for `PointLoad`; a scene does not use them by itself.
    order : 1 or 2
        2: each side has a middle node, and the nodes of a cell are corner, middle, corner, middle, ...; see `quadratic`.

    Raises
    ------
    InputError
        For points that are not finite; nodes out of range, repeated in a cell or used by no cell; cells with fewer than three corners,
        clockwise or crossing themselves; cells that overlap. Cells need not be convex, see `require_convex`.
    """

    points: np.ndarray
    nodes: np.ndarray
    offsets: np.ndarray
    sections: dict = field(default_factory=dict)
    supports: dict = field(default_factory=dict)
    loads: dict = field(default_factory=dict)
    order: int = 1

    def __post_init__(self):
        """Check all arrays, replace them by read-only copies, and complete the sections of order 2."""
        points = checks.point_array(self.points)
        nodes, offsets = checks.cell_arrays(self.nodes, self.offsets, len(points))
        if not isinstance(self.sections, Mapping):
            raise InputError(f"mesh sections are {self.sections!r}; they must be a dictionary, name -> node indices")
        named = {str(name): checks.section_nodes(name, value, len(points)) for name, value in self.sections.items()}
        supports, loads = (
            checks.node_pairs(name, getattr(self, name), len(points), kind) for name, kind in (("supports", bool), ("loads", float))
        )
        named, supports, loads = map(MappingProxyType, (named, supports, loads))
        checks.require_order(self.order, nodes, offsets)
        settle(self, points=points, nodes=nodes, offsets=offsets, sections=named, supports=supports, loads=loads)
        checks.require_valid_cells(self)
        if self.order == 2:
            settle(self, sections=MappingProxyType({name: of_whole_sides(self, nodes) for name, nodes in named.items()}))

    def __reduce__(self):
        """Pickle the mesh by the arguments of its constructor, its mappings as plain dictionaries."""
        return PolygonMesh, (self.points, self.nodes, self.offsets, *map(dict, (self.sections, self.supports, self.loads)), self.order)

    def __repr__(self):
        """One line with the numbers of cells and nodes, and the names of the sections."""
        return f"PolygonMesh({self.n_cells} cells, {self.n_nodes} nodes, sections {', '.join(self.sections) or 'none'})"

    @property
    def n_nodes(self) -> int:
        """Number of nodes, those without a cell included."""
        return len(self.points)

    @property
    def n_cells(self) -> int:
        """Number of cells of the mesh."""
        return len(self.offsets) - 1

    def cell(self, i: int) -> np.ndarray:
        """Return the nodes of cell i, counter-clockwise: its corners, and for order 2 the middle node of a side after its first corner."""
        i = index("mesh.cell", "i", i, self.n_cells, "cells") % self.n_cells
        return self.nodes[self.offsets[i] : self.offsets[i + 1]]

    @cached_property
    def cell_areas(self) -> np.ndarray:
        """Areas of the cells, (n_cells,), m^2."""
        return self._measures[0]

    @cached_property
    def cell_centroids(self) -> np.ndarray:
        """Centroids of the cells, (n_cells, 2), m."""
        return self._measures[1]

    @cached_property
    def _measures(self):
        """(areas (n_cells,), m^2; centroids (n_cells, 2), m) of the cells, with curved sides of order 2."""
        cells = self.points, self.nodes, self.offsets
        return topology.curved_measures(*cells) if self.order == 2 else (topology.areas(*cells), topology.centroids(*cells))

    @cached_property
    def area(self) -> float:
        """Sum of the cell areas, m^2."""
        return float(self.cell_areas.sum())

    @cached_property
    def edges(self) -> np.ndarray:
        """(n_edges, 2) node pairs, each edge once, lower node first."""
        return topology.edges(self.nodes, self.offsets, self.n_nodes)

    @cached_property
    def boundary_edges(self) -> np.ndarray:
        """(n_boundary_edges, 2) node pairs, directed with the domain on the left."""
        return topology.boundary_edges(self.nodes, self.offsets, self.n_nodes)

    @cached_property
    def boundary_nodes(self) -> np.ndarray:
        """Sorted numbers of all nodes on the boundary."""
        return np.unique(self.boundary_edges)

    @cached_property
    def middle_nodes(self) -> np.ndarray:
        """(n_nodes,) bool: True for the middle node of a side; none for order 1."""
        middle = np.zeros(self.n_nodes, bool)
        middle[self.nodes[1::2] if self.order == 2 else []] = True
        return middle

    @cached_property
    def quadratic(self) -> "PolygonMesh":
        """The mesh with a middle node on each side, after the corners' numbers; itself for order 2. Sections have the middles of their sides."""
        if self.order == 2:
            return self
        sides, step = self.edges.astype(np.int64), topology.following(self.offsets)
        pairs = np.sort(np.stack([self.nodes, self.nodes[step]], axis=1)).astype(np.int64) @ [self.n_nodes, 1]
        middles = self.n_nodes + np.searchsorted(sides @ [self.n_nodes, 1], pairs)
        points = np.concatenate([self.points, self.points[sides].mean(axis=1)])
        nodes = np.stack([self.nodes, middles], axis=1).ravel()
        return PolygonMesh(points, nodes, 2 * self.offsets, self.sections, dict(self.supports), dict(self.loads), 2)

    @cached_property
    def linear(self) -> "PolygonMesh":
        """The mesh of its corners alone, in their order, without supports and loads; itself for order 1."""
        if self.order == 1:
            return self
        corner = ~self.middle_nodes
        number = np.cumsum(corner) - 1
        named = {name: number[nodes[corner[nodes]]] for name, nodes in self.sections.items()}
        return PolygonMesh(self.points[corner], number[self.nodes[::2]], self.offsets // 2, named)

    def quality(self) -> MeshQuality:
        """Return the quality measures, of order 2 those of the mesh of its corners."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        if self.order == 2:
            return self.linear.quality()
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

    def plot(self, values: ArrayLike | None = None, label: str = "value of a cell", axes: "Axes | None" = None) -> "Axes":
        """Draw the cells to scale, plain with the named sections, or coloured by a value of each cell.

        Parameters
        ----------
        values : (n_cells,) float, optional
            Such as the densities of a design, `run.von_mises(k)` or the shares of `ErrorBars.cells`.
        label : str
            Of the colorbar of the values.
        axes : Axes, optional
            New pyplot axes if None.

        Returns
        -------
        axes : Axes

        Raises
        ------
        InputError
            If the values are not one finite number for each cell.
        """
        from polyida.show.plates import draw_mesh
        from polyida.show.styles import on_axes

        colours, sections = None if values is None else floats(values), {}
        if values is None:
            for name, nodes in self.sections.items():
                edges = edges_within(self, nodes)
                sections[name] = self.points[edges if len(edges) else nodes]
        elif colours is None or colours.shape != (self.n_cells,):
            raise InputError(f"mesh.plot: values must be {self.n_cells} finite numbers, one for each cell, not {values!r:.100}")
        with on_axes(axes) as axis:
            draw_mesh(axis, self, colours, label, sections=sections)
            return axis

    def require_convex(self, tolerance: float = 1e-6) -> None:
        """Raise InputError naming the first corner whose exterior angle has a sine of at most the tolerance."""
        tolerance = number("require_convex", "tolerance", tolerance, "a sine")
        corners, offsets = self.nodes[:: self.order], self.offsets // self.order
        turn = topology.turns(self.points, corners, offsets)
        bad = np.flatnonzero(~((np.sin(turn) > tolerance) & (turn > 0)))
        if bad.size:
            raise InputError(
                f"{checks.described(self, topology.corner_cells(offsets)[bad[0]])} is not strictly convex: its angle at node "
                f"{corners[bad[0]]} is {180.0 - np.degrees(turn[bad[0]]):.4f} degrees and must be below 180"
            )

    def section(self, selector: "str | Callable[[np.ndarray], np.ndarray] | ArrayLike") -> Section:
        """Return nodes ordered along the boundary with their tributary lengths.

        selector: a section's name; a function points (n, 2) -> mask (n,), applied to the boundary nodes; or node indices. Raises InputError
        if no node is selected or the name is unknown.
        """
        return select(self, selector)


@named_keywords
def moved(mesh: PolygonMesh, points: "ArrayLike") -> PolygonMesh:
    """Return the mesh with its nodes at other places: the same cells and sections, for designs whose lengths and outlines change.

    Parameters
    ----------
    mesh : PolygonMesh
    points : (n_nodes, 2) float, m

    Returns
    -------
    PolygonMesh
        With the same numbers of nodes and cells.

    Raises
    ------
    InputError
        As PolygonMesh: if a cell turns inside out or cells overlap.
    """
    instance("moved", "mesh", mesh, PolygonMesh)
    cells = mesh.nodes, mesh.offsets, dict(mesh.sections), dict(mesh.supports), dict(mesh.loads)
    return PolygonMesh(checks.point_array(points), *cells, mesh.order)


@named_keywords
def density_filter(mesh: PolygonMesh, radius: float) -> "csr_array":
    """Return the matrix F of the density filter: `rho = F @ x`; derivatives with respect to x are `F.T @ (dJ/drho)`.

    `F_ij = A_j max(0, radius - |c_i - c_j|) / sum_k A_k max(0, radius - |c_i - c_k|)`, c the centroids and A the areas of the cells: rows sum
    to one.

    Parameters
    ----------
    mesh : PolygonMesh
    radius : float, m, > 0
        A radius below the distance of neighbouring centroids gives the identity.

    Returns
    -------
    scipy.sparse.csr_array
        (n_cells, n_cells), no unit.

    Raises
    ------
    InputError
        If `mesh` is no mesh or the radius is not positive.

    Notes
    -----
    Bruns, Tortorelli, Comput. Methods Appl. Mech. Engrg. 190 (2001); Bourdin, Int. J. Numer. Meth. Engng. 50 (2001).
    """
    from scipy.sparse import coo_array, diags_array
    from scipy.spatial import cKDTree

    if not isinstance(mesh, PolygonMesh):
        raise InputError(f"density_filter: mesh is {type(mesh).__name__}, a polyida mesh is needed")
    radius = positive("density_filter", "radius", radius, "metres")
    i, j = cKDTree(mesh.cell_centroids).query_pairs(radius, output_type="ndarray").T
    hat = radius - np.linalg.norm(mesh.cell_centroids[i] - mesh.cell_centroids[j], axis=1)
    own = np.arange(mesh.n_cells)
    rows, columns = np.concatenate([own, i, j]), np.concatenate([own, j, i])
    weights = np.concatenate([np.full(mesh.n_cells, radius), hat, hat]) * mesh.cell_areas[columns]
    matrix = coo_array((weights, (rows, columns)), shape=(mesh.n_cells, mesh.n_cells)).tocsr()
    return (diags_array(1.0 / matrix.sum(axis=1)) @ matrix).tocsr()
