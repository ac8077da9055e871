"""The assembly of an Abaqus file: instances of parts in their places, and sets across them.

Nodes of the assembly itself are reference points, not nodes of the mesh. Source: the Abaqus keywords reference guide.
"""

import numpy as np

from polyida.errors import InputError
from polyida.mesh.abaqus_part import LOWER, OUT_OF_PLANE, numbers, targets


class Assembly:
    """Instances in their places, and sets of their nodes; nodes by their order among all instances."""

    def __init__(self):
        """Make an assembly without instances, sets and nodes of its own."""
        self.instances, self.sets = {}, {}  # by their names in capitals
        self.element_sets = {}  # {name in capitals: {(instance, number of an element): None}}
        self.points, self.cells, self.middles, self.notes = [], [], [], []
        self.references = set()  # numbers of the assembly's own nodes
        self.turned = set()

    def add(self, instance):
        """Append the points and cells of an instance behind those of the others."""
        instance.first = len(self.points)
        self.instances[instance.name.upper()] = instance
        self.points += instance.points
        self.cells += [instance.first + cells for cells in instance.cells]
        self.middles += [instance.first + sides for sides in instance.middles]
        self.turned.update(instance.first + node for node in instance.turned)

    def sections(self):
        """{name: nodes}. A set of an instance is called 'instance.set' if several have cells, or the assembly has a set of its name."""
        meshes = [instance for instance in self.instances.values() if instance.cells]
        if len(meshes) > 1:
            names = listed(instance.name for instance in meshes)
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
        """Node numbers, counted from 0 over all instances, of a node number or a set, also one of an instance, 'A-1.7' or 'A-1.Root'.

        None for a reference point or what has no nodes. Raises InputError, which begins with `what`, for a name that two instances have.
        """
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
        """What an unknown node or set is, in words for a message."""
        target = str(target).strip('"')
        if target.isdecimal():
            return f"node {target}, which is {'a reference point' if int(target) in self.references else 'no node of an instance'}"
        return f"the set {target!r}, which no *NSET before it gives"

    # --- keywords

    def take_node(self, options, rows):
        """*NODE of the assembly: store the numbers of its reference points, which are nodes of no instance."""
        self.references.update(int(number) for number, *_ in rows)

    def take_element(self, options, rows):
        """*ELEMENT of the assembly: springs and the like are left out. Raises InputError for others."""
        kind = options.get("TYPE", "none").upper()
        if not LOWER.match(kind):
            raise InputError(f"elements of type {kind} belong to the assembly; put them into a part")
        self.notes.append(f"left out the elements of type {kind}")

    def take_nset(self, options, rows):
        """*NSET: nodes of an instance, of an element set, or by numbers and names."""
        name = options.get("NSET", "")
        if "INSTANCE" in options:
            instance = self._instance(options["INSTANCE"])
            nodes = [instance.first + node for node in instance.members(options, rows)]
        elif "ELSET" in options:
            members = self._elements(options["ELSET"], f"set {name!r}")
            nodes = [instance.first + node for instance, number in members for node in instance.nodes_of_elements([number])]
        else:
            nodes = [node for target in targets(options, rows) for node in self._of(target, f"set {name!r}")]
        if nodes:
            self.sets.setdefault(name.upper(), (name, {}))[1].update(dict.fromkeys(nodes))

    def take_elset(self, options, rows):
        """*ELSET: add elements of instances to the set of this name.

        The nodes of lines and points among them are added to a set of nodes too.
        """
        name = options.get("ELSET", "")
        what = f"set {name!r}"
        if "INSTANCE" in options:
            instance = self._instance(options["INSTANCE"])
            members = [(instance, number) for target in targets(options, rows) for number in instance.element_numbers(target, what)]
        else:
            members = [member for target in targets(options, rows) for member in self._elements(target, what)]
        self.element_sets.setdefault(name.upper(), {}).update(dict.fromkeys(members))
        nodes = [
            instance.first + node
            for instance, number in members
            if number in instance.lower
            for node in instance.nodes_of_elements([number])
        ]
        if nodes:
            self.sets.setdefault(name.upper(), (name, {}))[1].update(dict.fromkeys(nodes))

    def _elements(self, target, what):
        """Pairs (instance, number of an element) of an element set of the assembly, or of 'A-1.7' and 'A-1.Set' of an instance."""
        target = str(target).replace('"', "")
        if target.upper() in self.element_sets:
            return list(self.element_sets[target.upper()])
        owner, point, name = target.partition(".")
        if point and owner.upper() in self.instances:
            instance = self.instances[owner.upper()]
            return [(instance, number) for number in instance.element_numbers(name, what)]
        if target.isdecimal():
            return []  # an element of the assembly itself, which is no plane cell
        raise InputError(f"{what} names the element set {target!r}, which no *ELSET before it gives")

    def take_transform(self, options, rows):
        """*TRANSFORM: note the nodes of a set whose axes are turned, so that supports and loads on them are refused."""
        self.turned.update(self.find(options.get("NSET", ""), "it") or [])

    def _of(self, target, what):
        """The nodes that an entry of a set names, by their order among all instances; none for a reference point."""
        nodes = self.find(target, what)
        if nodes is None and not (str(target).isdecimal() and int(target) in self.references):
            raise InputError(f"{what} names {self.missing(target)}")
        return nodes or []

    def _instance(self, name):
        """The instance of a name, in capitals or not. Raises InputError with the known names if there is none."""
        if name.upper() not in self.instances:
            raise InputError(f"there is no instance {name!r}; there are {listed(instance.name for instance in self.instances.values())}")
        return self.instances[name.upper()]


def placed(instance, rows):
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
    there = start + along + np.cos(angle) * (arm - along) + np.sin(angle) * np.cross(axis, arm)
    size = np.ptp(points, axis=0).max(initial=0.0)
    if len(points) and np.ptp(there[:, 2]) > OUT_OF_PLANE * size >= np.ptp(points[:, 2]):
        raise InputError(
            f"instance {instance.name!r} is turned out of the plane z = constant, by {turn[6]:g} degrees about {axis.tolist()}"
        )
    return there.tolist()


def listed(names):
    """A text of the names in quotes, with commas between them, for messages."""
    return ", ".join(map(repr, names))
