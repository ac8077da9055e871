"""Meshes of PolyMesher (.mat) and Abaqus (.inp), with supports and loads.

PolyMesher's and PolyTop's variables in a MATLAB file are Node, Element, Supp and Load; nodes are counted from 1. Node (n, 2); Element: a cell array of rows of nodes, counter-clockwise; Supp: rows (node, 1 if x is fixed, 1 if y is fixed); Load: rows (node,
Fx, Fy). Section, a cell array of rows (name, row of nodes), is an extension of polyida that PolyMesher ignores.
Source: Talischi, Paulino, Pereira, Menezes, PolyMesher, Struct. Multidisc. Optim. 45 (2012) and PolyTop, ibid.

Of .inp *NODE, *ELEMENT, *NSET and *ELSET (of lines) of one part are read, *BOUNDARY and *CLOAD on it; other keywords are ignored. Nodes within
*ASSEMBLY are reference points, not nodes of the part. Source: the Abaqus keywords reference guide.
"""

import re

import numpy as np

from polyida.errors import InputError
from polyida.mesh.meshio_files import runs
from polyida.mesh.raw import RawMesh, guarded

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
    from scipy.io import loadmat

    try:
        with guarded(path.stat().st_size):
            data = loadmat(path, appendmat=False)
    except NotImplementedError:
        raise InputError("it is a MATLAB file of version 7.3; save it by save(name, 'Node', 'Element', 'Supp', 'Load', '-v7')") from None
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


PLANE = re.compile(r"(?:CPS|CPEG|CPE|CAX|CGAX|M3D|SFM3D|DC2D|DCAX|AC2D|R3D|STRI|S)([34689])")  # with the number of nodes
IGNORED = re.compile(r"B\d|T\dD|PIPE|RB\dD|CONN|SPRING|DASHPOT|MASS|ROTARY|GAP|F2D|R2D|SAX|SFMAX|MAX")  # ignored: lines and points
CORNERS = {3: 3, 6: 3, 4: 4, 8: 4, 9: 4}
MOST = 10_000_000  # members of a generated set
FIXED = {"ENCASTRE": (1, 2), "PINNED": (1, 2), "XSYMM": (1,), "YSYMM": (2,), "ZSYMM": (), "XASYMM": (2,), "YASYMM": (1,)}


