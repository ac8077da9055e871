"""Meshes of Abaqus (.inp): parts placed by their instances, with sets, supports and loads.

*BOUNDARY and *CLOAD count as far as the first step; other loads and constraints are named in a note, materials and output are ignored.
Source: the Abaqus keywords reference guide.
"""

import contextlib
import re

import numpy as np

from polyida.errors import InputError
from polyida.mesh.abaqus_assembly import Assembly, listed, placed
from polyida.mesh.abaqus_part import Part
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
    """The name of a section as that of a node set, in quotes unless it is a word. Raises InputError if it can be none."""
    if re.fullmatch(r"[A-Za-z]\w*", name):
        return name
    if any(sign in name for sign in '"\n\r') or len(name) > 80:
        raise InputError(f"section {name!r} cannot be a node set: its name must be one line of at most 80 letters without quotes")
    return f'"{name}"'


@contextlib.contextmanager
def _named(keyword, line):
    """Context in which an InputError or an error of reading numbers becomes an InputError with the keyword and line of the block."""
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
    """The parts of a line between commas, a list of str; a comma within double quotes does not separate."""
    return re.findall(r'(?:"[^"]*"|[^,"])+', line) or [""]


def _options(parts):
    """{KEY in capitals: value without quotes} of parts such as "nset=left"; the value is "" where a part has no "="."""
    pairs = (part.partition("=") for part in parts)
    return {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}


class _File:
    """The file as read so far: its parts, the assembly of their instances, supports and loads."""

    def __init__(self):
        """Make a file without parts; what stands outside of parts is read into `main`."""
        self.main = Part("")  # what stands outside of parts
        self.parts = {}
        self.assembly = None
        self.scope = self.main  # takes the keywords of nodes, elements and sets
        self.rows_of_instance = []
        self.applied = []  # (step, line, keyword, rows) of supports and loads
        self.step = 0
        self.notes = []
        self.fixed, self.forces = {}, {}

    def take(self, line, keyword, options, rows):
        """Read the block of a keyword: note or refuse it, or give it to the method take_KEYWORD of the file or of its open part."""
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
        """The RawMesh of the file: instances are placed first, then supports and loads find their nodes."""
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
        middles = np.concatenate(assembly.middles) if assembly.middles else None
        notes = tuple(dict.fromkeys(notes))
        return RawMesh(np.array(assembly.points), assembly.cells, sections, supports, self.forces, notes, middles=middles)

    def _assembled(self):
        """The assembly of the file; if it has none, a new one of its only part."""
        if self.assembly is not None:
            if self.scope is not self.assembly:
                raise InputError(f"*INSTANCE {self.scope.name!r} has no *END INSTANCE")
            if not self.assembly.instances:
                raise InputError("its *ASSEMBLY has no *INSTANCE")
            used = {instance.part for instance in self.assembly.instances.values()}
            self.notes += [
                f"left out the part {part.name!r}, of which there is no *INSTANCE" for part in self.parts.values() if part.part not in used
            ]
        if self.parts and self.main.points:
            raise InputError("it has nodes outside of its parts; put them into a part")
        if self.assembly is not None:
            return self.assembly
        if len(self.parts) > 1:
            raise InputError(f"it has the parts {listed(part.name for part in self.parts.values())} and no *ASSEMBLY that places them")
        part = next(iter(self.parts.values()), self.main)
        if not part.points:
            raise InputError("it cannot be read as .inp: it has no *NODE")
        assembly = Assembly()
        assembly.add(part)
        return assembly

    # --- keywords

    def take_include(self, options, rows):
        """Refuse a keyword that reads another file (INPUT=...): always raise InputError."""
        raise InputError("it cannot be read as .inp: other files are not followed; put their lines here")

    def take_part(self, options, rows):
        """*PART: open a new part, into which nodes and elements go."""
        name = options.get("NAME", "")
        self._require_within(self.main)
        if name.upper() in self.parts:
            raise InputError(f"there are two parts {name!r}")
        self.scope = self.parts[name.upper()] = Part(name)

    def take_end_part(self, options, rows):
        """*END PART: nodes, elements and sets that follow belong to the file again, not to the part."""
        self.scope = self.main

    def take_assembly(self, options, rows):
        """*ASSEMBLY: open the assembly, of which a file has one."""
        if self.assembly is not None:
            raise InputError("there are two; a file has one")
        self._require_within(self.main)
        self.scope = self.assembly = Assembly()

    def take_instance(self, options, rows):
        """*INSTANCE: open a copy of a part as the current scope; rows are kept and place it at *END INSTANCE.

        Raises InputError for a wrong one.
        """
        name, part = options.get("NAME", ""), options.get("PART", "")
        if self.assembly is None:
            raise InputError("it stands outside of *ASSEMBLY")
        self._require_within(self.assembly)
        if "INSTANCE" in options or "LIBRARY" in options:
            raise InputError(f"instance {name!r} is of another file, which is not followed; put its part here")
        if name.upper() in self.assembly.instances:
            raise InputError(f"there are two instances {name!r}")
        if part.upper() not in self.parts:
            raise InputError(f"instance {name!r} is of part {part!r}; there are {listed(part.name for part in self.parts.values())}")
        self.scope = self.parts[part.upper()].instance(name)
        self.rows_of_instance = rows

    def take_end_instance(self, options, rows):
        """*END INSTANCE: place the open instance and add it to the assembly."""
        if self.assembly is None or self.scope in (self.main, self.assembly) or self.scope in self.parts.values():
            raise InputError("there is no *INSTANCE before it")
        self.scope.points = placed(self.scope, self.rows_of_instance)
        self.assembly.add(self.scope)
        self.scope = self.assembly

    def _require_within(self, scope):
        """Raise InputError unless `scope`, the part, instance, assembly or file itself, is the open one."""
        if self.scope is not scope:
            name = getattr(self.scope, "name", "")
            raise InputError(f"it stands within {'*PART or *INSTANCE ' + repr(name) if name else '*ASSEMBLY'}, which must end before it")

    def take_step(self, options, rows):
        """*STEP: count the steps; supports and loads are stored with the number of their step."""
        self.step += 1

    # --- supports and loads

    def _apply(self, line, keyword, options, rows):
        """Keep a block of supports or loads until all nodes are known; those of later steps are left out with a note."""
        if self.step > 1:
            self.notes.append(f"left out *{keyword} of step {self.step}; supports and loads are those of the first")
            return
        if options.get("OP", "").upper() == "NEW":  # in place of those before the step
            self.applied = [entry for entry in self.applied if entry[0] == self.step or entry[2] != keyword]
        self.applied.append((self.step, line, keyword, rows))

    def _support(self, assembly, rows):
        """Fix the nodes that the rows of a *BOUNDARY name, in the directions that they name."""
        for target, first, *more in rows:
            label = FIXED.get(first.upper())
            axes = range(int(first), int(more[0] or first) + 1 if more else int(first) + 1) if label is None else label
            if len(more) > 1 and float(more[1] or 0):
                self.notes.append(f"the prescribed motion {more[1]} of {target!r} was left out")
                continue
            for node in self._known(assembly, target, "support"):
                self.fixed.setdefault(node, set()).update(axes)

    def _load(self, assembly, rows):
        """Add the forces of the rows of a *CLOAD to their nodes."""
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
