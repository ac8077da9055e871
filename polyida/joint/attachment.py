"""Attachments: weighted sets of nodes that joints, masses and loads act on, and the ground; the base class of joints, bodies and forces."""

from dataclasses import dataclass, replace
from inspect import Parameter, Signature
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from polyida import registry
from polyida.errors import InputError, printable
from polyida.joint.formula import Summand, Vector
from polyida.mesh.sections import edges_within, sides_within
from polyida.validation import labelled, vector2

SIDE = np.array([[4.0, 2.0, -1.0], [2.0, 16.0, 2.0], [-1.0, 2.0, 4.0]]) / 30.0  # int psi_i psi_j ds of a quadratic side over its length
ROUND = 1e-6  # second moments count as equal if their relative difference is less: otherwise round-off would choose the larger one


@dataclass(frozen=True, eq=False)
class Ground:
    """The fixed frame. `ground` alone stands for the place of the joint's other side in the reference configuration; `ground.at(point)` is a fixed place.

    Attributes
    ----------
    point : (2,) float, m, or None for `ground` itself
    direction : (2,) float, unit vector, or None for `ground` itself
    """

    point: Any = None
    direction: Any = None
    has_direction = True
    has_edges = turns_only = False
    body = None

    def at(self, point: "ArrayLike", direction: "ArrayLike" = (1.0, 0.0)) -> "Ground":
        """Return a place of the ground (m) with a direction of any length. Raise InputError for a zero direction."""
        place, along = vector2("ground.at", "point", point), vector2("ground.at", "direction", direction)
        if not np.hypot(*along) > 0:
            raise InputError(f"ground.at: direction = {direction!r} must not be zero")
        return Ground(place, along / np.hypot(*along))

    def facing(self, other):
        """Return this place, or the reference place of `other` if this is `ground` itself."""
        return self if self.point is not None else Ground(other.point, other.direction)

    @property
    def size(self) -> float:
        """Largest coordinate of the point, m."""
        return float(np.abs(self.point).max())

    @property
    def x(self) -> Vector:
        """Its place as a Vector of a joint's formula."""
        return self._vector("point", self.point)

    @property
    def d(self) -> Vector:
        """Its direction as a Vector of a joint's formula."""
        return self._vector("direction", self.direction)

    def _vector(self, part, value):
        """A constant vector (2,) as a Vector of a joint's formula; part: "point" or "direction", which it is of this ground."""
        return Vector((Summand(constant=complex(*value), of_ground=((self, part, 1 + 0j),)),))

    def __repr__(self):
        """ "ground", with the coordinates of its point if it has one."""
        return "ground" if self.point is None else f"ground at ({self.point[0]:.6g}, {self.point[1]:.6g})"


ground = Ground()