def read_inp(path):
    """Return the RawMesh of an .inp file. An InputError names the line."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(f"it cannot be read: {error.strerror or error}") from None
    part = _Part()
    for line, keyword, options, rows in _blocks(text):
        method = getattr(part, "take_" + keyword.lower(), None)
        try:
            if method is not None:
                method(options, rows)
        except InputError as error:
            raise InputError(f"*{keyword} in line {line}: {error}") from None
        except (ValueError, IndexError, OverflowError) as error:
            raise InputError(f"it cannot be read as .inp: *{keyword} in line {line}: {error}") from None
    return part.raw()


def write_inp(mesh, path):
    """Write elements CPS3 and CPS4, sections as node sets, loads in a static step."""
    lines = ["*HEADING", "*NODE", *(f"{i}, {x!r}, {y!r}" for i, (x, y) in enumerate(mesh.points.tolist(), 1))]
    number = 0
    for cells in runs(mesh):
        lines.append(f"*ELEMENT, TYPE=CPS{cells.shape[1]}")
        lines += [f"{number + i}, {', '.join(map(str, row))}" for i, row in enumerate((cells + 1).tolist(), 1)]
        number += len(cells)
    for name, nodes in mesh.sections.items():
        lines.append(f"*NSET, NSET={_label(name)}")
        lines += [", ".join(map(str, nodes[i : i + 16] + 1)) for i in range(0, len(nodes), 16)]
    boundary = [f"{node + 1}, {axis}, {axis}" for node, fixed in mesh.supports.items() for axis, yes in enumerate(fixed, 1) if yes]
    loads = [f"{node + 1}, {axis}, {size!r}" for node, force in mesh.loads.items() for axis, size in enumerate(force, 1)]
    lines += ["*BOUNDARY", *boundary] if boundary else []
    lines += ["*STEP", "*STATIC", "*CLOAD", *loads, "*END STEP"] if loads else []
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _label(name):
    if re.fullmatch(r"[A-Za-z]\w*", name):
        return name
    if any(sign in name for sign in '"\n\r') or len(name) > 80:
        raise InputError(f"section {name!r} cannot be a node set: its name must be one line of at most 80 letters without quotes")
    return f'"{name}"'


def _blocks(text):
    """Yield (line number, keyword, {option: value}, rows of texts) of each keyword."""
    block, more = None, False
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("**"):
            continue
        if line.startswith("*"):
            if block:
                yield block
            keyword, *options = _parts(line[1:])
            block = number, re.sub(r"\s+", "_", keyword.strip().upper()), _options(options), []
        elif more:
            block[2].update(_options(_parts(line)))
        elif block:
            block[3].append([part.strip() for part in line.removesuffix(",").split(",")])
        more = line.endswith(",") and (more or line.startswith("*"))
    if block:
        yield block


def _parts(line):
    return re.findall(r'(?:"[^"]*"|[^,"])+', line) or [""]


def _options(parts):
    pairs = (part.partition("=") for part in parts)
    return {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}


def _targets(options, rows):
    """Numbers and names in the rows of a set."""
    if "GENERATE" in options:
        rows = [range(int(first), int(last) + 1, int(step[0]) if step else 1) for first, last, *step in rows]
        if sum(map(len, rows)) > MOST:
            raise InputError(f"it generates {sum(map(len, rows))} numbers, more than a file can have")
    return [part for row in rows for part in row]


class _Part:
    """The part as read so far; nodes by their order in the file, sets by their names in capitals."""

    def __init__(self):
        self.points, self.places, self.cells, self.lines, self.notes = [], {}, [], {}, []
        self.sets, self.fixed, self.forces = {}, {}, {}
        self.in_assembly = False

    def raw(self):
        if not self.points:
            raise InputError("it cannot be read as .inp: it has no *NODE")
        supports = {node: (1 in axes, 2 in axes) for node, axes in self.fixed.items() if axes & {1, 2}}
        sets = {name: list(nodes) for name, nodes in self.sets.values()}
        return RawMesh(np.array(self.points), self.cells, sets, supports, self.forces, tuple(dict.fromkeys(self.notes)))

    def take_assembly(self, options, rows):
        self.in_assembly = True

    def take_end_assembly(self, options, rows):
        self.in_assembly = False

    def take_include(self, options, rows):
        raise InputError("it cannot be read as .inp: other files are not followed; put their lines here")

    def take_node(self, options, rows):
        if self.in_assembly:
            return
        first = len(self.points)
        for number, *place in rows:
            if int(number) in self.places:
                raise InputError(f"node {number} is given twice; a mesh is of one part, write others to files of their own")
            self.places[int(number)] = len(self.points)
            self.points.append(([float(x or 0) for x in place] + [0.0] * 3)[:3])
        if name := options.get("NSET"):
            self._add(name, range(first, len(self.points)))

    def take_element(self, options, rows):
        kind = options.get("TYPE", "").upper()
        plane = PLANE.match(kind)
        if IGNORED.match(kind) and not plane:
            # sets of line and point elements are sections
            for number, *nodes in rows if not self.in_assembly else []:
                self.lines[int(number)] = [self.places[int(node)] for node in nodes if node.isdecimal() and int(node) in self.places]
            if name := options.get("ELSET"):
                self.take_elset({"ELSET": name}, [[number] for number, *_ in rows])
            return
        if not plane:
            raise InputError(f"holds cells of type {kind or 'none'}; only plane triangles and quads can be used")
        count = int(plane[1])
        numbers = [int(part) for row in rows for part in row]
        if len(numbers) % (count + 1):
            raise InputError(f"elements of type {kind} have a number and {count} nodes; {len(numbers)} numbers are no multiple")
        table = np.array(numbers, dtype=np.int64).reshape(-1, count + 1)[:, : CORNERS[count] + 1]
        self.cells.append(np.array([[self._place(node, f"element {row[0]}") for node in row[1:]] for row in table.tolist()]))
        if count > CORNERS[count]:
            self.notes.append(f"{len(table)} {kind} became their corners, curved edges straight")

    def take_elset(self, options, rows):
        for target in _targets(options, rows):
            if str(target).isdecimal() and int(target) in self.lines:
                self._add(options.get("ELSET", ""), self.lines[int(target)])

    def take_nset(self, options, rows):
        name = options.get("NSET", "")
        if self.in_assembly and "INSTANCE" not in options:
            return
        if "ELSET" in options:
            self.notes.append(f"the node set {name!r} of an element set was left out")
        for target in _targets(options, rows):
            self._add(name, self._nodes(target, f"set {name!r}"))

    def take_boundary(self, options, rows):
        for target, first, *more in rows:
            label = FIXED.get(first.upper())
            axes = range(int(first), int(more[0] or first) + 1 if more else int(first) + 1) if label is None else label
            if len(more) > 1 and float(more[1] or 0):
                self.notes.append(f"the prescribed motion {more[1]} of {target!r} was left out")
                continue
            for node in self._known(target, "support"):
                self.fixed.setdefault(node, set()).update(axes)

    def take_cload(self, options, rows):
        for target, axis, size in rows:
            force = {"1": (float(size), 0.0), "2": (0.0, float(size))}.get(axis)
            if force is None:
                self.notes.append(f"the load on {target!r} in direction {axis} was left out")
                continue
            for node in self._known(target, "load"):
                self.forces[node] = tuple(np.add(self.forces.get(node, (0.0, 0.0)), force).tolist())

    def _add(self, name, nodes):
        self.sets.setdefault(name.upper(), (name, {}))[1].update(dict.fromkeys(nodes))  # a node of two sets is in their union once

    def _place(self, number, what):
        if int(number) not in self.places:
            raise InputError(f"{what} names node {number}, which no *NODE before it gives")
        return self.places[int(number)]

    def _nodes(self, target, what):
        """Nodes of a node number or a set's name; the name of an instance before it is ignored."""
        target = str(target).strip('"').rpartition(".")[2]
        if target.isdecimal():
            return [self._place(target, what)]
        if target.upper() not in self.sets:
            raise InputError(f"{what} names the set {target!r}, which no *NSET before it gives")
        return self.sets[target.upper()][1]

    def _known(self, target, what):
        """The same for supports and loads; a reference point of the assembly gives a note."""
        try:
            return self._nodes(target, what)
        except InputError as error:
            self.notes.append(f"left out: {error}")
            return []
