"""Attachments: weighted sets of nodes at which joints, masses and loads take hold of a body."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.joint.formula import Piece, Vector
from polyida.validation import vector2

ROUND = 1e-6  # second moments that differ by less are equal: which is the larger would be up to round-off


@dataclass(frozen=True, eq=False)
class Ground:
    """The fixed frame. A joint to `ground` itself holds the other side where it is in the reference configuration;
    `ground.at(point)` is a place of its own.

    point: (2,), m, direction: (2,), of length one; None of `ground` itself.
    """

    point: Any = None
    direction: Any = None
    has_direction = True
    turns_only = False
    body = None

    def at(self, point: ArrayLike, direction: ArrayLike = (1.0, 0.0)) -> "Ground":
        """A place of the ground, m, with a direction, of any length (the x axis where none is given). Raises InputError."""
        place, way = vector2("ground.at", "point", point), vector2("ground.at", "direction", direction)
        if not np.hypot(*way) > 0:
            raise InputError(f"ground.at: direction = {direction!r} must not be zero")
        return Ground(place, way / np.hypot(*way))

    def facing(self, other):
        """The place where `other` is in the reference configuration, unless it has one."""
        return self if self.point is not None else Ground(other.point, other.direction)

    @property
    def x(self) -> Vector:
        """Its place, a Vector of a joint's formula."""
        return self._vector("point", self.point)

    @property
    def d(self) -> Vector:
        """Its direction, a Vector of a joint's formula."""
        return self._vector("direction", self.direction)

    def _vector(self, part, value):
        return Vector((Piece(constant=complex(*value), of_ground=((self, part, 1 + 0j),)),))

    def __repr__(self):
        return "ground" if self.point is None else f"ground at ({self.point[0]:.6g}, {self.point[1]:.6g})"


ground = Ground()


@dataclass(frozen=True, eq=False)
class Attachment:
    """A weighted set of nodes of a body.

    Its point is `x = sum w_i x_i` (weights (k,), sum 1); its direction `d = sum w'_i x_i` (turn_weights (k,), sum 0, |d| = 1 in the
    reference configuration), None where the set has no extent. length: of the section in m, 0 for a node.
    """

    body: Any
    nodes: np.ndarray
    weights: np.ndarray
    turn_weights: np.ndarray | None
    length: float
    name: str
    advice = "use a section of two nodes or more"  # where it has no direction

    @property
    def point(self) -> NDArray:
        """Reference position of the point, (2,), m: to the round-off of one place."""
        return self.body.points[self.nodes[0]] + self.weights @ _arms(self.body, self.nodes)

    @property
    def direction(self) -> NDArray | None:
        """Reference direction, (2,), of length one, or None: the same wherever the body lies."""
        return None if self.turn_weights is None else self.turn_weights @ _arms(self.body, self.nodes)

    def on(self, body: Any) -> "Attachment":
        """The same attachment of another body like its own."""
        return replace(self, body=body)

    @property
    def turns_only(self) -> bool:
        """Whether its body may hold the length of its direction."""
        return self.body.turns_only

    @property
    def has_direction(self) -> bool:
        """Whether there is a direction."""
        return self.turn_weights is not None

    @property
    def x(self) -> Vector:
        """Its point, a Vector of a joint's formula."""
        return Vector((Piece(((self, "point", 1 + 0j),)),))

    @property
    def d(self) -> Vector:
        """Its direction, a Vector of a joint's formula. Raises InputError where it has none."""
        if not self.has_direction:
            raise InputError(f"{self!r} has no direction; {self.advice}")
        return Vector((Piece(((self, "direction", 1 + 0j),)),))

    def share(self, force: ArrayLike) -> NDArray:
        """What of a force (2,) at the point acts on each node, (k, 2)."""
        return np.outer(self.weights, np.asarray(force, float))

    def each(self) -> list["Attachment"]:
        """Its nodes, each an attachment of its own."""
        return [of_node(self.body, int(node)) for node in self.nodes]

    def __repr__(self):
        return f"{self.body.label} {self.name}"


def of_node(body, node):
    """One node: it has a point and no direction."""
    return Attachment(body, np.array([node], np.int32), np.ones(1), None, 0.0, f"node {node}")


def _arms(body, nodes):
    """Reference positions of the nodes against the first of them, (k, 2), m: free of where the body lies."""
    places = body.placed.points[nodes]
    return places - places[0]


def of_section(body, section, name):
    """Mean of a section by its weights w; `w'_i = w_i (eta_i - mean) / sum w (eta - mean)^2`, eta along its main axis.

    They are tributary lengths, of the rim of a hole such that the mean is the hole's centre.
    The main axis is that of the largest second moment, x where the two are one but for round-off, so that the direction has length
    one on straight and round sections alike.
    """
    nodes, weights = np.asarray(section.nodes, np.int32), np.asarray(section.weights, float)
    if len(nodes) == 1:
        return of_node(body, int(nodes[0]))
    offset = _arms(body, nodes)
    offset = offset - weights @ offset
    axis = _main_axis((weights[:, None] * offset).T @ offset)
    eta = offset @ axis
    eta = eta - weights @ eta
    moment = weights @ eta**2
    turn = weights * eta / moment if moment > 0 else None
    return Attachment(body, nodes, weights, None if turn is None else turn - turn.mean(), section.length, name)


def _main_axis(moments):
    """Axis of the larger second moment, towards growing x or y."""
    sizes, axes = np.linalg.eigh(moments)
    if sizes[0] > (1.0 - ROUND) * sizes[1]:
        return np.array([1.0, 0.0])
    return axes[:, 1] * (1.0 if axes[np.argmax(np.abs(axes[:, 1])), 1] > 0 else -1.0)


def labelled(kind, name):
    """What a part is called in a message; raises InputError for a name that is no text."""
    if name is not None and not (isinstance(name, str) and name):
        raise InputError(f"{kind}: name = {name!r} must be a text")
    return kind if name is None else f"{kind} {name!r}"


def require_attachment(part, given):
    """Raise InputError naming the part unless `given` is an attachment of a body."""
    if not isinstance(given, Attachment):
        given = getattr(given, "label", None) or repr(given)
        raise InputError(f"{part}: {given[:80]} is no attachment; use plate.section(...), plate.rim(...), plate.node(...) or body.at(...)")


def require_places(part, *sides):
    """Raise InputError for `ground` itself, which has no place."""
    if any(side.point is None for side in sides):
        raise InputError(f"{part}: ground has no place by itself; use ground.at(point)")


def require_directions(part, *sides):
    """Raise InputError for a side that has no direction."""
    for side in sides:
        if not side.has_direction:
            raise InputError(f"{part}: {side!r} has no direction; {side.advice}")


def require_sides(part, a, b):
    """Raise InputError unless both sides are attachments or ground, not both ground, not one body twice."""
    grounds = [isinstance(side, Ground) for side in (a, b)]
    for side, fixed in zip((a, b), grounds):
        if not fixed:
            require_attachment(part, side)
    if all(grounds):
        raise InputError(f"{part}: both sides are ground; one must be an attachment of a body")
    if not any(grounds) and a.body is b.body:
        raise InputError(f"{part}: both sides belong to {a.body.label}; they must be of two bodies, or one of them ground")