@dataclass(frozen=True, eq=False)
class Attachment:
    """A weighted set of nodes of a body: its point is `x = sum w_i x_i`, its direction `d = sum w'_i x_i`, |d| = 1 in the reference configuration.

    Attributes
    ----------
    body : body that the nodes belong to
    nodes : (k,) int
    weights : (k,) float, sum 1
    turn_weights : (k,) float, sum 0, 1/m, or None if the set has no extent
    length : float, m, of the section; 0 for a node
    """

    body: Any
    nodes: np.ndarray
    weights: np.ndarray
    turn_weights: np.ndarray | None
    length: float
    name: str
    advice = "use a section of two nodes or more"  # for the message that it has no direction

    @property
    def point(self) -> np.ndarray:
        """Reference position of the point, (2,), m."""
        return self.body.points[self.nodes[0]] + self.weights @ _from_first(self.body, self.nodes)

    @property
    def direction(self) -> np.ndarray | None:
        """The direction of the attachment in the reference configuration, (2,), a unit vector, or None if it has none."""
        return None if self.turn_weights is None else self.turn_weights @ _from_first(self.body, self.nodes)

    @property
    def size(self) -> float:
        """Largest coordinate of its body in the reference configuration, m."""
        return float(np.abs(self.body.points).max())

    def on(self, body: Any) -> "Attachment":
        """Return this attachment, with its nodes and weights, of a similar body."""
        return replace(self, body=body)

    @property
    def turns_only(self) -> bool:
        """True if the body keeps the length |d| of the direction constant."""
        return self.body.turns_only

    @property
    def has_direction(self) -> bool:
        """True if the attachment has a direction besides its point."""
        return self.turn_weights is not None

    @property
    def has_edges(self) -> bool:
        """True if it is a section of a plate or the edges of another body, not a point: contact then takes it as edges."""
        return len(self.nodes) > 1 and (self.body.is_full or self.body.plate is not None)

    @property
    def depth(self) -> float:
        """Length of the largest cell edge in a section of a rigid plate, whose own edges are longer, m; else 0."""
        x = self.body.points[edges_within(self.body.mesh, self.nodes)] if self.has_edges and self.turns_only else np.zeros((0, 2, 2))
        return float(np.linalg.norm(x[:, 1] - x[:, 0], axis=1).max(initial=0.0))

    def _outline(self):
        """(nodes, edges (k, 2) between them, with the body on their left); of a rigid plate without the nodes within straight lines."""
        edges, x = edges_within(self.body.mesh, self.nodes), self.body.points
        ahead, behind, within = dict(edges.tolist()), dict(edges[:, ::-1].tolist()), []
        if not self.turns_only or len(ahead) < len(edges):
            return self.nodes, edges
        for node in edges[:, 0].tolist():
            if node in behind and behind[node] != ahead[node]:
                a, b = behind[node], ahead[node]
                (ux, uy), (vx, vy) = x[node] - x[a], x[b] - x[node]
                if abs(ux * vy - uy * vx) <= ROUND * (ux * vx + uy * vy):
                    within.append(node)
                    ahead[a], behind[b] = b, a
                    del ahead[node], behind[node]
        return self.nodes[~np.isin(self.nodes, within)], np.array(list(ahead.items()))

    def edge_ends(self) -> np.ndarray:
        """Return the numbers (k, 2) within `each()` of the ends of its edges, with the body on their left."""
        return _places(*self._outline())

    @property
    def x(self) -> Vector:
        """Its point as a Vector of a joint's formula."""
        return Vector((Summand(((self, "point", 1 + 0j),)),))

    @property
    def d(self) -> Vector:
        """Its direction as a Vector of a joint's formula. Raises InputError if there is none."""
        require_directions("", self)
        return Vector((Summand(((self, "direction", 1 + 0j),)),))

    def share(self, force: "ArrayLike") -> np.ndarray:
        """Return the forces on the k nodes of this attachment, (k, 2): of each its weight times force (2,), which acts at the point."""
        return np.outer(self.weights, np.asarray(force, float))

    def each(self) -> list["Attachment"]:
        """Return one attachment for each node; of a rigid plate none within straight edges."""
        return [of_node(self.body, int(node)) for node in self._outline()[0]]

    def __repr__(self):
        """The labels of the body and of the attachment, for messages."""
        return f"{self.body.label} {printable(self.name)}"


def of_node(body, node):
    """Return the attachment of one node: it has a point and no direction."""
    return Attachment(body, np.array([node], np.int32), np.ones(1), None, 0.0, f"node {node}")


def _from_first(body, nodes):
    """Reference positions relative to the first node, (k, 2), m: no digits are lost if the body lies far from the origin."""
    places = body.placed.points[nodes]
    return places - places[0]


def _places(nodes, edges):
    """Indices (k, 2) of the ends of edges in the list of nodes."""
    order = np.argsort(nodes)
    return order[np.searchsorted(nodes, edges, sorter=order)]


def of_section(body, section, name):
    """Return the mean of a section, `sum w_i x_i`, and its direction: `int eta x ds / int eta^2 ds` of the field x that is linear along its edges.

    Of order 2, x is quadratic along its sides. eta is the distance from the mean along the main axis: that of the largest second moment, towards growing x or y; the x axis if both moments are
    equal up to round-off. Sums over nodes in place of the integrals have an error of the square of the edges' length where a section warps.
    """
    nodes, weights = np.asarray(section.nodes, np.int32), np.asarray(section.weights, float)
    if len(nodes) == 1:
        return of_node(body, int(nodes[0]))
    offset, ends = _from_first(body, nodes), _places(nodes, edges_within(body.mesh, nodes))
    offset = offset - weights @ offset
    sixth = np.linalg.norm(offset[ends[:, 1]] - offset[ends[:, 0]], axis=1)[:, None] / 6.0
    if body.mesh.order == 2:
        sides = _places(nodes, sides_within(body.mesh, nodes))
        lengths = np.linalg.norm(offset[sides[:, 2]] - offset[sides[:, 0]], axis=1)

    def integrals(x):
        """Of the nodes' shape functions times x; without edges, x by the weights."""
        if len(ends) and body.mesh.order == 2:
            shares = lengths[:, None] * (x[sides] @ SIDE)
            return np.bincount(sides.ravel(), shares.ravel(), len(x))
        at_ends = sixth * (x[ends] + x[ends].sum(axis=1, keepdims=True))
        return np.bincount(ends.ravel(), at_ends.ravel(), len(x)) if len(ends) else weights * x

    moments = offset.T @ np.stack([integrals(x) for x in offset.T], axis=1)
    sizes, axes = np.linalg.eigh(0.5 * (moments + moments.T))
    axis = axes[:, 1] * (1.0 if axes[np.argmax(np.abs(axes[:, 1])), 1] > 0 else -1.0)
    eta = offset @ (np.array([1.0, 0.0]) if sizes[0] > (1.0 - ROUND) * sizes[1] else axis)
    turn = integrals(eta - weights @ eta)
    turn, moment = turn - weights * turn.sum(), turn @ eta
    return Attachment(body, nodes, weights, turn / moment if moment > 0 else None, section.length, name)


