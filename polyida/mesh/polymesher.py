"""Meshes of PolyMesher (.mat), with supports and loads.

PolyMesher's and PolyTop's variables in a MATLAB file are Node, Element, Supp and Load; nodes are counted from 1. Node (n, 2); Element: a cell array of rows of nodes, counter-clockwise; Supp: rows (node, 1 if x is fixed, 1 if y is fixed); Load: rows (node,
Fx, Fy). Section, a cell array of rows (name, row of nodes), is an extension of polyida that PolyMesher ignores.
Source: Talischi, Paulino, Pereira, Menezes, PolyMesher, Struct. Multidisc. Optim. 45 (2012) and PolyTop, ibid.
"""

import math

import numpy as np

from polyida.errors import InputError
from polyida.mesh.raw import RawMesh

LARGEST = 1100  # numbers for each byte of a file: zlib makes at most 1032 bytes of one
NAMES = {"Node": ("node",), "Element": ("element", "elem"), "Supp": ("supp",), "Load": ("load",), "Section": ("section",)}


def read_mat(path):
    """Return the RawMesh of a .mat file with Node and Element, as variables or as fields of one structure (as PolyTop's fem)."""
    variables = _variables(path)
    points = _numbers(variables["Node"], "Node")
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InputError(f"Node has shape {points.shape}; it must have a row (x, y) for each node")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"Node({bad[0] + 1},:) is {points[bad[0]].tolist()}; all coordinates must be finite")
    cells = [_cell(row, i, len(points)) for i, row in enumerate(_rows(variables["Element"]), 1)]
    supports, loads = (_table(variables.get(name), name, len(points)) for name in ("Supp", "Load"))
    for node, pair in supports.items():
        if not set(pair) <= {0.0, 1.0}:
            raise InputError(f"Supp of node {node + 1} is {list(pair)}; each must be 1 (fixed) or 0 (free)")
    fixed = {node: (x == 1.0, y == 1.0) for node, (x, y) in supports.items()}
    rows = variables.get("Section")
    rows = rows if isinstance(rows, np.ndarray) and rows.ndim == 2 and rows.shape[1] == 2 else []
    named = {str(np.ravel(name)[0]): np.ravel(nodes).astype(np.int64) - 1 for name, nodes in rows}
    return RawMesh(points, cells, named, fixed, loads)


def write_mat(mesh, path):
    """Write a MATLAB file with PolyMesher's Node, Element, Supp and Load, the last two may be empty, and the sections; nodes count from 1."""
    from scipy.io import savemat

    names = np.empty((len(mesh.sections), 2), dtype=object)
    for row, (name, nodes) in zip(names, mesh.sections.items(), strict=True):
        row[:] = name, nodes[None] + 1.0
    cells = np.empty((mesh.n_cells, 1), dtype=object)
    cells[:, 0] = [mesh.cell(i)[None] + 1.0 for i in range(mesh.n_cells)]
    tables = {name: [[n + 1.0, *pair] for n, pair in data.items()] for name, data in (("Supp", mesh.supports), ("Load", mesh.loads))}
    tables = {name: np.array(rows, dtype=float).reshape(-1, 3) for name, rows in tables.items()}
    savemat(path, {"Node": mesh.points, "Element": cells, **tables, "Section": names}, appendmat=False)


def _variables(path):
    """{name in NAMES: value} of the variables of a file, or of the fields of the first structure with Node and Element."""
    from scipy.io import loadmat, whosmat

    try:
        most = LARGEST * (path.stat().st_size + 1)
        for name, shape, _ in whosmat(path, appendmat=False):
            if not 0 <= math.prod(shape) <= most or min(shape, default=0) < 0:
                raise InputError(f"{name!r:.80} has the shape {shape}, which the file is too short for")
        data = loadmat(path, appendmat=False)
    except NotImplementedError:
        raise InputError("it is a MATLAB file of version 7.3; save it by save(name, 'Node', 'Element', 'Supp', 'Load', '-v7')") from None
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001, the file is the cause, whatever the exception
        raise InputError(f"it cannot be read as a MATLAB file: {type(error).__name__}: {' '.join(str(error).split())[:200]}") from None
    data = {name: value for name, value in data.items() if not name.startswith("__")}
    structures = [value for value in data.values() if getattr(value, "dtype", None) is not None and value.dtype.names and value.size == 1]
    for fields in (data, *({name: one.item()[i] for i, name in enumerate(one.dtype.names)} for one in structures)):
        known = {ours: value for ours, theirs in NAMES.items() for name, value in fields.items() if name.lower() in theirs}
        if known.keys() >= {"Node", "Element"}:
            return known
    raise InputError(f"it has the variables {', '.join(map(repr, data)) or 'none'}; PolyMesher's meshes have Node and Element")


def _numbers(value, name):
    """A variable of a .mat file as an array of floats. Raises InputError, with its name, if it is no array of numbers."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iufb":
        raise InputError(f"{name} is no array of numbers")
    return value.astype(float)


def _rows(element):
    """Rows of a cell array, or of a matrix whose rows may be padded with NaN or 0."""
    if isinstance(element, np.ndarray) and element.dtype.kind == "O":
        return element.ravel()
    matrix = _numbers(element, "Element")
    filled = ~np.isnan(matrix) & (matrix != 0)
    return [row[: used.sum()] if used[: used.sum()].all() else row for row, used in zip(np.atleast_2d(matrix), np.atleast_2d(filled))]


def _cell(row, number, n_nodes):
    """Nodes of one cell, counted from 0; messages name it as MATLAB does."""
    nodes = _numbers(row, f"Element{{{number}}}").ravel()
    if len(nodes) < 3:
        raise InputError(f"Element{{{number}}} has {len(nodes)} nodes; it needs at least 3")
    wrong = np.flatnonzero(~((nodes >= 1) & (nodes <= n_nodes) & (nodes == np.round(nodes))))
    if wrong.size:
        node = nodes[wrong[0]]
        zero = "; MATLAB counts from 1, for lists from 0 there is pi.mesh.from_lists" if node == 0 else ""
        raise InputError(f"Element{{{number}}} names node {node:g}; Node has rows 1..{n_nodes}{zero}")
    return nodes.astype(np.int64) - 1


def _table(value, name, n_nodes):
    """{node from 0: (a, b)} of rows (node, a, b); supports of one node in several rows are combined."""
    rows = _numbers(np.zeros((0, 3)) if value is None or np.size(value) == 0 else value, name)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise InputError(f"{name} has shape {rows.shape}; it must have rows (node, x, y)")
    table = {}
    for i, (node, *pair) in enumerate(rows.tolist(), 1):
        if node not in range(1, n_nodes + 1):
            raise InputError(f"{name}({i},1) is {node:g}; it must be a node, 1..{n_nodes}")
        if not np.isfinite(pair).all():
            raise InputError(f"{name}({i},:) is {[node, *pair]}; all must be finite")
        before = table.get(int(node) - 1)
        if before and name == "Load":
            raise InputError(f"{name}({i},1) is {node:g}, which an earlier row has; each node has one row")
        table[int(node) - 1] = tuple(map(max, pair, before or pair))
    return table
