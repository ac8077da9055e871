"""Mesh files through meshio: whatever plane cells a file holds become one PolygonMesh, or one InputError.

Files are data from anywhere: every failure inside a reader ends as an InputError that names the file.
"""

import os
from pathlib import Path
from urllib.parse import quote, unquote

import numpy as np

from polyida.errors import InputError
from polyida.keywords import named_keywords
from polyida.mesh import sections, topology
from polyida.mesh.guarded import guarded
from polyida.mesh.make.domains import positive
from polyida.mesh.numbering import renumber, sorted_cells
from polyida.mesh.polygon_mesh import PolygonMesh

POLYGON_FORMATS = (".vtu", ".vtk", ".obj")
# Readers that end on any truncated file: those for ply, off, nastran and ansys wait for ever at its end.
FORMATS = {".vtu": "vtu", ".vtk": "vtk", ".obj": "obj", ".msh": "gmsh", ".inp": "abaqus", ".mesh": "medit"}
PLANE = ("triangle", "quad", "polygon")
LOWER = ("vertex", "line")
PREFIX = "section:"


@named_keywords
def read(path: str | Path, tolerance: float = 1e-9) -> PolygonMesh:
    """PolygonMesh of a file of triangles, quads and polygons, of one or several kinds.

    Points closer than tolerance times the mesh's size merge, unused ones go, clockwise cells turn. Nodes are
    renumbered where that narrows the bandwidth by a fifth, cells always sorted along them. Sections: the file's named
    physical groups, cell sets and point sets of nodes and lines, what write stored, and left, right, top, bottom and
    'hole 0', ... found from the boundary. Raises InputError, naming the file, for anything it cannot use.
    """
    path, tolerance = _checked(path), positive(tolerance, "merge tolerance")
    data = _quietly(path, lambda meshio: meshio.read(path, FORMATS[path.suffix.lower()]))
    try:
        with np.errstate(all="ignore"):
            return _polygon_mesh(data, tolerance)
    except InputError as error:
        raise InputError(f"mesh file {path}: {error}") from None
    except Exception as error:
        raise InputError(f"mesh file {path} holds inconsistent data: {_short(error)}") from error


@named_keywords
def write(mesh: PolygonMesh, path: str | Path, overwrite: bool = False) -> None:
    """Write a mesh; the suffix gives the format: .vtu, .vtk and .obj hold polygons, others triangles and quads.

    .vtu, .vtk and .msh hold the sections too. Whole or not at all: a temporary file beside it is renamed.
    Raises InputError for an existing file without overwrite=True and for formats that cannot hold the mesh.
    """
    path = _path(path)
    _require_format(path)
    if path.suffix.lower() not in POLYGON_FORMATS and np.diff(mesh.offsets).max() > 4:
        raise InputError(
            f"mesh file {path}: {path.suffix} holds triangles and quads only; the mesh has polygons, "
            f"which {', '.join(POLYGON_FORMATS)} hold"
        )
    if path.exists() and not overwrite:
        raise InputError(f"mesh file {path} exists; pass overwrite=True to replace it")
    partial = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    kind = FORMATS[path.suffix.lower()]
    try:
        kind = "gmsh22" if kind == "gmsh" else kind
        _quietly(path, lambda meshio: _meshio_mesh(meshio, mesh).write(partial, kind), "written")
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _require_format(path):
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"mesh file {path} has the suffix {path.suffix!r}; known are {', '.join(FORMATS)}")


def _path(path):
    try:
        return Path(path)
    except TypeError:
        raise InputError(f"mesh file {path!r} must be a path") from None


def _checked(path):
    path = _path(path)
    try:
        exists = path.is_file()
    except (OSError, ValueError):
        exists = False
    if not exists:
        raise InputError(f"mesh file {str(path)!r} does not exist or is not a file")
    _require_format(path)
    return path