def require_attachment(part, value):
    """Raise InputError naming the part unless the value is an attachment of a body."""
    if not isinstance(value, Attachment):
        value = getattr(value, "label", None) or repr(value)
        raise InputError(f"{part}: {value[:80]} is no attachment; use plate.section(...), plate.rim(...), plate.node(...) or body.at(...)")


def require_point_first(label, point, line):
    """Raise InputError if a place of the ground with a direction of its own stands where a point is asked for, and a body's point for the line."""
    drawn = isinstance(point, Ground) and point.point is not None and not np.array_equal(point.direction, (1.0, 0.0))
    if drawn and not isinstance(line, Ground) and not line.has_edges and not np.array_equal(point.direction, line.direction):
        raise InputError(f"{label}: a = {point!r} has a direction, but a is the point and b the line: exchange the sides")


def require_places(part, *sides):
    """Raise InputError for `ground` itself, which has no place."""
    if any(side.point is None for side in sides):
        raise InputError(f"{part}: ground has no place by itself; use ground.at(point)")


def require_directions(part, *sides):
    """Raise InputError if one of the sides has no direction; part: name of the joint or force, in the message; it may be empty."""
    for side in sides:
        if not side.has_direction:
            raise InputError(f"{part}{': ' * bool(part)}{side!r} has no direction; {side.advice}")


def require_sides(part, a, b):
    """Raise InputError unless a and b are attachments of two bodies, or one of them is ground."""
    grounds = [isinstance(side, Ground) for side in (a, b)]
    for side, fixed in zip((a, b), grounds):
        if not fixed:
            require_attachment(part, side)
    if all(grounds):
        raise InputError(f"{part}: both sides are ground; one must be an attachment of a body")
    if not any(grounds) and a.body is b.body:
        raise InputError(f"{part}: both sides belong to {a.body.label}; they must belong to two bodies, or one of them must be ground")


class OwnPart:
    """A part that a user can subclass: a frozen dataclass with a field `name`; its other fields are its data, which files store."""

    name: str | None = None
    _own: ClassVar[bool] = False  # False: only a base of other classes
    by_numba = False  # True if numba compiles the functions of the class (jit/user_functions.py)

    def __init_subclass__(cls, part: bool = True, **options):
        """Register the class for files; part=False: it is only a base of other classes."""
        super().__init_subclass__(**options)
        cls._own = part
        if part:
            registry.parts[registry.name_of(cls)] = cls

    def __new__(cls, *args, **kwargs):
        """Raises InputError if a class has fields that are not those of a dataclass: Python's own message would be of __init__."""
        for kind in (kind for kind in cls.__mro__ if vars(kind).get("_own")):
            own = [name for name, hint in vars(kind).get("__annotations__", {}).items() if "ClassVar" not in str(hint)]
            if "__dataclass_fields__" not in vars(kind) and (own or "__init__" in vars(kind)):
                raise InputError(
                    f"{kind.__name__}: its fields need @dataclass(frozen=True, eq=False) above the class, in place of __init__"
                )
        return super().__new__(cls)

    @property
    def label(self) -> str:
        """Kind and name of the part for messages."""
        return labelled(type(self).__name__, self.name)


OwnPart.__new__.__signature__ = Signature([Parameter("cls", Parameter.POSITIONAL_ONLY)])  # type: ignore[attr-defined]  # of its classes in help()
