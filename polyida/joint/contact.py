"""Contact without stiffness: gaps that carry pressure alone, and may open."""

from dataclasses import dataclass, field
from functools import cached_property

from polyida.errors import InputError
from polyida.fields import check, optional
from polyida.joint.attachment import Ground, require_directions, require_places, require_point_first
from polyida.joint.edges import FacingEdges
from polyida.joint.formula import Row, Vector, cross, dot
from polyida.joint.joint import FORCE, Joint
from polyida.validation import named_keywords, number, positive, settle


def require_contact(label, joint):
    """Raise InputError unless restitution and friction of a joint are in [0, 1] and at least 0."""
    number(label, "friction", joint.friction, "no unit", 0.0)
    if number(label, "restitution", joint.restitution, "no unit", 0.0) > 1.0:
        raise InputError(f"{label}: restitution = {joint.restitution!r} must be in [0, 1]")


@named_keywords
@dataclass(frozen=True, eq=False)
class Contact(Joint):
    """Unilateral contact without stiffness, of a point or the nodes of a section, with a line, a circle from outside, or edges of a body.

    A gap for each point, `phi = d_B x (x_A - x_B) >= 0`, m, on the left of the line through b along its direction; about b with a radius R
    `phi = (w . w - R^2) / (2 R) >= 0`, w = x_A - x_B. With `0 <= -lam`, `lam phi = 0`, and impacts with `phi' = -e phi'` of before. With
    friction also the slip `psi` of each point, m/s, with `|nu| <= mu |lam|` (Coulomb): `psi = (d_B . (x_A - x_B))'` on the line, on the
    circle `psi = w x w' / R - R w_B`, w_B the angular velocity of b. The line or circle moves with its body.

    A disc of radius r about the point, `disc=`, slides, rolls or lifts off: `phi = d_B x (x_A - x_B) - r`, `psi = d_B . (x_A' - x_B') + r w_A`
    on the line; on the circle `phi = (w . w - D^2) / (2 D)`, `psi = w x w' / D - r w_A - R w_B`, D = R + r.

    If b has edges, a section of a plate or `body.edges(...)`, a point has its distance from each edge that it faces, and a node of such a
    side a the mean `phi = int N gap ds / int N ds` over what faces b, N its hat function (mortar); slips likewise. Mean gaps are for sides that
    lie along each other: a corner that may touch a side is a point of its own, `plate.node(...)` or `body.at(...)`. Such models need
    `NonsmoothAlpha` or `MoreauJean`.

    Reaction on b, (2,): the sum of the forces, N.

    Parameters
    ----------
    a : Attachment or Ground
        The point; of a section of a plate and of `body.edges(...)`, every node; of `Rigid` plates without the nodes within straight lines.
    b : Attachment or Ground
        Without radius: a point of the line with its direction; the points of a stay on the left of it, above `ground.at(point)`. With radius: the
        centre of the circle. A section of a plate, full, `Reduced` or `Rigid`, or `body.edges(...)`: its edges. A side of a quadratic cell counts
        as two straight edges.
    restitution : float
        e in [0, 1]. For rigid bodies: a node of an elastic plate rebounds by the waves in the plate.
    friction : float
        Coefficient mu >= 0 of dry friction.
    radius : float, m, > 0, optional
        R of the circle.
    disc : float, m, > 0, optional
        r of a disc about the point a of a body.
    contact_mass : float, in [0.01, 1]
        Share of its mass that each node of a in contact keeps; the nodes behind it in the same cells take the rest. 0.1 for a full plate that
        meets a line with restitution 0: otherwise each impact annuls the kinetic energy of the nodes, and the plate bounces too low. A change
        of the model, which refinement makes smaller. Quadratic cells with such nodes have a diagonal mass in proportion to that of their matrix:
        its rows sum to negative numbers at corners.
    name : str, optional

    Raises
    ------
    InputError
        For a wrong number, a line, a disc about more than a point or against edges, `contact_mass` of a body that is no full plate, or a circle with friction, whose side has no direction, a
        section of edges with a corner or a node without an edge, a start in penetration, and as for Joint.

    Notes
    -----
    `run.lam[:, model.rows[name]]` has the force of each node. `PenaltyContact` is contact by a stiffness.

    Puso, Laursen, Comput. Methods Appl. Mech. Engrg. 193 (2004) 601-629 (mortar);
    Acary, Brogliato, Numerical Methods for Nonsmooth Dynamical Systems (2008).
    """

    restitution: float = 0.0
    friction: float = 0.0
    radius: float | None = field(default=None, metadata=check(optional, positive, "metres"))
    disc: float | None = field(default=None, metadata=check(optional, positive, "metres"))
    contact_mass: float = 1.0
    kind = "contact"
    components = FORCE

    def __post_init__(self):
        """Check the fields, and that the sides have the places and directions of a line, a circle or edges."""
        super().__post_init__()
        label = self.label
        require_places(label, self.a, self.b)
        if self.radius is None:
            require_point_first(label, self.a, self.b)
        require_contact(label, self)
        if self.edges is None and (self.radius is None or self.friction):
            require_directions(label, self.b)
        if self.disc is not None:
            if isinstance(self.a, Ground) or self.a.has_edges or self.edges is not None:
                raise InputError(f"{label}: disc = {self.disc!r}, but it needs a point of a body for a, and a line or a circle for b")
            require_directions(label, *([self.a] if self.friction else []))
        if not 0.01 <= number(label, "contact_mass", self.contact_mass, "no unit") <= 1.0:
            raise InputError(f"{label}: contact_mass = {self.contact_mass!r} must be in [0.01, 1]")
        if self.contact_mass < 1.0 and (isinstance(self.a, Ground) or not self.a.body.is_full):
            raise InputError(f"{label}: contact_mass = {self.contact_mass!r}, but {self.a!r} is not of a full plate")

    @property
    def placing(self) -> str:  # type: ignore[override]
        """Advice for the message that the sides overlap in the drawing: exchange them, or place the bodies apart."""
        of_ground = isinstance(self.a, Ground) and not isinstance(self.b, Ground) and self.radius is None
        exchange = "exchange the sides if the ground is the line, for a is the point and b the line, or " if of_ground else ""
        return f"{exchange}place the bodies apart"

    @cached_property
    def edges(self) -> FacingEdges | None:
        """The FacingEdges of both sides if b has edges, otherwise None."""
        return FacingEdges(self.label, self.a, self.b) if self.radius is None and self.b.has_edges else None

    def rows(self) -> list[Row | Vector]:
        """The gap of each point of a, and with friction its slip. With edges, gaps are those in the reference configuration; the model finds them at each position."""
        a, b, R, edges = self.a, self.b, self.radius, self.edges
        rows: list[Row | Vector] = []
        r, points = self.disc or 0.0, edges.count * [a] if edges else a.each() if a.has_edges else [a]
        at_rest = edges.gaps(1.0) if edges else ()
        for k, point in enumerate(points):
            w, which = point.x - b.x, f" {k}" if len(points) > 1 else ""
            if edges:
                gap = Row((), float(at_rest[k]))
            elif R is None:
                gap = cross(b.d, w) - r
            else:
                gap = (dot(w, w) - (R + r) ** 2) / (2.0 * (R + r))
            rows.append(gap.named(f"gap{which}", "N").opens(self.restitution))
            if self.friction:
                if R is not None:
                    slip = cross(w, w.rate) / (R + r) - R * cross(b.d, b.d.rate) - (r * cross(a.d, a.d.rate) if r else 0.0)
                elif r:
                    slip = dot(b.d, w.rate) + r * cross(a.d, a.d.rate)
                else:
                    slip = dot(b.d, w)
                rows.append(slip.named(f"slip{which}", "N").rubs(self.friction, on=[rows[-1]]))
        return rows


