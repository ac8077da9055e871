"""Closing of loops: bodies are moved as rigid, by as little as closes them, from a nearby drawing onto their joints."""

from dataclasses import dataclass

import numpy as np

from polyida.assembly.build import of_kind
from polyida.assembly.closing.placed import Placed, places_of
from polyida.body.body import Body
from polyida.body.plate import Plate
from polyida.errors import InputError
from polyida.given import pairs_of
from polyida.joint.formula import rows_of
from polyida.joint.joint import Joint

ROUNDS = 200  # steps at most; from a nearby drawing about five, where links are stretched out some thirty
CLOSED = 1e-9  # of the scene's size: what is left of a gap that is closed
STILL = 1e-13  # of the scene's size: moves that are round-off
DEPENDENT = 1e-10  # singular values of the rows that count as none
NAMED = 3  # joints that a refusal names


@dataclass(frozen=True, eq=False)
class Assembly:
    """By how much `scene.assemble()` moved the bodies, each as rigid: shift, {name: m} of its centre, turn, {name: rad}.

    largest: the longest way that a point of a body went, m. gap: the widest that was open before, m, and `open` the joint it was in ("" where
    all were closed).
    """

    shift: dict[str, float]
    turn: dict[str, float]
    largest: float
    gap: float
    open: str

    def summary(self) -> str:
        """One line: what was open, and who moved by how much."""
        moved = [name for name in self.shift if self.shift[name] or self.turn[name]]
        if not moved:
            return "all joints are closed as drawn; nothing moved"
        each = ", ".join(f"{name!r} by {self.shift[name]:.3g} m and {self.turn[name]:.3g} rad" for name in moved)
        return f"joints are closed; {self.open!r} was open by {self.gap:.3g} m; moved {each}"


def close(parts, held=()):
    """Move the bodies of {name: part} onto the rows of its joints, those that are driven at t = 0; an Assembly.

    Raises InputError, with every body where it was drawn, naming the joints that stay open, or bodies that would have to move and are
    held, by name.
    """
    known = of_kind(parts, Plate, Body)
    size = float(np.ptp(pairs_of(np.concatenate([places_of(body) for body in known.values()])), axis=0).max()) or 1.0
    bodies = [Placed(name, body, size) for name, body in known.items()]
    loops = Loops(parts, [body for body in bodies if body.part], size)
    x, gaps = loops.solve()
    loops.require_closed(x, gaps)
    moves = dict.fromkeys([body.name for body in bodies], (0.0, 0.0, 0.0)) | _moved(parts, loops, x, held)
    shift, turn, ways = ({name: move[k] for name, move in moves.items()} for k in range(3))
    gap = float(gaps[0].max(initial=0.0))
    return Assembly(shift, turn, max(ways.values(), default=0.0), gap, loops.names[gaps[0].argmax()] if gap else "")


def _moved(parts, loops, x, held):
    """{name: (shift, m, turn, rad, longest way of a point, m)} of the bodies that are moved, those by more than round-off."""
    chosen = [(body, move) for body, move in zip(loops.bodies, x) if np.abs(move).max() > STILL]
    if not chosen:
        return {}
    if stuck := [body.name for body, _ in chosen if body.name in held]:
        raise InputError(
            f"Scene.assemble: {', '.join(map(repr, stuck[:NAMED]))} would have to move, but there is a model of the scene, whose runs would move "
            "along; assemble before build, or draw the scene anew"
        )
    before = [(body, body.placement) for body, _ in chosen]
    for joint in of_kind(parts, Joint).values():
        joint.keep_drawing()
    try:
        moves = {body.name: loops.place(body, *move) for body, move in chosen}
        _require_closed_as_built(Loops(parts, loops.bodies, loops.size))
    except InputError:
        for body, placement in before:
            body.settle(*placement)
        raise
    return moves


def _require_closed_as_built(loops):
    """Raise InputError where rows of bodies that were moved do not hold: they have taken something else from the new places."""
    gaps = loops.solve(0)[1][0]
    if gaps.max(initial=0.0) > CLOSED * loops.size:
        raise InputError(
            f"Scene.assemble: {loops.names[gaps.argmax()]!r} is open again where its bodies have moved to: its rows() take from there an angle, "
            "which its profile turns further; let the profile begin at zero"
        )


