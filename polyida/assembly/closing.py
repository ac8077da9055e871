"""Closing of loops: the least rigid moves of the bodies, from a nearby drawing, that close their joints."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from polyida.assembly.build import of_kind
from polyida.assembly.row_table import given_rows
from polyida.body.body import Body, BodyPoint, points_of
from polyida.body.plate import Plate
from polyida.errors import InputError
from polyida.joint.contact import Contact
from polyida.joint.edges import directions
from polyida.joint.joint import Joint
from polyida.validation import complex_of_pairs, pairs_of, settle

STILL = 1e-13  # of the scene's size: moves and steps that are round-off
ROUNDS = 200  # most steps; a nearby drawing takes about five, stretched links some thirty
CLOSED = 1e-9  # of the scene's size: gap of a closed joint
MOST_DAMPING = 1e12  # above which no step helps
DEPENDENT = 1e-10  # singular values of the rows that count as zero
MISPLACED = 1e-9  # of a body's size and distance: largest difference of its points from the places that origin and angle give
NAMED = 3  # bodies or joints that a message names


@dataclass(frozen=True, eq=False)
class Assembly:
    """How `scene.assemble()` moved the bodies.

    Attributes
    ----------
    shift, turn : dict
        {name: move of its centre, m}, {name: rotation, rad} of each body.
    largest : float
        Longest move of a point of a body, m.
    gap : float
        Widest gap of a joint before, m.
    open : str
        Name of the joint with that gap; empty if all joints were closed.
    """

    shift: dict[str, float]
    turn: dict[str, float]
    largest: float
    gap: float
    open: str

    def summary(self) -> str:
        """One line: which joint was open, and how the bodies moved."""
        moved = [name for name in self.shift if self.shift[name] or self.turn[name]]
        if not moved:
            return "all joints are closed as drawn; nothing moved"
        each = ", ".join(f"{name!r} by {self.shift[name]:.3g} m and {self.turn[name]:.3g} rad" for name in moved)
        return f"joints are closed; {self.open!r} was open by {self.gap:.3g} m; moved {each}"


def close(parts, fixed=()):
    """Move the bodies of {name: part}, in place, until the rows of the joints hold at t = 0; return the Assembly, which lists the moves.

    fixed: names of bodies that must not move. Raises InputError, with all bodies as drawn, that names joints that stay open, or fixed bodies
    that would have to move.
    """
    known = of_kind(parts, Plate, Body)
    size = float(np.ptp(pairs_of(np.concatenate([places_of(body) for body in known.values()])), axis=0).max()) or 1.0
    bodies = [Placed(name, body, size) for name, body in known.items()]
    loops = Loops(parts, [body for body in bodies if body.part], size)
    x, drawn, gaps = loops.solve()
    loops.require_closed(x, drawn, gaps)
    moves = dict.fromkeys(known, (0.0, 0.0, 0.0)) | _moved(parts, loops, x, fixed)
    shift, turn, longest = ({name: move[k] for name, move in moves.items()} for k in range(3))
    gap = float(drawn.max(initial=0.0))
    return Assembly(shift, turn, max(longest.values(), default=0.0), gap, loops.names[drawn.argmax()] if gap else "")


def _moved(parts, loops, x, fixed):
    """Move the bodies that move by more than round-off: {name: (shift, m, turn, rad, longest move of a point, m)}."""
    chosen = [(body, move) for body, move in zip(loops.bodies, x) if np.abs(move).max() > STILL]
    if stuck := [body.name for body, _ in chosen if body.name in fixed]:
        raise InputError(
            f"Scene.assemble: {', '.join(map(repr, stuck[:NAMED]))} would have to move, but there is a model of the scene, whose runs "
            "would move along; assemble before build, or draw the scene anew"
        )
    for body, _ in chosen:
        if others := [other.name for other in loops.bodies if other is not body and other.part is body.part]:
            raise InputError(
                f"Scene.assemble: {body.name!r} would have to move, but it is made of one plate with {', '.join(map(repr, others[:NAMED]))}; "
                "give each a plate of its own"
            )
    before = [(body, body.placement) for body, _ in chosen]
    for joint in of_kind(parts, Joint).values() if chosen else ():
        joint.keep_drawing()
    try:
        moves = {}
        for body, (x, y, turn) in chosen:
            turn = float(turn * loops.size / body.size)
            moves[body.name] = float(loops.size * np.hypot(x, y)), turn, body.move(loops.size * complex(x, y), turn)
        Loops(parts, loops.bodies, loops.size).require_closed_as_drawn()
    except InputError:
        for body, placement in before:
            body.settle(*placement)
        raise
    return moves


class Loops:
    """The rows of all joints as functions of x (bodies, 3): shift and turn times own size of each body, over the size of the scene.

    Rows are read once, as drawn, with what they take from the drawing: the place of the ground, the angle between two directions. Each is
    divided by its slope along a shift of a body, or, if that is zero, along a turn: the value is then the distance of its sides. Gaps count
    only where they are penetrated, and friction never. edges: (rows, FacingEdges) of contacts of edges, which find what faces what at each x.
    """

    def __init__(self, parts, bodies, size):
        """parts: of the scene. bodies: those that move as rigid ones. size: of the scene, m."""
        self.bodies, self.size = bodies, size
        self.index = {id(body.body): k for k, body in enumerate(bodies)}
        self.names, self.rows, self.edges, radii = [], [], [], []
        for name, joint in of_kind(parts, Joint).items():
            rows = [row for row in given_rows(name, joint.facing()) if not row.rate]
            if isinstance(joint, Contact) and joint.edges:
                self.edges.append((slice(len(self.rows), len(self.rows) + len(rows)), joint.edges))
            radii += [joint.radius or 0.0 if isinstance(joint, Contact) else 0.0] * len(rows)
            self.names, self.rows = self.names + [name] * len(rows), self.rows + rows
        self.radii = np.array(radii)
        self.scale, self.gaps = np.ones(len(self.rows)), np.zeros(len(self.rows), bool)
        slope = np.abs(self(np.zeros(3 * len(bodies)))[1].reshape(len(self.rows), -1, 3))
        along = np.hypot(slope[..., 0], slope[..., 1]).max(axis=1, initial=0.0), slope[..., 2].max(axis=1, initial=0.0)
        self.scale = 1.0 / np.select([slopes > DEPENDENT for slopes in along], along, 1.0)
        self.gaps[:] = [row.gap for row in self.rows]

    def __call__(self, x):
        """(phi (rows,), its slope (rows, 3 bodies)), over the scene's size."""
        rows = [self._row(row, x.reshape(-1, 3)) for row in self.rows]
        phi, slope = np.array([value for value, _ in rows]), np.array([slope for _, slope in rows]).reshape(len(rows), x.size)
        for at, sides in self.edges:
            phi[at], slope[at] = self._gaps(sides, x.reshape(-1, 3))
        # a gap at a circle is |w| - R here: a step along phi = (w . w - R^2) / (2 R) would end outside, where the gap no longer counts
        circles, R = self.radii > 0.0, self.radii[self.radii > 0.0]
        away = np.sqrt(np.maximum(R * (R + 2.0 * phi[circles]), 0.0))
        phi[circles], slope[circles] = away - R, (R / np.maximum(away, STILL * R))[:, None] * slope[circles]
        held = np.where(self.gaps & (phi > 0.0), 0.0, self.scale)
        return held * phi / self.size, held[:, None] * slope

    def _row(self, row, x):
        """(value, slope (3 bodies,) in x), m, of a joint's row `constant + sum f p(0) + sum E . F`; x (bodies, 3): moves of bodies."""
        value, slope = row.constant + sum(factor * profile(0.0) for factor, profile in row.drives), np.zeros(x.size)
        for product in row.products:
            (e, e_x), (f, f_x) = self._piece(product.rotated, x), self._piece(product.unrotated, x)
            value += (e.conjugate() * f).real
            slope += (e_x.conjugate() * f + e.conjugate() * f_x).real
        return value, slope

    def _gaps(self, sides, x):
        """(phi (rows,), m, slopes (rows, 3 bodies)) of contacts of edges, the FacingEdges sides, at the moves x (bodies, 3) of the bodies.

        A row that faces nothing has the size of the scene as its gap, and the slope 0. The slopes are those at gap zero: the normals are
        held.
        """
        moved = [[self._piece(node.x.summands[0], x) for node in side] for side in (sides.first, sides.second)]
        places, slopes = ([np.array([one[k] for one in side]) for side in moved] for k in range(2))
        pairs = [pairs_of(z) for z in places]
        pieces = sides.pieces(*pairs)
        phi, slope = np.full(sides.count, self.size), np.zeros((sides.count, x.size))
        phi[pieces.row] = 0.0
        d = complex_of_pairs(directions(sides, pairs[1], pieces)).conj()
        corners, others = pieces.points, sides.others[pieces.edge]
        for weights, z, z_x, numbers in zip(np.split(pieces.weights, 2, axis=1), places, slopes, (corners, others)):
            np.add.at(phi, pieces.row, (d * (weights * z[numbers]).sum(axis=1)).imag)
            np.add.at(slope, pieces.row, (d[:, None] * np.einsum("kj,kjx->kx", weights, z_x[numbers])).imag)
        return phi, slope

    def _piece(self, piece, x):
        """(value, slope (3 bodies,) in x) of a vector in a joint's formula, complex x + i y, with the bodies moved by x (bodies, 3)."""
        value, slope = piece.rest, np.zeros(x.shape, complex)
        for side, part, w in piece.terms:
            k = self.index.get(id(side.body))
            if k is not None:
                body = self.bodies[k]
                whole, arm = body.arm(side, part)
                turn = np.exp(1j * x[k, 2] * self.size / body.size)
                value += w * (whole * self.size * complex(*x[k, :2]) + (turn - 1.0) * arm)
                slope[k] += w * np.array([whole, 1j * whole, 1j * turn * arm / body.size])
        turn = 1.0 if piece.profile is None else np.exp(1j * piece.profile(0.0))
        return turn * value, turn * slope.ravel()

    def solve(self):
        """(x (bodies, 3), gaps as drawn, gaps at x, (rows,) each, m), by Levenberg-Marquardt steps with damping |phi|^2.

        They converge quadratically also if rows depend on each other (Yamashita and Fukushima, On the rate of convergence of the
        Levenberg-Marquardt method, Computing Suppl. 15, 2001).
        """
        x = np.zeros(3 * len(self.bodies))
        phi, slope = self(x)
        drawn = phi
        for _ in range(ROUNDS if phi.size and x.size else 0):
            u, s, v = np.linalg.svd(slope, full_matrices=False)
            shares, damping, nearer = np.where(s > DEPENDENT * s[0], s, 0.0), phi @ phi, False
            while damping < MOST_DAMPING and not nearer:
                step = -(shares / (s * s + damping + (shares == 0.0)) * (phi @ u)) @ v
                ahead = self(x + step)
                nearer = ahead[0] @ ahead[0] < phi @ phi
                if np.abs(step).max() < STILL:
                    break
                damping = 4.0 * damping + STILL
            if not nearer:
                break
            x, (phi, slope) = x + step, ahead
        return x.reshape(-1, 3), self.size * np.abs(drawn), self.size * np.abs(phi)

    def require_closed(self, x, drawn, gaps):
        """Raise InputError if a row is open at x, or on the wrong half-turn. drawn, gaps: as drawn and at x, (rows,), m."""
        widest = {}
        for name, gap in zip(self.names, gaps):
            widest[name] = max(widest.get(name, 0.0), gap)
        open_ = sorted((name for name in widest if widest[name] > CLOSED * self.size), key=widest.get, reverse=True)
        if open_:
            joints = ", ".join(f"{name!r} by {widest[name]:.3g} m" for name in open_[:NAMED])
            raise InputError(
                f"Scene.assemble: the joints do not close: {joints} stay open at the best position, from {drawn.max():.3g} m as "
                "drawn; check the lengths of the bodies, or draw them nearer to where they close"
            )
        one_way = [(name, product) for name, row in zip(self.names, self.rows) for product in row.products if product.one_way]
        for name, product in one_way:
            e, f = (self._piece(piece, x)[0] for piece in (product.rotated, product.unrotated))
            if (e.conjugate() * f).imag > 0:
                raise InputError(f"Scene.assemble: {name!r} would close on the wrong half-turn; draw its sides within a quarter turn of it")

    def require_closed_as_drawn(self):
        """Raise InputError if a row, read again, is open: it took other data from the new position of its bodies."""
        gaps = self.size * np.abs(self(np.zeros(3 * len(self.bodies)))[0])
        if gaps.max(initial=0.0) > CLOSED * self.size:
            raise InputError(
                f"Scene.assemble: {self.names[gaps.argmax()]!r} is open again where its bodies have moved to: its rows() take from there an "
                "angle or a place, which its profile moves further; let the profile begin at zero"
            )