@named_keywords
@dataclass(frozen=True, eq=False)
class Clearance(Joint):
    """A pin of radius r on b in a hole of radius R = r + c in a: `phi = (c^2 - w . w) / (2 c) >= 0`, m, w = x_B - x_A, c the clearance.

    At contact phi is the distance c - |w|. With friction the slip `psi = w x w' / c + r w_B - R w_A`, m/s, with `|nu| <= mu |lam|` (Coulomb).
    Reaction on b, (2,): the force, N; its moment about the centre of the pin is not listed.

    Parameters
    ----------
    a : Attachment or Ground
        Centre of the hole.
    b : Attachment or Ground
        Centre of the pin.
    gap : float, m, > 0
        c = R - r.
    restitution : float
        e in [0, 1] of impacts.
    friction : float
        Coefficient mu >= 0. Both sides then need a direction.
    pin_radius : float, m, > 0, optional
        r, needed with friction.
    name : str, optional

    Raises
    ------
    InputError
        For a wrong number, friction without a radius or a direction, a start in penetration, and as for Joint.

    Notes
    -----
    Flores, Ambrosio, Comput. Struct. 82 (2004) 1359-1369.
    """

    gap: float = field(metadata=check(positive, "metres"))
    restitution: float = 0.0
    friction: float = 0.0
    pin_radius: float | None = None
    kind = "clearance"
    components = FORCE
    placing = "place the pin within its hole"

    def __post_init__(self):
        """Check the fields, and that friction has a radius and directions."""
        super().__post_init__()
        label = self.label
        require_contact(label, self)
        if self.friction or self.pin_radius is not None:
            settle(self, pin_radius=positive(label, "pin_radius", self.pin_radius, "metres"))
        if self.friction:
            require_directions(label, *(side for side in (self.a, self.b) if not isinstance(side, Ground)))

    def rows(self) -> list[Row | Vector]:
        """`(c^2 - w . w) / (2 c)`, and with friction the slip."""
        c, r, w = self.gap, self.pin_radius, self.b.x - self.a.x
        gap = ((c * c - dot(w, w)) / (2.0 * c)).named("gap", "N").opens(self.restitution)
        if not self.friction or r is None:
            return [gap]
        slip = cross(w, w.rate) / c + r * cross(self.b.d, self.b.d.rate) - (r + c) * cross(self.a.d, self.a.d.rate)
        return [gap, slip.named("slip", "N").rubs(self.friction, on=[gap])]