class Loops:
    """The rows of all joints, as functions of how the bodies move: x (bodies, 3), shift and `size times turn` of each, over the scene's size.

    Rows are read as drawn and keep what they take from the drawing: the place of plain ground, the angle between two directions.
    Each is divided by its slope along a shift of a body, or where it has none along a turn: so it says how far apart its sides are.
    """

    def __init__(self, parts, bodies, size):
        self.bodies, self.size = bodies, size
        self.index = {id(body.body): k for k, body in enumerate(bodies)}
        rows = [(name, row) for name, joint in of_kind(parts, Joint).items() for row in rows_of(joint.facing().rows())]
        self.names, self.rows = [name for name, _ in rows], [row for _, row in rows]
        self.scale = np.ones(len(rows))
        slope = np.abs(self(np.zeros(3 * len(bodies)))[1].reshape(len(rows), -1, 3))
        along = np.hypot(slope[..., 0], slope[..., 1]).max(axis=1, initial=0.0), slope[..., 2].max(axis=1, initial=0.0)
        self.scale = 1.0 / np.select([shown > DEPENDENT for shown in along], along, 1.0)

    def __call__(self, x):
        """(phi (rows,), its slope (rows, 3 bodies)), over the scene's size."""
        found = [self._row(row, x.reshape(-1, 3)) for row in self.rows]
        phi, slope = np.array([value for value, _ in found]), np.array([slope for _, slope in found]).reshape(len(found), x.size)
        return self.scale * phi / self.size, self.scale[:, None] * slope

    def _row(self, row, x):
        """Value and slope, m, of `constant + sum f p(0) + sum E . F`."""
        value, slope = row.constant + sum(factor * profile(0.0) for factor, profile in row.drives), np.zeros(x.size)
        for product in row.products:
            (e, e_x), (f, f_x) = self._piece(product.turning, x), self._piece(product.still, x)
            value += (e.conjugate() * f).real
            slope += (e_x.conjugate() * f + e.conjugate() * f_x).real
        return value, slope

    def _piece(self, piece, x):
        """Value of a piece of a formula and its slope, (3 bodies,), complex."""
        value, slope = piece.rest, np.zeros(x.shape, complex)
        for side, part, w in piece.terms:
            k = self.index.get(id(side.body))
            if k is not None:
                moved, along = self._moved(self.bodies[k], side, part, x[k])
                value, slope[k] = value + w * moved, slope[k] + w * along
        turn = 1.0 if piece.profile is None else np.exp(1j * piece.profile(0.0))
        return turn * value, turn * slope.ravel()

    def _moved(self, body, side, part, x):
        """By how much a point or direction of a body moves, and its slope, (3,), complex: directions only turn."""
        whole, place = (1.0, side.point) if part == "point" else (0.0, side.direction)
        arm, lever = complex(*place) - whole * body.centre, self.size / body.size
        turn = np.exp(1j * lever * x[2])
        return whole * self.size * complex(x[0], x[1]) + (turn - 1.0) * arm, np.array([whole, 1j * whole, 1j * turn * arm / body.size])

    def solve(self, rounds=ROUNDS):
        """(x (bodies, 3), gaps (rows,), m, before and behind): steps of Gauss and Newton of least length, damped by the square of what is open.

        So damped they end as fast as Newton's also where rows depend on each other. Source: Yamashita, Fukushima, Computing Suppl. 15 (2001).
        """
        x = np.zeros(3 * len(self.bodies))
        phi, slope = self(x)
        drawn = phi
        for _ in range(rounds):
            further = self._nearer(x, phi, slope)
            if further is None:
                break
            x, phi, slope = further
        return x.reshape(-1, 3), self.size * np.abs([drawn, phi])

    def _nearer(self, x, phi, slope):
        """(x, phi, slope) behind a step that closes some of what is open, or None."""
        if not phi.size or not x.size:
            return None
        u, s, v = np.linalg.svd(slope, full_matrices=False)
        shares, damping = np.where(s > DEPENDENT * s[0], s, 0.0), phi @ phi
        while damping < 1e12:
            step = -(shares / (s * s + damping + (shares == 0.0)) * (phi @ u)) @ v
            found = self(x + step)
            if found[0] @ found[0] < phi @ phi:
                return x + step, *found
            if np.abs(step).max() < STILL:
                return None
            damping = 4.0 * damping + STILL
        return None

    def place(self, body, x, y, turn):
        """Move a body as x says; (shift, m, turn, rad, longest way of a point, m)."""
        turn = float(turn * self.size / body.size)
        return float(self.size * np.hypot(x, y)), turn, body.move(self.size * complex(x, y), turn)

    def require_closed(self, x, gaps):
        """Raise InputError where a row stays open, or stands on the wrong half-turn."""
        left = {}
        for name, gap in zip(self.names, gaps[1]):
            left[name] = max(left.get(name, 0.0), gap)
        worst = sorted(left, key=left.get, reverse=True)[:NAMED]
        if worst and left[worst[0]] > CLOSED * self.size:
            told = ", ".join(f"{name!r} by {left[name]:.3g} m" for name in worst if left[name] > CLOSED * self.size)
            raise InputError(
                f"Scene.assemble: the joints do not close: {told} stay open where the bodies come nearest, from {gaps[0].max():.3g} m as drawn; "
                "check the lengths of the bodies, or draw them nearer to where they close"
            )
        for name, product in ((name, product) for name, row in zip(self.names, self.rows) for product in row.products if product.one_way):
            e, f = (self._piece(piece, x)[0] for piece in (product.turning, product.still))
            if (e.conjugate() * f).imag > 0:
                raise InputError(f"Scene.assemble: {name!r} would close on the wrong half-turn; draw its sides within a quarter turn of it")
