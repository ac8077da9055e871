"""Nodes, elements and sets of an Abaqus file in one numbering: of a part, of an instance, or of a file without parts.

A method take_KEYWORD(options, rows) reads the block of a keyword. Source: the Abaqus keywords reference guide.
"""

import re
from copy import copy

import numpy as np

from polyida.errors import InputError
from polyida.mesh.raw import sides_of

PLANE = re.compile(r"(?:CPS|CPEG|CPE|CAX|M3D|SFM3D|DC2D|AC2D|R3D|STRI|S)([34689])")  # with the number of nodes
AXISYMMETRIC = re.compile(r"CAX|CGAX|DCAX|DCCAX|ACAX|MAX|MGAX|SAX|SFMAX|SFMGAX|RAX|COHAX|GKAX|CINAX|FAX")
LOWER = re.compile(r"B\d|T\dD|PIPE|RB\dD|CONN|SPRING|DASHPOT|MASS|ROTARY|GAP|F2D|R2D")  # lines and points
BARS_OF_A_BOUNDARY = "T3D"  # Gmsh writes the curves of a plane mesh so
CORNERS = {3: 3, 6: 3, 4: 4, 8: 4, 9: 4}
MOST = 10_000_000  # generated numbers
FORTRAN = re.compile(r"(?<=[\d.])[dD](?=[+-]?\d)")  # the exponent of 1.D-3
OUT_OF_PLANE = 1e-9  # relative to a length


def targets(options, rows):
    """The numbers and names in the rows of a block *NSET or *ELSET; with GENERATE, all numbers of each range."""
    if "GENERATE" in options:
        rows = [range(int(first), int(last) + 1, int(step[0]) if step else 1) for first, last, *step in rows]
        _require_few(sum(map(len, rows)))
    return [part for row in rows for part in row]


def numbers(row, count):
    """The first `count` entries of a row of texts as floats; 0 for what is missing."""
    return [float(FORTRAN.sub("e", text) or 0) for text in [*row, *["0"] * count][:count]]


def _require_few(count):
    """Raise InputError if a keyword generates more than MOST numbers."""
    if count > MOST:
        raise InputError(f"it generates {count} numbers, more than a file can have")


