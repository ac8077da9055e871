"""What meshio reads and writes: Gmsh, VTU, VTK, OBJ and MEDIT.

Files are data from anywhere: every failure inside meshio ends as an InputError.
"""

from urllib.parse import quote, unquote

import numpy as np

from polyida.errors import InputError
from polyida.mesh.files.guarded import guarded
from polyida.mesh.files.raw import RawMesh

CORNERS = {"triangle": 3, "quad": 4}
LOWER = {"vertex": 0, "line": 1}
PREFIX = "section:"


def reader(kind, advice=""):
    """read(path) -> RawMesh of one of meshio's formats; advice: what to do where it cannot be read."""

    def read(path):
        return _raw(_quietly(path, lambda meshio: meshio.read(path, kind), f"read as {kind}", advice))

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


def _raw(data):
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