class Placed:
    """A body as drawn. centre: mean of its nodes or named points, complex, m; size: their root mean square distance from it, m.

    part: the object with `origin` and `angle`, the body or the plate that it is made of; None if it cannot be moved.
    """

    def __init__(self, name, body, extent):
        """extent: of the scene, m, the size of a body that has none."""
        parts = (part for part in (body, getattr(body, "plate", None)) if hasattr(part, "origin") and hasattr(part, "angle"))
        self.name, self.body, self.part = name, body, next(parts, None)
        places = places_of(body)
        self.centre = places.mean()
        self.size = float(np.sqrt(np.mean(np.abs(places - self.centre) ** 2))) or extent

    def arm(self, side, part):
        """(move for a unit shift, lever arm, complex) of an attachment's "point", or its "direction", which only turns.

        Directions at named points of a body made of a plate do not turn: they are given in the axes of the drawing.
        """
        if part == "point":
            return 1.0, complex(*side.point) - self.centre
        return 0.0, 0j if self.part is not self.body and isinstance(side, BodyPoint) else complex(*side.direction)

    def move(self, shift, turn):
        """Shift it by `shift`, complex, m, turn it about its centre by `turn`, rad; return the longest move of a point, m."""
        before = places_of(self.body)
        rotation = np.exp(1j * turn)
        origin = complex(rotation * (complex(*self.part.origin) - self.centre) + self.centre + shift)
        self.settle((origin.real, origin.imag), float(self.part.angle + turn))
        after = rotation * (before - self.centre) + self.centre + shift
        if np.abs(places_of(self.body) - after).max() > MISPLACED * (self.size + np.abs(after).max()):
            raise InputError(
                f"Scene.assemble: {self.body.label} has origin and angle, but its points do not follow them; let its "
                "coordinates() be those of angle 0 at (0, 0), turned by the angle and moved to the origin"
            )
        return float(np.abs(after - before).max())

    @property
    def placement(self):
        """(origin, angle) of the body where it was moved."""
        return self.part.origin, self.part.angle

    def settle(self, origin, angle):
        """Set origin and angle, and clear the cached properties that depend on them."""
        settle(self.part, origin=origin, angle=angle)
        for part in (self.part, self.body):
            for kind in type(part).__mro__:
                for name, value in vars(kind).items():
                    if isinstance(value, cached_property):
                        part.__dict__.pop(name, None)


def places_of(body):
    """Nodes of a plate, or of the plate of a body, or else named points of a body, (k,) complex, m."""
    plate = body if isinstance(body, Plate) else body.plate
    points = np.array([point.point for point in points_of(body)]) if plate is None else plate.points
    return complex_of_pairs(points)
