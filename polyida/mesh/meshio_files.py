"""Mesh files through meshio: VTU, VTK, OBJ and MEDIT; Gmsh's .msh is read by meshio and written here.

Files are data from anywhere: every failure inside meshio ends as an InputError. Sections in Gmsh are physical groups, of lines where
edges join their nodes, else of points. Source: the Gmsh reference manual, MSH file format, versions 2.2 and 4.1.
"""

from urllib.parse import quote, unquote

import numpy as np

from polyida.errors import InputError
from polyida.mesh.raw import RawMesh, guarded
from polyida.mesh.sections import edges_within

CORNERS = {"triangle": 3, "quad": 4}
LOWER = {"vertex": 0, "line": 1}
PREFIX = "section:"


def reader(kind, advice=""):
    """read(path) -> RawMesh of one of meshio's formats; advice: what to do where it cannot be read."""

    def read(path):
        data = _quietly(path, lambda meshio: meshio.read(path, kind), f"read as {kind}", advice)
        plane, notes, foreign = [], [], set()
        for block in data.cells:
            family = _family(block.type)
            if family in CORNERS and block.type != family:
                notes.append(f"{len(block.data)} {block.type} became {family}s of their corners, curved edges straight")
            if family == "polygon" or family in CORNERS:
                plane.append(np.asarray(block.data, dtype=np.int64)[:, : CORNERS.get(family)])
            elif family not in LOWER:
                foreign.add(block.type)
        if foreign:
            raise InputError(f"holds cells of type {', '.join(sorted(foreign))}; only plane triangles, quads and polygons can be used")
        return RawMesh(data.points, plane, _named_points(data), notes=tuple(notes))

    return read


def writer(kind):
    """write(mesh, path) of one of meshio's formats, sections as masks on the points."""

    def write(mesh, path):
        _quietly(path, lambda meshio: _meshio_mesh(meshio, mesh).write(path, kind), f"written as {kind}")

    return write


def _quietly(path, action, what, advice=""):
    """action(meshio) without its printing; meshio may print, warn, exit or raise anything at all on a bad file."""
    import meshio

    said = None
    try:
        with guarded(path.stat().st_size if path.exists() else 2**28) as said:
            return action(meshio)
    except (Exception, SystemExit) as error:  # noqa: BLE001, whatever it is, the file is to blame
        detail = " ".join(said.getvalue().split())[:200] if isinstance(error, SystemExit) else _short(error)
        raise InputError(f"it cannot be {what}: {detail or 'no reason given'}{advice}") from None


def _short(error):
    text = " ".join(str(error).split())[:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _family(kind):
    """'triangle' of 'triangle6', 'line' of 'line3', ..."""
    return kind.rstrip("0123456789")


def _named_points(data):
    """name -> points from point sets, cell sets and physical groups of lines and vertices, and stored masks."""
    named = {}
    for name, index in _of_user(data.point_sets):
        named.setdefault(name, []).append(np.asarray(index).ravel())
    for name, mask in (data.point_data or {}).items():
        if name.startswith(PREFIX):
            named.setdefault(unquote(name[len(PREFIX) :]), []).append(np.flatnonzero(np.asarray(mask).ravel()))
    for name, block, chosen in _named_blocks(data):
        named.setdefault(name, []).append(np.asarray(block.data)[chosen].ravel())
    return {name: np.unique(np.concatenate(parts).astype(np.int64)) for name, parts in named.items()}


def _of_user(sets):
    """(name, members) of the sets that a user named: what meshio calls gmsh:... holds numbers of other things than cells."""
    return [(name, members) for name, members in (sets or {}).items() if not name.startswith("gmsh:")]


def _named_blocks(data):
    """(name, block of lines or vertices, chosen rows) of every cell set and every group that has a number.

    A group of lines without a name is called by its number, one of points 'point' and its number.
    """
    for name, rows in _of_user(data.cell_sets):
        for block, chosen in zip(data.cells, rows, strict=False):
            if _family(block.type) in LOWER and chosen is not None and len(chosen):
                yield name, block, np.asarray(chosen, dtype=np.int64)
    names = {(int(v[1]), int(v[0])): name for name, v in (data.field_data or {}).items() if np.size(v) == 2}
    tags = next((data.cell_data[key] for key in ("gmsh:physical", "medit:ref") if key in (data.cell_data or {})), [])
    for block, tag in zip(data.cells, tags, strict=False):
        if (dimension := LOWER.get(_family(block.type))) is not None:
            for number in np.unique(tag[np.asarray(tag) > 0]).tolist():
                plain = str(number) if dimension else f"point {number}"
                yield names.get((dimension, number), plain), block, np.asarray(tag) == number


def _meshio_mesh(meshio, mesh):
    """meshio.Mesh: runs of cells with the same number of corners form the blocks, sections are masks on the points."""
    kind = {3: "triangle", 4: "quad"}
    blocks = [(kind.get(cells.shape[1], "polygon"), cells) for cells in runs(mesh)]
    data = {}
    for name, index in mesh.sections.items():
        mask = np.zeros(mesh.n_nodes)
        mask[index] = 1.0
        data[PREFIX + quote(name, safe="")] = mask
    return meshio.Mesh(np.column_stack([mesh.points, np.zeros(mesh.n_nodes)]), blocks, point_data=data)


def runs(mesh):
    """Arrays (m, k) of the cells, in their order, each of consecutive ones with the same number of corners."""
    sizes = np.diff(mesh.offsets)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(sizes)) + 1, [len(sizes)]])
    return [mesh.nodes[mesh.offsets[a] : mesh.offsets[b]].reshape(b - a, -1) for a, b in zip(starts[:-1], starts[1:], strict=True)]


