"""Meshes of Abaqus (.inp): parts placed by their instances, with sets, supports and loads.

*BOUNDARY and *CLOAD count as far as the first step; other loads and constraints are named in a note, materials and output are ignored. Nodes
of the assembly itself are reference points, not nodes of the mesh. Source: the Abaqus keywords reference guide.
"""

import contextlib
import re

import numpy as np

from polyida.errors import InputError
from polyida.mesh.abaqus_part import LOWER, OUT_OF_PLANE, Part, numbers, targets
from polyida.mesh.meshio_files import runs
from polyida.mesh.raw import RawMesh

FIXED = {"ENCASTRE": (1, 2), "PINNED": (1, 2), "XSYMM": (1,), "YSYMM": (2,), "ZSYMM": (), "XASYMM": (2,), "YASYMM": (1,)}
REFUSED = {"NMAP", "NCOPY", "ELCOPY", "IMPERFECTION", "IMPORT", "SYMMETRIC_MODEL_GENERATION"}  # they make or move nodes and elements
LEFT_OUT = {"DLOAD", "DSLOAD", "TIE", "EQUATION", "MPC", "COUPLING", "KINEMATIC_COUPLING", "DISTRIBUTING_COUPLING", "RIGID_BODY"}
LEFT_OUT |= {"EMBEDDED_ELEMENT", "CONTACT", "CONTACT_PAIR", "MODEL_CHANGE"}


