"""Mesh files through meshio: VTU, VTK, OBJ and MEDIT; Gmsh's .msh is read by meshio and written here.

Files are untrusted: every failure inside meshio becomes an InputError. Sections in Gmsh are physical groups, of lines if edges join their
nodes, else of points. Source: the Gmsh reference manual, MSH file format, versions 2.2 and 4.1.
"""

import re
import threading
from urllib.parse import quote, unquote

import numpy as np

from polyida.errors import InputError
from polyida.mesh.raw import RawMesh, sides_of
from polyida.mesh.sections import edges_within

CORNERS = {"triangle": 3, "quad": 4}
OF_ORDER_2 = ("triangle6", "triangle7", "quad8", "quad9")
LOWER = {"vertex": 0, "line": 1}
PREFIX = "section:"
WHOLE = re.compile(rb"(?<![\w.+-])\d{8,}(?![\w.])")
MOST = 30_000_000  # numbers and counts in a text file, if the file is shorter: larger ones take memory and time without use


def reader(kind, advice=""):
    """Return a function read(path) -> RawMesh for one of meshio's formats; advice: for the message that a file cannot be read."""

    def read(path):
        """The RawMesh of a file: plane cells, middle nodes of order 2, named points, and notes."""
        content = path.read_bytes()
        if b"$PartitionedEntities" in content or content.count(b"<Piece") > 1:  # meshio fails, or loses all cells but the last piece's
            raise InputError(f"it cannot be read as {kind}: it is divided among processes; write it as one piece")
        if b"$ParametricNodes" in content:
            raise InputError(f"it cannot be read as {kind}: its $ParametricNodes are not known; save with Mesh.SaveParametric = 0 in Gmsh")
        _require_sane(content, kind)
        data = _quietly(lambda meshio: getattr(meshio, kind).read(str(path)), f"read as {kind}", advice)
        plane, middles, notes, foreign = [], [], [], set()
        for block in data.cells:
            family = _family(block.type)
            if block.type in OF_ORDER_2:
                corners = CORNERS[family]
                middles.append(sides_of(block.data[:, :corners], block.data[:, corners : 2 * corners]))
            elif family in CORNERS and block.type != family:
                notes.append(f"{len(block.data)} {block.type} became {family}s of their corners, curved edges straight")
            if family == "polygon" or family in CORNERS:
                plane.append(np.asarray(block.data, dtype=np.int64)[:, : CORNERS.get(family)])
            elif family not in LOWER:
                foreign.add(block.type)
        if foreign:
            raise InputError(f"holds cells of type {', '.join(sorted(foreign))}; only plane triangles, quads and polygons can be used")
        return RawMesh(data.points, plane, _named_points(data), notes=tuple(notes), middles=np.concatenate(middles) if middles else None)

    return read


def writer(kind):
    """Return a function write(mesh, path) for one of meshio's formats, with sections as masks on the points."""

    def write(mesh, path):
        """Write points, cells and a mask of each section through meshio."""
        names = {3: "triangle", 4: "quad"}
        blocks = [(names.get(cells.shape[1], "polygon"), cells) for cells in runs(mesh)]
        masks = {PREFIX + quote(name, safe=""): np.isin(np.arange(mesh.n_nodes), nodes) * 1.0 for name, nodes in mesh.sections.items()}
        points = np.column_stack([mesh.points, np.zeros(mesh.n_nodes)])
        _quietly(lambda meshio: meshio.Mesh(points, blocks, point_data=masks).write(path, kind), f"written as {kind}")

    return write


def _quietly(action, what, advice=""):
    """Return action(meshio) without meshio's messages; for a bad file meshio may raise any exception."""
    meshio = _silent_meshio()
    _THIS_THREAD.silent = True
    try:
        return action(meshio)
    except (Exception, SystemExit) as error:  # noqa: BLE001, the file is the cause, whatever the exception
        text = " ".join(str(error).split())[:200]
        raise InputError(f"it cannot be {what}: {type(error).__name__}{': ' * bool(text)}{text}{advice}") from None
    finally:
        _THIS_THREAD.silent = False


_THIS_THREAD = threading.local()  # silent: True while it reads or writes here


def _silent_meshio():
    """Return meshio, whose console is silent in threads that read or write here; output of other threads and of users' own calls stays."""
    import meshio
    from meshio import _common
    from rich.console import Console

    if getattr(_common, "Console", None) is Console:  # as long as meshio prints in this way

        class Silent(Console):
            def print(self, *args, **kwargs):
                """Print, except in a thread that reads or writes a mesh here."""
                if not getattr(_THIS_THREAD, "silent", False):
                    super().print(*args, **kwargs)

        _common.Console = Silent
    return meshio


def _require_sane(content, kind):
    """Raise InputError if a whole number in a file is too large for its length: as a count or a number of a node it would take all memory.

    content: bytes of the file. kind: its format; only "gmsh", "vtk" and "medit" have such numbers.
    """
    if kind not in ("gmsh", "vtk", "medit"):
        return
    most = max(MOST, len(content))
    text = content
    if kind == "gmsh" and (binary := re.search(rb"\$MeshFormat\s+(\S+)\s+1\s", content[:200])):
        if binary[1].startswith(b"4"):
            largest = _largest_binary_tag(content, binary[1] != b"4" and not binary[1].startswith(b"4.0"))
            if largest > most:
                raise InputError(f"it cannot be read: it names node {largest}, too large a number for a file of {len(content)} bytes")
        text = b"\n".join(re.findall(rb"\$[A-Za-z]+\r?\n[ \d]+\r?\n", content))
    for number in WHOLE.finditer(text):
        if int(number[0]) > most:
            raise InputError(f"it cannot be read: it has the number {number[0].decode():.40}, too large for a file of {len(content)} bytes")