def _short(error):
    text = " ".join(str(error).split())[:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _quietly(path, action, what="read"):
    """action(meshio) without its printing; meshio may print, warn, exit or raise anything at all on a bad file."""
    import meshio

    said = None
    try:
        with guarded(path.stat().st_size if path.exists() else 2**28) as said:
            return action(meshio)
    except (Exception, SystemExit) as error:  # noqa: BLE001, whatever it is, the file is to blame
        detail = " ".join(said.getvalue().split())[:200] if isinstance(error, SystemExit) else _short(error)
        raise InputError(f"mesh file {path} cannot be {what} as {path.suffix}: {detail or 'no reason given'}") from None


def _polygon_mesh(data, tolerance):
    points, plane = _plane_points(data)
    nodes, offsets = _joined_cells(plane)
    _require_range(nodes, len(points))
    named = _named_nodes(data, len(points))
    target = _merged(points, np.unique(nodes), tolerance)
    used, nodes = np.unique(target[nodes], return_inverse=True)
    nodes, offsets = without_repeats(nodes, offsets)
    nodes = counter_clockwise(points[used, :2], nodes, offsets)
    place = np.full(len(points), -1)
    place[used] = np.arange(len(used))
    named = {name: place[target[index]] for name, index in named.items()}
    return _numbered(points[used, :2], nodes, offsets, named)


def _numbered(points, nodes, offsets, named):
    """PolygonMesh with narrow numbering; named sections first, the automatic ones where no name is taken."""
    placed, new_nodes, new_offsets, number = renumber(points, nodes, offsets)
    if topology.half_bandwidth(new_nodes, new_offsets) < 0.8 * topology.half_bandwidth(nodes, offsets):
        points, nodes, offsets = placed, new_nodes, new_offsets
        named = {name: np.where(index >= 0, number[index], -1) for name, index in named.items()}
    else:
        nodes, offsets = sorted_cells(nodes, offsets)
    named = {name: np.unique(index[index >= 0]) for name, index in named.items()}
    named = {name: index for name, index in named.items() if index.size}
    rim = topology.boundary_edges(nodes, offsets, len(points))
    return PolygonMesh(points, nodes, offsets, sections.automatic(points, rim) | named)


def _plane_points(data):
    """Points (n, 3) and the arrays of plane cells; InputError for cells of other kinds and points off z = 0."""
    points = np.asarray(data.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InputError(f"points have shape {points.shape}, they must have 2 or 3 coordinates")
    points = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    kinds = sorted({block.type for block in data.cells} - {*PLANE, *LOWER})
    if kinds:
        raise InputError(f"holds cells of type {', '.join(kinds)}; only first order triangles, quads and polygons can be used")
    plane = [np.asarray(block.data, dtype=np.int64) for block in data.cells if block.type in PLANE and len(block.data)]
    if not plane:
        raise InputError("holds no triangles, quads or polygons")
    return points, plane


def _joined_cells(blocks):
    sizes = np.concatenate([np.full(len(block), block.shape[1]) for block in blocks])
    return np.concatenate([block.ravel() for block in blocks]), np.concatenate([[0], np.cumsum(sizes)])


def _require_range(nodes, n_points):
    if nodes.min() < 0 or nodes.max() >= n_points:
        raise InputError(f"cells name points {nodes.min()}..{nodes.max()}, the file has 0..{n_points - 1}")


def _merged(points, used, tolerance):
    """Point that stands for each point: the lowest numbered of those within tolerance times the size of the mesh."""
    corner = points[used]
    bad = np.flatnonzero(~np.isfinite(corner).all(axis=1))
    if bad.size:
        raise InputError(f"point {used[bad[0]]} is {corner[bad[0]].tolist()}; all coordinates must be finite")
    size = float(np.ptp(corner, axis=0).max())
    z = corner[:, 2]
    if np.abs(z).max() > 1e-9 * size:
        raise InputError(f"is not plane: z runs from {z.min():.6g} to {z.max():.6g}, it must be 0")
    _, first, group = np.unique(corner, axis=0, return_index=True, return_inverse=True)
    lowest = _near_groups(corner[first], tolerance * size)[group.ravel()]
    leader = np.full(len(used), len(points))
    np.minimum.at(leader, lowest, used)
    target = np.arange(len(points))
    target[used] = leader[lowest]
    return target


def _near_groups(points, distance):
    """Group number of each of the different points; points closer than the distance are in one group."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    if tree.count_neighbors(tree, distance) > 50 * len(points):
        raise InputError(f"has heaps of different points within {distance:.3g} of each other")
    pairs = tree.query_pairs(distance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    return connected_components(graph, directed=False)[1]


def without_repeats(nodes, offsets):
    """Corners without those equal to the one before; cells left with fewer than three corners go."""
    cell = topology.corner_cells(offsets)
    keep = nodes != nodes[topology.preceding(offsets)]
    size = np.bincount(cell[keep], minlength=len(offsets) - 1)
    keep &= size[cell] >= 3
    return nodes[keep], np.concatenate([[0], np.cumsum(size[size >= 3])])


def counter_clockwise(points, nodes, offsets):
    """Nodes with the corners of clockwise cells reversed."""
    cell = topology.corner_cells(offsets)
    mirror = offsets[cell] + offsets[cell + 1] - 1 - np.arange(len(nodes))
    clockwise = topology.areas(points, nodes, offsets)[cell] < 0.0
    return np.where(clockwise, nodes[mirror], nodes)


def _named_nodes(data, n_points):
    """name -> node indices from point sets, cell sets and physical groups of lines and vertices, and stored masks."""
    named = {}
    for name, index in _of_user(data.point_sets):
        named.setdefault(name, []).append(np.asarray(index).ravel())
    for name, mask in (data.point_data or {}).items():
        if name.startswith(PREFIX):
            named.setdefault(unquote(name[len(PREFIX) :]), []).append(np.flatnonzero(np.asarray(mask).ravel()))
    for name, block, chosen in _named_blocks(data):
        named.setdefault(name, []).append(np.asarray(block.data)[chosen].ravel())
    named = {name: np.unique(np.concatenate(parts).astype(np.int64)) for name, parts in named.items()}
    return {name: index[(index >= 0) & (index < n_points)] for name, index in named.items()}


def _of_user(sets):
    """(name, members) of the sets that a user named: what meshio calls gmsh:... holds numbers of other things than cells."""
    return [(name, members) for name, members in (sets or {}).items() if not name.startswith("gmsh:")]


def _named_blocks(data):
    """(name, block of lines or vertices, chosen rows) of every cell set and physical group."""
    for name, rows in _of_user(data.cell_sets):
        for block, chosen in zip(data.cells, rows, strict=False):
            if block.type in LOWER and chosen is not None and len(chosen):
                yield name, block, np.asarray(chosen, dtype=np.int64)
    tags = (data.cell_data or {}).get("gmsh:physical", [])
    for name, value in (data.field_data or {}).items():
        for block, tag in zip(data.cells, tags, strict=False):
            if block.type in LOWER and np.size(value) == 2 and value[1] == LOWER.index(block.type):
                yield name, block, np.asarray(tag) == value[0]


def _meshio_mesh(meshio, mesh):
    """meshio.Mesh: runs of cells with the same number of corners form the blocks, sections are masks on the points."""
    sizes = np.diff(mesh.offsets)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(sizes)) + 1, [len(sizes)]])
    kind = {3: "triangle", 4: "quad"}
    blocks = [
        (kind.get(sizes[a], "polygon"), mesh.nodes[mesh.offsets[a] : mesh.offsets[b]].reshape(b - a, -1))
        for a, b in zip(starts[:-1], starts[1:], strict=True)
    ]
    data = {}
    for name, index in mesh.sections.items():
        mask = np.zeros(mesh.n_nodes)
        mask[index] = 1.0
        data[PREFIX + quote(name, safe="")] = mask
    return meshio.Mesh(np.column_stack([mesh.points, np.zeros(mesh.n_nodes)]), blocks, point_data=data)