class Part:
    """What is read of a part so far; nodes by their order in the file, sets by their names in capitals."""

    def __init__(self, name):
        """Make a part of this name without nodes, elements and sets."""
        self.name, self.part = name, name  # part: of which it is an instance
        self.notes = []
        self.points, self.labels, self.places = [], [], {}  # labels: numbers of the points in the file; places: the inverse
        self.cells, self.elements = [], {}  # elements: corners by number, as numbers of the file
        self.middles = []  # rows of both corners and the middle node of the sides of elements of order 2
        self.lower = set()  # the elements that are lines and points
        self.node_sets, self.element_sets = {}, {}  # {name in capitals: (name, {member: None})}
        self.turned = set()  # nodes whose supports and loads have directions of their own
        self.by_meshio = False  # whose types, such as CAX4P of all quads, tell the shape alone
        self.system = None  # origin and axes of the coordinates in *NODE
        self.first = 0  # of the points among those of all instances

    def instance(self, name):
        """A copy of the part under another name, to which nodes, elements and sets can be added."""
        other = Part(name)
        for field, value in vars(self).items():
            setattr(other, field, copy(value))
        other.name = name
        for sets in (other.node_sets, other.element_sets):
            sets.update({key: (called, dict(members)) for key, (called, members) in sets.items()})
        return other

    # --- what others ask

    def has(self, target):
        """True if a number is that of a node, or a name that of a set of nodes, lines or points."""
        return int(target) in self.places if target.isdecimal() else target.upper() in self.node_sets or bool(self._of_lines(target))

    def nodes(self, target, what):
        """The nodes, by their order in the file, of a node's number or of a set's name."""
        target = str(target).strip('"')
        if not self.has(target):
            raise InputError(f"{what} names {self._missing(target)}")
        if target.isdecimal():
            return [self.places[int(target)]]
        return list(self.node_sets[target.upper()][1]) if target.upper() in self.node_sets else self._of_lines(target)

    def members(self, options, rows):
        """The nodes of a block *NSET: of an element set, or of node numbers and names of node sets."""
        what = f"set {options.get('NSET', '')!r}"
        if "ELSET" in options:
            return self.nodes_of_elements(self.element_numbers(options["ELSET"], what))
        return [node for target in targets(options, rows) for node in self.nodes(target, what)]

    def element_numbers(self, target, what):
        """Numbers of the elements of an element number or of a set's name; a number that no element has is kept."""
        target = str(target).strip('"')
        if target.isdecimal():
            return [int(target)]
        if target.upper() not in self.element_sets:
            raise InputError(f"{what} names the element set {target!r}, which no *ELSET before it gives")
        return list(self.element_sets[target.upper()][1])

    def nodes_of_elements(self, members):
        """The nodes of elements, given by their numbers, in their order and each once."""
        nodes = (self.places[node] for number in members for node in self.elements.get(number, []))
        return list(dict.fromkeys(nodes))

    def sections(self):
        """{name: nodes} of the node sets, and of the element sets of lines and points without a node set of their name."""
        lines = {key: (name, self._of_lines(key)) for key, (name, _) in self.element_sets.items()}
        return {name: list(nodes) for name, nodes in (lines | self.node_sets).values() if nodes}

    # --- keywords

    def take_heading(self, options, rows):
        """*HEADING: note whether its text says that meshio wrote the file."""
        self.by_meshio = any("written by meshio" in text for row in rows for text in row)

    def take_system(self, options, rows):
        """*SYSTEM: the origin and axes of the nodes that follow, from points on them. Raises InputError for axes out of the plane."""
        if not rows:
            self.system = None
            return
        origin, along = np.array(numbers(rows[0], 6)).reshape(2, 3)
        x = along - origin if len(rows[0]) > 3 else np.array([1.0, 0.0, 0.0])
        x = x if len(rows) > 1 else x * (1.0, 1.0, 0.0)
        z = np.cross(x, numbers(rows[1], 3) - origin) if len(rows) > 1 else np.array([0.0, 0.0, 1.0])
        if not x.any() or not z.any():
            raise InputError("its points lie on one line")
        x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
        if np.abs(z[:2]).max() > OUT_OF_PLANE:
            raise InputError("it turns nodes out of the plane z = constant; only axes within it can be read")
        self.system = origin, np.array([x, np.cross(z, x), z])

    def take_node(self, options, rows):
        """*NODE: rectangular or cylindrical coordinates in the system in force."""
        kind = options.get("SYSTEM", "R").upper()
        if kind not in ("R", "C"):
            raise InputError(f"SYSTEM is {kind}; it must be R (rectangular) or C (cylindrical)")
        table = np.array([numbers(place, 3) for _, *place in rows]).reshape(-1, 3)
        if kind == "C":
            radius, angle = table[:, 0].copy(), np.radians(table[:, 1])
            table[:, 0] = radius * np.cos(angle)
            table[:, 1] = radius * np.sin(angle)
        if self.system is not None:
            origin, axes = self.system
            table = origin + table @ axes
        known = len(self.points)
        for (label, *_), place in zip(rows, table.tolist(), strict=True):
            self._add_node(int(label), place)
        self._name_nodes(options, range(known, len(self.points)))

    def take_ngen(self, options, rows):
        """*NGEN: add nodes at equal distances on the straight line between two nodes."""
        if "LINE" in options or "SYSTEM" in options:
            raise InputError("only straight lines between two nodes can be generated; let Abaqus write the nodes out")
        chosen = []
        for first, last, *step in rows:
            ends = [self.nodes(end, "the line")[0] for end in (first, last)]
            step = int(step[0] or 1) if step else 1
            count = _steps(int(last) - int(first), step)
            chosen += [ends[0], *self._between(*ends, int(first), step, count), ends[1]]
        self._name_nodes(options, chosen)

    def take_nfill(self, options, rows):
        """Nodes on straight lines between those of two sets, in the order of their numbers."""
        if extra := [name for name in ("BIAS", "SINGULAR", "TWO STEP") if name in options]:
            raise InputError(f"{extra[0]} cannot be read; let Abaqus write the nodes out")
        chosen = []
        for first, last, *more in rows:
            count, step = (int(text or 1) for text in [*more, "1", "1"][:2])
            ends = [sorted(self.nodes(end, "the fill"), key=self.labels.__getitem__) for end in (first, last)]
            if len(ends[0]) != len(ends[1]):
                raise InputError(f"the sets {first!r} and {last!r} have {len(ends[0])} and {len(ends[1])} nodes; they must have as many")
            _require_few(count * len(ends[0]))
            for a, b in zip(*ends, strict=True):
                chosen += [a, *self._between(a, b, self.labels[a], step, count), b]
        self._name_nodes(options, chosen)

    def take_element(self, options, rows):
        """*ELEMENT: plane cells, and lines and points, which only name nodes. Raises InputError for other types."""
        kind = options.get("TYPE", "").upper()
        plane = PLANE.match(kind)
        if AXISYMMETRIC.match(kind) and not self.by_meshio:
            raise InputError(f"holds elements of type {kind}, which are axisymmetric; only plane triangles and quads can be used")
        if plane:
            self._add_cells(kind, int(plane[1]), rows)
        elif LOWER.match(kind):
            for number, *nodes in rows:
                self._add_element(int(number), [int(node) for node in nodes if node.isdecimal() and int(node) in self.places])
            self.lower.update(int(number) for number, *_ in rows)
            if not kind.startswith(BARS_OF_A_BOUNDARY) and not self.by_meshio:
                self.notes.append(f"left out the elements of type {kind}")
        else:
            raise InputError(f"holds cells of type {kind or 'none'}; only plane triangles and quads can be used")
        if name := options.get("ELSET"):
            count = int(plane[1]) + 1 if plane else 0
            first = [part for row in rows for part in row][::count] if plane else [row[0] for row in rows]
            _join(self.element_sets, name, map(int, first))

    def take_elgen(self, options, rows):
        """*ELGEN: add copies of an element along a row and in further rows."""
        chosen = []
        for row in rows:
            entries = [int(text or 1) for text in [*row, *["1"] * 8][:8]]
            master, count, node_step, step, lines, line_node_step, line_step, layers = entries
            if master not in self.elements or master in self.lower:
                raise InputError(f"it copies element {master}, which no *ELEMENT of plane cells before it gives")
            if layers > 1:
                raise InputError(f"it makes {layers} layers of element {master}; a plane mesh has one")
            _require_few(count * lines)
            for i, j in ((i, j) for j in range(lines) for i in range(count) if i or j):
                shift = i * node_step + j * line_node_step
                number = master + i * step + j * line_step
                self._add_element(number, [node + shift for node in self.elements[master]])
                self.cells.append(np.array([self._places(number, self.elements[number])]))
                chosen.append(number)
            chosen.append(master)
        if name := options.get("ELSET"):
            _join(self.element_sets, name, chosen)

    def take_nset(self, options, rows):
        """*NSET: add the nodes of the block to the set of nodes of that name."""
        _join(self.node_sets, options.get("NSET", ""), self.members(options, rows))

    def take_elset(self, options, rows):
        """*ELSET: elements by numbers and by names of other sets."""
        what = f"set {options.get('ELSET', '')!r}"
        _join(
            self.element_sets,
            options.get("ELSET", ""),
            [n for target in targets(options, rows) for n in self.element_numbers(target, what)],
        )

    def take_solid_section(self, options, rows):
        """*SOLID SECTION: note that bars of its element set are left out; only plane cells are read."""
        name = options.get("ELSET", "")
        if self._of_lines(name):
            self.notes.append(f"left out the bars of the element set {name!r}")

    def take_transform(self, options, rows):
        """*TRANSFORM: note the nodes of a set whose axes are turned, so that supports and loads on them are refused."""
        self.turned.update(self.nodes(options.get("NSET", ""), "it"))

    # --- nodes and elements

    def _add_node(self, label, place):
        """Append a node with the number `label` of the file at `place`, its coordinates. Raises InputError if the number is taken."""
        if label in self.places:
            raise InputError(f"node {label} is given twice")
        self.places[label] = len(self.points)
        self.labels.append(label)
        self.points.append(place)

    def _name_nodes(self, options, nodes):
        """Add the nodes of a block *NODE or *NGEN to the set that its option NSET names, if it names one."""
        if name := options.get("NSET"):
            _join(self.node_sets, name, nodes)

    def _between(self, first, last, label, step, count):
        """Add the nodes that cut a line into equal parts; those that are there stay. Return them."""
        ends = np.array([self.points[first], self.points[last]])
        for i in range(1, count):
            if label + i * step not in self.places:
                self._add_node(label + i * step, (ends[0] + i / count * (ends[1] - ends[0])).tolist())
        return [self.places[label + i * step] for i in range(1, count)]

    def _add_element(self, number, nodes):
        """Store the nodes of an element under its number. Raises InputError if the number is used already."""
        if number in self.elements:
            raise InputError(f"element {number} is given twice")
        self.elements[number] = nodes

    def _add_cells(self, kind, count, rows):
        """Append plane elements of `count` nodes each, with the middles of their sides if these are nodes."""
        flat = [int(part) for row in rows for part in row]
        if len(flat) % (count + 1):
            raise InputError(f"elements of type {kind} have a number and {count} nodes; {len(flat)} numbers are no multiple")
        table, corners = np.array(flat, dtype=np.int64).reshape(-1, count + 1).tolist(), CORNERS[count]
        for number, *nodes in table:
            self._add_element(number, nodes[:corners])
        self.cells.append(np.array([self._places(number, nodes[:corners]) for number, *nodes in table]))
        if count > corners:
            middles = np.array([self._places(number, nodes[corners : 2 * corners]) for number, *nodes in table])
            self.middles.append(sides_of(self.cells[-1], middles))
        if not kind.startswith(("CPS", "CPE")) and not self.by_meshio:
            self.notes.append(f"of elements of type {kind}, which are not plane stress or strain, only the shape is used")

    def _places(self, number, nodes):
        """The nodes of an element by their order in the file. Raises InputError for an unknown one."""
        for node in nodes:
            if node not in self.places:
                raise InputError(f"element {number} names {self._missing(str(node))}")
        return [self.places[node] for node in nodes]

    # --- sets

    def _missing(self, target):
        """What an unknown node or set is, in words for a message."""
        return (
            f"node {target}, which no *NODE before it gives"
            if target.isdecimal()
            else f"the set {target!r}, which no *NSET before it gives"
        )

    def _of_lines(self, name):
        """The nodes of the line and point elements in an element set, each once; empty for an unknown set."""
        _, members = self.element_sets.get(name.upper(), (name, {}))
        return self.nodes_of_elements(number for number in members if number in self.lower)


def _steps(length, step):
    """The number of steps of whole length `step` in a whole `length`. Raises InputError if it is not whole or not positive."""
    if step == 0 or length % step or length // step < 1:
        raise InputError(f"its numbers are {length} apart, in steps of {step}; the steps must lead from the first to the last")
    _require_few(length // step)
    return length // step


def _join(sets, name, members):
    """Add members to the set of that name; each member is in it once."""
    sets.setdefault(name.upper(), (name, {}))[1].update(dict.fromkeys(members))