def read_inp(path):
    """Return the RawMesh of an .inp file. An InputError names the line."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(f"it cannot be read: {error.strerror or error}") from None
    file = _File()
    for line, keyword, options, rows in _blocks(text):
        with _named(keyword, line):
            file.take(line, keyword, options, rows)
    return file.raw()


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


@contextlib.contextmanager
def _named(keyword, line):
    """Errors name the block, by its keyword and line."""
    try:
        yield
    except InputError as error:
        raise InputError(f"*{keyword} in line {line}: {error}") from None
    except (ValueError, IndexError, OverflowError) as error:
        raise InputError(f"it cannot be read as .inp: *{keyword} in line {line}: {error}") from None


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


class _File:
    """The file as read so far: its parts, the assembly of their instances, supports and loads."""

    def __init__(self):
        self.main = Part("")  # what stands outside of parts
        self.parts, self.assembly = {}, None
        self.scope = self.main  # takes the keywords of nodes, elements and sets
        self.rows_of_instance = []
        self.applied = []  # (step, line, keyword, rows) of supports and loads
        self.step = 0
        self.notes = []
        self.fixed, self.forces = {}, {}

    def take(self, line, keyword, options, rows):
        if keyword in REFUSED:
            raise InputError("it makes or moves nodes or elements in a way that is not followed; let Abaqus write them out")
        if keyword in LEFT_OUT:
            self.notes.append(f"left out *{keyword.replace('_', ' ')}")
        if keyword in ("BOUNDARY", "CLOAD"):
            self._apply(line, keyword, options, rows)
            return
        name = "take_" + keyword.lower()
        method = getattr(self, name, None) or getattr(self.scope, name, None)
        if method is None:
            return
        if "INPUT" in options:
            self.take_include(options, rows)
        method(options, rows)

    def raw(self):
        """Supports and loads find their nodes when all instances are placed."""
        assembly = self._assembled()
        for _, line, keyword, rows in self.applied:
            with _named(keyword, line):
                (self._support if keyword == "BOUNDARY" else self._load)(assembly, rows)
        for node in assembly.turned & (self.fixed.keys() | self.forces.keys()):
            raise InputError(
                f"*TRANSFORM turns the directions of the supports and loads at {assembly.points[node][:2]}; let them be along x and y"
            )
        supports = {node: (1 in axes, 2 in axes) for node, axes in self.fixed.items() if axes & {1, 2}}
        sections = assembly.sections()
        notes = self.notes + [note for instance in assembly.instances.values() for note in instance.notes] + assembly.notes
        return RawMesh(np.array(assembly.points), assembly.cells, sections, supports, self.forces, tuple(dict.fromkeys(notes)))

    def _assembled(self):
        """The assembly of the file, or one of its only part."""
        if self.assembly is not None:
            if not self.assembly.instances:
                raise InputError("its *ASSEMBLY has no *INSTANCE")
            placed = {instance.part for instance in self.assembly.instances.values()}
            self.notes += [
                f"left out the part {part.name!r}, of which there is no *INSTANCE"
                for part in self.parts.values()
                if part.part not in placed
            ]
        if self.parts and self.main.points:
            raise InputError("it has nodes outside of its parts; put them into a part")
        if self.assembly is not None:
            return self.assembly
        if len(self.parts) > 1:
            raise InputError(f"it has the parts {_list(part.name for part in self.parts.values())} and no *ASSEMBLY that places them")
        part = next(iter(self.parts.values()), self.main)
        if not part.points:
            raise InputError("it cannot be read as .inp: it has no *NODE")
        assembly = _Assembly()
        assembly.add(part)
        return assembly

    # --- keywords

    def take_include(self, options, rows):
        raise InputError("it cannot be read as .inp: other files are not followed; put their lines here")

    def take_part(self, options, rows):
        name = options.get("NAME", "")
        if name.upper() in self.parts:
            raise InputError(f"there are two parts {name!r}")
        self.scope = self.parts[name.upper()] = Part(name)

    def take_end_part(self, options, rows):
        self.scope = self.main

    def take_assembly(self, options, rows):
        if self.assembly is not None:
            raise InputError("there are two; a file has one")
        self.scope = self.assembly = _Assembly()

    def take_instance(self, options, rows):
        name, part = options.get("NAME", ""), options.get("PART", "")
        if self.assembly is None:
            raise InputError("it stands outside of *ASSEMBLY")
        if "INSTANCE" in options or "LIBRARY" in options:
            raise InputError(f"instance {name!r} is of another file, which is not followed; put its part here")
        if name.upper() in self.assembly.instances:
            raise InputError(f"there are two instances {name!r}")
        if part.upper() not in self.parts:
            raise InputError(f"instance {name!r} is of part {part!r}; there are {_list(part.name for part in self.parts.values())}")
        self.scope = self.parts[part.upper()].instance(name)
        self.rows_of_instance = rows

    def take_end_instance(self, options, rows):
        self.scope.points = _placed(self.scope, self.rows_of_instance)
        self.assembly.add(self.scope)
        self.scope = self.assembly

    def take_step(self, options, rows):
        self.step += 1

    # --- supports and loads

    def _apply(self, line, keyword, options, rows):
        if self.step > 1:
            self.notes.append(f"left out *{keyword} of step {self.step}; supports and loads are those of the first")
            return
        if options.get("OP", "").upper() == "NEW":  # in place of those before the step
            self.applied = [entry for entry in self.applied if entry[0] == self.step or entry[2] != keyword]
        self.applied.append((self.step, line, keyword, rows))

    def _support(self, assembly, rows):
        for target, first, *more in rows:
            label = FIXED.get(first.upper())
            axes = range(int(first), int(more[0] or first) + 1 if more else int(first) + 1) if label is None else label
            if len(more) > 1 and float(more[1] or 0):
                self.notes.append(f"the prescribed motion {more[1]} of {target!r} was left out")
                continue
            for node in self._known(assembly, target, "support"):
                self.fixed.setdefault(node, set()).update(axes)

    def _load(self, assembly, rows):
        for target, axis, size in rows:
            force = {"1": (float(size), 0.0), "2": (0.0, float(size))}.get(axis)
            if force is None:
                self.notes.append(f"the load on {target!r} in direction {axis} was left out")
                continue
            for node in self._known(assembly, target, "load"):
                self.forces[node] = tuple(np.add(self.forces.get(node, (0.0, 0.0)), force).tolist())

    def _known(self, assembly, target, what):
        """Nodes of a target; none, with a note, of a reference point of the assembly."""
        nodes = assembly.find(target, what)
        if nodes is None:
            self.notes.append(f"left out: {what} names {assembly.missing(target)}")
        return nodes or []


class _Assembly:
    """Instances in their places, and sets of their nodes; nodes by their order among all instances."""

    def __init__(self):
        self.instances, self.sets = {}, {}  # by their names in capitals
        self.points, self.cells, self.notes = [], [], []
        self.references = set()  # numbers of the assembly's own nodes
        self.turned = set()

    def add(self, instance):
        instance.first = len(self.points)
        self.instances[instance.name.upper()] = instance
        self.points += instance.points
        self.cells += [instance.first + cells for cells in instance.cells]
        self.turned.update(instance.first + node for node in instance.turned)

    def sections(self):
        """{name: nodes}. A set of an instance is called 'instance.set' if several have cells, or the assembly has a set of its name."""
        meshes = [instance for instance in self.instances.values() if instance.cells]
        if len(meshes) > 1:
            names = _list(instance.name for instance in meshes)
            self.notes.append(f"the instances {names} are one mesh, joined where their nodes are in the same place")
        named = {}
        for instance in self.instances.values():
            for name, nodes in instance.sections().items():
                plain = meshes == [instance] and name.upper() not in self.sets
                named[name if plain else f"{instance.name}.{name}"] = [instance.first + node for node in nodes]
        for name, nodes in self.sets.values():
            if name in named:
                raise InputError(f"the set {name!r} of the assembly is called like a set of an instance")
            named[name] = list(nodes)
        return named

    def find(self, target, what):
        """Nodes of a number, a set, or of those of an instance as 'A-1.7' or 'A-1.Root'; None if there are none."""
        target = str(target).strip('"')
        if target.upper() in self.sets:
            return list(self.sets[target.upper()][1])
        if target.isdecimal() and int(target) in self.references:
            return None
        holders = [instance for instance in self.instances.values() if instance.has(target)]
        if not holders and "." in target:
            return self._of_instance(target, what)
        if len(holders) > 1:
            first, second = holders[0].name, holders[1].name
            raise InputError(f"{what} names {target!r}, which the instances {first!r} and {second!r} have; say {first}.{target}")
        return [instance.first + node for instance in holders for node in instance.nodes(target, what)] or None

    def _of_instance(self, target, what):
        """Nodes of 'A-1.7' or 'A-1.Root'; of a set of the assembly those in the instance."""
        owner, _, name = target.replace('"', "").partition(".")
        instance = self._instance(owner)
        if instance.has(name):
            return [instance.first + node for node in instance.nodes(name, what)]
        _, nodes = self.sets.get(name.upper(), (name, {}))
        return [node for node in nodes if 0 <= node - instance.first < len(instance.points)] or None

    def missing(self, target):
        target = str(target).strip('"')
        if target.isdecimal():
            return f"node {target}, which is {'a reference point' if int(target) in self.references else 'no node of an instance'}"
        return f"the set {target!r}, which no *NSET before it gives"

    # --- keywords

    def take_node(self, options, rows):
        self.references.update(int(number) for number, *_ in rows)

    def take_element(self, options, rows):
        kind = options.get("TYPE", "none").upper()
        if not LOWER.match(kind):
            raise InputError(f"elements of type {kind} belong to the assembly; put them into a part")
        self.notes.append(f"left out the elements of type {kind}")

    def take_nset(self, options, rows):
        name = options.get("NSET", "")
        if "INSTANCE" in options:
            instance = self._instance(options["INSTANCE"])
            nodes = [instance.first + node for node in instance.members(options, rows)]
        else:
            nodes = [node for target in targets(options, rows) for node in self._of(target, f"set {name!r}")]
        if nodes:
            self.sets.setdefault(name.upper(), (name, {}))[1].update(dict.fromkeys(nodes))

    def take_elset(self, options, rows):
        if "INSTANCE" not in options:
            self.notes.append(f"left out the element set {options.get('ELSET')!r} of the assembly")
            return
        instance = self._instance(options["INSTANCE"])
        if nodes := instance.line_nodes(options, rows):
            name = options.get("ELSET", "")
            self.sets.setdefault(name.upper(), (name, {}))[1].update(dict.fromkeys(instance.first + node for node in nodes))

    def take_transform(self, options, rows):
        self.turned.update(self.find(options.get("NSET", ""), "it") or [])

    def _of(self, target, what):
        """Nodes of an entry of a set; none of a reference point."""
        nodes = self.find(target, what)
        if nodes is None and not (str(target).isdecimal() and int(target) in self.references):
            raise InputError(f"{what} names {self.missing(target)}")
        return nodes or []

    def _instance(self, name):
        if name.upper() not in self.instances:
            raise InputError(f"there is no instance {name!r}; there are {_list(instance.name for instance in self.instances.values())}")
        return self.instances[name.upper()]


def _placed(instance, rows):
    """Points of an instance moved by the first row, then turned about the axis from a to b of the second, by an angle in degrees."""
    points = np.array(instance.points).reshape(-1, 3)
    move, turn = np.zeros(3), None
    for row in rows:
        if len(row) > 3:
            turn = numbers(row, 7)
        else:
            move = np.array(numbers(row, 3))
    moved = points + move
    if turn is None or turn[6] == 0.0:
        return moved.tolist()
    start, end = np.array(turn[:3]), np.array(turn[3:6])
    if (start == end).all():
        raise InputError(f"instance {instance.name!r} turns about an axis from {turn[:3]} to {turn[3:6]}; the points must differ")
    axis, angle = (end - start) / np.linalg.norm(end - start), np.radians(turn[6])
    arm = moved - start
    along = np.outer(arm @ axis, axis)
    placed = start + along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm)
    size = np.ptp(points, axis=0).max(initial=0.0)
    if len(points) and np.ptp(placed[:, 2]) > OUT_OF_PLANE * size >= np.ptp(points[:, 2]):
        raise InputError(
            f"instance {instance.name!r} is turned out of the plane z = constant, by {turn[6]:g} degrees about {axis.tolist()}"
        )
    return placed.tolist()


def _list(names):
    return ", ".join(map(repr, names))