def _largest_binary_tag(content, sizes_of_eight):
    """The largest node number in a binary Gmsh file of version 4: int tags with their nodes before 4.1, then blocks of size_t."""
    place = content.find(b"$Nodes\n") + 7
    blocks, largest = int.from_bytes(content[place : place + 8], "little"), 0
    place += 32 if sizes_of_eight else 16
    for _ in range(min(blocks, len(content) // 20)):
        count = int.from_bytes(content[place + 12 : place + 20], "little")
        place += 20
        if not 0 < count <= len(content) // (32 if sizes_of_eight else 28):
            if count:
                raise InputError(f"it cannot be read: it has a block of {count} nodes, too many for a file of {len(content)} bytes")
            continue
        dtype = np.dtype("<u8") if sizes_of_eight else np.dtype([("tag", "<i4"), ("place", "<f8", 3)])
        tags = np.frombuffer(content[place : place + count * dtype.itemsize], dtype)
        tags = tags if sizes_of_eight else tags["tag"]
        largest = max(largest, int(tags.max(initial=0)))
        place += count * (32 if sizes_of_eight else 28)
    return largest


def _family(kind):
    """Kind of a cell without its number of nodes: 'triangle' of 'triangle6', 'line' of 'line3'."""
    return kind.rstrip("0123456789")


def _named_points(data):
    """{name: points} of point sets, of cell sets and physical groups of lines and vertices, and of stored masks."""
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
    """[(name, members)] of the sets that a user named; sets gmsh:... of meshio do not hold cells."""
    return [(name, members) for name, members in (sets or {}).items() if not name.startswith("gmsh:")]


def _named_blocks(data):
    """Yield (name, block of lines or vertices, rows) of every cell set and numbered group.

    The name of an unnamed group of lines is its number, of points 'point' and its number.
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


def runs(mesh):
    """Return arrays (m, k) of consecutive cells with the same number of corners."""
    sizes = np.diff(mesh.offsets)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(sizes)) + 1, [len(sizes)]])
    return [mesh.nodes[mesh.offsets[a] : mesh.offsets[b]].reshape(b - a, -1) for a, b in zip(starts[:-1], starts[1:], strict=True)]


TYPES = {(0, 1): 15, (1, 2): 1, (2, 3): 2, (2, 4): 3}  # Gmsh's element types by (dimension, corners)
BODY = "plate"  # name of the physical group of all cells

read_gmsh = reader("gmsh", "; if Gmsh wrote it, let it write version 2.2: Mesh.MshFileVersion = 2.2")


def write_gmsh_2(mesh, path):
    """Write a Gmsh file of version 2.2: nodes, and elements with their groups."""
    groups = _groups(mesh)
    nodes = [f"{i} {_node_text(point)}" for i, point in enumerate(mesh.points, 1)]
    rows = [(dim, number, row) for dim, number, _, blocks in groups for block in blocks for row in (block + 1).tolist()]
    elements = [f"{i} {TYPES[dim, len(row)]} 2 {number} {number} {' '.join(map(str, row))}" for i, (dim, number, row) in enumerate(rows, 1)]
    _write_msh(path, "2.2", groups, {"Nodes": [str(len(nodes)), *nodes], "Elements": [str(len(elements)), *elements]})


def write_gmsh_4(mesh, path):
    """Write version 4.1 with one entity for each group and all nodes on the surface."""
    groups, n = _groups(mesh), mesh.n_nodes
    nodes = [f"1 {n} 1 {n}", f"2 1 0 {n}", *map(str, range(1, n + 1)), *map(_node_text, mesh.points)]
    blocks = [(dim, number, block) for dim, number, _, parts in groups for block in parts]
    total = sum(len(block) for *_, block in blocks)
    elements, count = [f"{len(blocks)} {total} 1 {total}"], 0
    for dim, number, block in blocks:
        elements.append(f"{dim} {number} {TYPES[dim, block.shape[1]]} {len(block)}")
        elements += [f"{count + i} {' '.join(map(str, row))}" for i, row in enumerate((block + 1).tolist(), 1)]
        count += len(block)
    # points, curves and surfaces, each with its bounding box and group, without bounding entities
    entities = [" ".join(str(sum(dim == wanted for dim, *_ in groups)) for wanted in range(4))]
    for dim, number, _, parts in sorted(groups, key=lambda group: group[0]):
        corner = mesh.points[np.concatenate([block.ravel() for block in parts])]
        box = [corner[0]] if dim == 0 else [corner.min(axis=0), corner.max(axis=0)]
        entities.append(f"{number} {' '.join(map(_node_text, box))} 1 {number}" + (" 0" if dim else ""))
    _write_msh(path, "4.1", groups, {"Entities": entities, "Nodes": nodes, "Elements": elements})


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


def _node_text(point):
    """A point (2,) as the text "x y 0", its coordinates with all digits."""
    x, y = point.tolist()
    return f"{x!r} {y!r} 0"


def _write_msh(path, version, groups, parts):
    """Write a Gmsh file .msh: the header, the physical groups (dim, number, name, ...), and the further parts {name: rows of text}."""
    names = [str(len(groups)), *(f'{dim} {number} "{name}"' for dim, number, name, _ in groups)]
    parts = {"MeshFormat": [f"{version} 0 8"], "PhysicalNames": names} | parts
    path.write_text("".join("\n".join([f"${name}", *rows, f"$End{name}", ""]) for name, rows in parts.items()), encoding="utf-8")
