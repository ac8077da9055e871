"""The rows of a scene's joints as equations for the places and angles of its bodies, and the steps that solve them."""

import numpy as np

from polyida.assembly.build import of_kind
from polyida.assembly.rows.row_table import given_rows
from polyida.errors import InputError
from polyida.joint.joint import Joint

ROUNDS = 200  # steps at most; from a nearby drawing about five, where links are stretched out some thirty
CLOSED = 1e-9  # of the scene's size: what is left of a gap that is closed
STILL = 1e-13  # of the scene's size: steps that are round-off
HOPELESS = 1e12  # damping at which no step helps
DEPENDENT = 1e-10  # singular values of the rows that count as none
NAMED = 3  # joints that a refusal names


class Loops:
    """The rows of all joints, as functions of how the bodies move: x (bodies, 3), shift and own size times turn of each, over that of the scene.

    Rows are read as drawn and keep what they take from the drawing: the place of plain ground, the angle between two directions.
    Each is divided by its slope along a shift of a body, or where it has none along a turn: so it says how far apart its sides are.
    """

    def __init__(self, parts, bodies, size):
        self.bodies, self.size = bodies, size
        self.index = {id(body.body): k for k, body in enumerate(bodies)}
        rows = [(name, row) for name, joint in of_kind(parts, Joint).items() for row in given_rows(name, joint.facing())]
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
        """By how much a point or direction of a body moves, and its slope, (3,), complex."""
        whole, arm = body.arm(side, part)
        turn = np.exp(1j * x[2] * self.size / body.size)
        return whole * self.size * complex(x[0], x[1]) + (turn - 1.0) * arm, np.array([whole, 1j * whole, 1j * turn * arm / body.size])

    def solve(self):
        """(x (bodies, 3), gaps as drawn, gaps behind, (rows,) each, m): steps of Gauss and Newton of least length, damped by what is open.

        Damped by its square they end as fast as Newton's also where rows depend on each other. Source: Yamashita, Fukushima, On the rate
        of convergence of the Levenberg-Marquardt method, Computing Suppl. 15 (2001).
        """
        x = np.zeros(3 * len(self.bodies))
        phi, slope = self(x)
        drawn = phi
        for _ in range(ROUNDS):
            further = self._nearer(x, phi, slope)
            if further is None:
                break
            x, phi, slope = further
        return x.reshape(-1, 3), self.size * np.abs(drawn), self.size * np.abs(phi)

    def _nearer(self, x, phi, slope):
        """(x, phi, slope) behind a step that closes some of what is open, or None."""
        if not phi.size or not x.size:
            return None
        u, s, v = np.linalg.svd(slope, full_matrices=False)
        shares, damping = np.where(s > DEPENDENT * s[0], s, 0.0), phi @ phi
        while damping < HOPELESS:
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

    def require_closed(self, x, drawn, left):
        """Raise InputError where a row stays open, or stands on the wrong half-turn; drawn, left: gaps (rows,), m."""
        widest = {}
        for name, gap in zip(self.names, left):
            widest[name] = max(widest.get(name, 0.0), gap)
        open_ = sorted((name for name in widest if widest[name] > CLOSED * self.size), key=widest.get, reverse=True)
        if open_:
            told = ", ".join(f"{name!r} by {widest[name]:.3g} m" for name in open_[:NAMED])
            raise InputError(
                f"Scene.assemble: the joints do not close: {told} stay open where the bodies come nearest, from {drawn.max():.3g} m as "
                "drawn; check the lengths of the bodies, or draw them nearer to where they close"
            )
        one_way = [(name, product) for name, row in zip(self.names, self.rows) for product in row.products if product.one_way]
        for name, product in one_way:
            e, f = (self._piece(piece, x)[0] for piece in (product.turning, product.still))
            if (e.conjugate() * f).imag > 0:
                raise InputError(f"Scene.assemble: {name!r} would close on the wrong half-turn; draw its sides within a quarter turn of it")

    def require_closed_as_drawn(self):
        """Raise InputError where a row is open: one whose bodies were moved has taken something else from where they are now."""
        gaps = self.size * np.abs(self(np.zeros(3 * len(self.bodies)))[0])
        if gaps.max(initial=0.0) > CLOSED * self.size:
            raise InputError(
                f"Scene.assemble: {self.names[gaps.argmax()]!r} is open again where its bodies have moved to: its rows() take from there an "
                "angle or a place, which its profile moves further; let the profile begin at zero"
            )