TYPES = {(0, 1): 15, (1, 2): 1, (2, 3): 2, (2, 4): 3}  # of (dimension, corners)
BODY = "plate"  # the physical group of all cells

read_gmsh = reader("gmsh", "; where Gmsh made it, let it write version 2.2: Mesh.MshFileVersion = 2.2")


def write_gmsh_2(mesh, path):
    """Version 2.2."""
    groups = _groups(mesh)
    nodes = [f"{i} {_node_text(point)}" for i, point in enumerate(mesh.points, 1)]
    rows = [(dim, number, row) for dim, number, _, blocks in groups for block in blocks for row in (block + 1).tolist()]
    elements = [f"{i} {TYPES[dim, len(row)]} 2 {number} {number} {' '.join(map(str, row))}" for i, (dim, number, row) in enumerate(rows, 1)]
    _write_msh(path, "2.2", groups, {"Nodes": [str(len(nodes)), *nodes], "Elements": [str(len(elements)), *elements]})


def write_gmsh_4(mesh, path):
    """Version 4.1: an entity a group; all nodes lie on the surface."""
    groups, n = _groups(mesh), mesh.n_nodes
    nodes = [f"1 {n} 1 {n}", f"2 1 0 {n}", *map(str, range(1, n + 1)), *map(_node_text, mesh.points)]
    blocks = [(dim, number, block) for dim, number, _, parts in groups for block in parts]
    total = sum(len(block) for *_, block in blocks)
    elements, given = [f"{len(blocks)} {total} 1 {total}"], 0
    for dim, number, block in blocks:
        elements.append(f"{dim} {number} {TYPES[dim, block.shape[1]]} {len(block)}")
        elements += [f"{given + i} {' '.join(map(str, row))}" for i, row in enumerate((block + 1).tolist(), 1)]
        given += len(block)
    _write_msh(path, "4.1", groups, {"Entities": _entities(mesh, groups), "Nodes": nodes, "Elements": elements})


def _groups(mesh):
    """[(dimension, number, name, arrays (m, k) of nodes)] of the sections and of all cells."""
    groups = []
    for number, (name, nodes) in enumerate(mesh.sections.items(), 1):
        if any(sign in name for sign in '"\\\n\r'):
            raise InputError(f"section {name!r} cannot be a physical group: its name must be one line without quotes and backslashes")
        edges = edges_within(mesh, nodes)
        whole = np.isin(nodes, edges).all()
        groups.append((1, number, name, [edges]) if whole else (0, number, name, [nodes[:, None]]))
    return [*groups, (2, 1, BODY, runs(mesh))]


def _entities(mesh, groups):
    """Points, curves and surfaces, each with its box, its group and no bounds."""
    rows = [" ".join(str(sum(dim == wanted for dim, *_ in groups)) for wanted in range(4))]
    for dim, number, _, blocks in sorted(groups, key=lambda group: group[0]):
        corner = mesh.points[np.concatenate([block.ravel() for block in blocks])]
        box = [corner[0]] if dim == 0 else [corner.min(axis=0), corner.max(axis=0)]
        rows.append(f"{number} {' '.join(map(_node_text, box))} 1 {number}" + (" 0" if dim else ""))
    return rows


def _node_text(point):
    x, y = point.tolist()
    return f"{x!r} {y!r} 0"


def _write_msh(path, version, groups, parts):
    names = [str(len(groups)), *(f'{dim} {number} "{name}"' for dim, number, name, _ in groups)]
    parts = {"MeshFormat": [f"{version} 0 8"], "PhysicalNames": names} | parts
    path.write_text("".join("\n".join([f"${name}", *rows, f"$End{name}", ""]) for name, rows in parts.items()), encoding="utf-8")
