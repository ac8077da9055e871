"""Gmsh's .msh, read by meshio and written as text: sections are physical groups, of lines where edges join their nodes, else of points.

Source of the formats: the Gmsh reference manual, MSH file format, versions 2.2 and 4.1.
"""

import numpy as np

from polyida.errors import InputError
from polyida.mesh.files.meshio_files import reader, runs
from polyida.mesh.sections import edges_within

TYPES = {(0, 1): 15, (1, 2): 1, (2, 3): 2, (2, 4): 3}  # of (dimension, corners)
BODY = "plate"  # the physical group of all cells

read = reader("gmsh", "; where Gmsh made it, let it write version 2.2: Mesh.MshFileVersion = 2.2")


def write_2(mesh, path):
    """Version 2.2."""
    groups = _groups(mesh)
    nodes = [f"{i} {_place(point)}" for i, point in enumerate(mesh.points, 1)]
    rows = [(dim, number, row) for dim, number, _, blocks in groups for block in blocks for row in (block + 1).tolist()]
    elements = [f"{i} {TYPES[dim, len(row)]} 2 {number} {number} {' '.join(map(str, row))}" for i, (dim, number, row) in enumerate(rows, 1)]
    _write(path, "2.2", groups, {"Nodes": [str(len(nodes)), *nodes], "Elements": [str(len(elements)), *elements]})


def write_4(mesh, path):
    """Version 4.1: an entity a group; all nodes lie on the surface."""
    groups, n = _groups(mesh), mesh.n_nodes
    nodes = [f"1 {n} 1 {n}", f"2 1 0 {n}", *map(str, range(1, n + 1)), *map(_place, mesh.points)]
    blocks = [(dim, number, block) for dim, number, _, parts in groups for block in parts]
    total = sum(len(block) for *_, block in blocks)
    elements, given = [f"{len(blocks)} {total} 1 {total}"], 0
    for dim, number, block in blocks:
        elements.append(f"{dim} {number} {TYPES[dim, block.shape[1]]} {len(block)}")
        elements += [f"{given + i} {' '.join(map(str, row))}" for i, row in enumerate((block + 1).tolist(), 1)]
        given += len(block)
    _write(path, "4.1", groups, {"Entities": _entities(mesh, groups), "Nodes": nodes, "Elements": elements})


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
        rows.append(f"{number} {' '.join(map(_place, box))} 1 {number}" + (" 0" if dim else ""))
    return rows


def _place(point):
    x, y = point.tolist()
    return f"{x!r} {y!r} 0"


def _write(path, version, groups, parts):
    names = [str(len(groups)), *(f'{dim} {number} "{name}"' for dim, number, name, _ in groups)]
    parts = {"MeshFormat": [f"{version} 0 8"], "PhysicalNames": names} | parts
    path.write_text("".join("\n".join([f"${name}", *rows, f"$End{name}", ""]) for name, rows in parts.items()), encoding="utf-8")
