"""Clamp: a section held fast to the ground, or two sections welded."""

from dataclasses import dataclass

from polyida.errors import InputError
from polyida.joint.attachment import ground, labelled, of_node, require_sides
from polyida.joint.rows import LinearRows


@dataclass(frozen=True, eq=False)
class Clamp:
    """A section held fast.

    To ground: every node of the section keeps its place, `phi = X_i - x_i` (2 rows a node, m).
    Between bodies: point and direction of both sections move as one, `phi = (x_A - x_B, d_A - Q d_B)` (4 rows), Q being the
    rotation between the directions in the reference configuration. phi_q is constant in both cases.
    Raises InputError where a section between bodies is a single node, which has no direction.
    """

    a: object
    b: object = ground
    name: str | None = None
    multiplier = "force on b, N (and moment over length for the direction)"

    def __post_init__(self):
        label = labelled("Clamp", self.name)
        require_sides(label, self.a, self.b)
        if self.a is ground or self.b is ground:
            return
        for side in (self.a, self.b):
            if side.turn_weights is None:
                raise InputError(f"{label}: {side!r} has no direction; use a section of two nodes or more")

    def rows(self):
        """The constraint rows, as data."""
        if self.b is ground:
            return [LinearRows(of_node(self.a.body, int(node)), ground, "point") for node in self.a.nodes]
        if self.a is ground:
            return [LinearRows(ground, of_node(self.b.body, int(node)), "point") for node in self.b.nodes]
        return [LinearRows(self.a, self.b, "point"), LinearRows(self.a, self.b, "direction")]
