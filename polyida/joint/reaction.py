"""What a joint does to its side b, from its rows by virtual work.

The force of a joint on the coordinates is `-phi_q^T lam`. Where the body of b, or the ground, moves by dx and turns by dphi about the point
of b, its work is `f . dx + m dphi`: f is the sum of the forces on the points of b in the rows, m that of their moments and of those on its
directions.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.given import pairs_of
from polyida.joint.formula import rest_of, rows_of
from polyida.joint.joint import FORCE, Joint

MOMENT = (("", "N m"),)
ALONG = (("", "N"),)
Place = tuple[Any, str]  # an attachment or a place of the ground, and "point" or "direction" of it


class Reaction:
    """The reaction of a joint as a function of its multipliers and of the places in its rows.

    whole: force and moment, whatever the components of the joint. components: (axis, unit) of each. needed: the Places of bodies that it
    depends on. profiles: those that turn vectors in the rows.
    """

    def __init__(self, joint: Joint, whole: bool = False):
        self.joint, self.rows = joint, list(rows_of(joint.rows()))
        pieces = [piece for row in self.rows for product in row.products for piece in (product.turning, product.still)]
        on_b = [(side, part) for piece in pieces for side, part, _ in self._of_b(piece)]
        self._turns = any(part == "direction" or not _same(side, joint.b) for side, part in on_b)
        pushes = any(part == "point" for _, part in on_b) or not on_b
        self._points = len({id(side) for side, _ in on_b}) if joint.by_points and not whole else 0
        free = ALONG if len(self.rows) == 1 and not self._turns else FORCE * pushes + MOMENT * self._turns
        self.components = FORCE + MOMENT if whole else joint.components or FORCE * self._points or free
        about = [(joint.b, "point")] if self._turns and pushes and joint.b.body is not None else []
        found = {(id(side), part): (side, part) for side, part in [(s, p) for piece in pieces for s, p, _ in piece.terms] + about}
        self.needed: list[Place] = list(found.values())
        self.profiles = list({id(piece.profile): piece.profile for piece in pieces if piece.profile is not None}.values())

    def __call__(self, t: NDArray, lam: NDArray, at: Callable[[Place], NDArray], ahead: tuple = (None, 0.0)) -> NDArray:
        """It over frames, (frames, components): t (frames,), lam (frames, rows), at(place) (frames,), complex.

        ahead: a profile and by how much, rad, its value is greater than it is.
        """
        places: dict = {}

        def place(side, part):
            key = (id(side), part)
            if key not in places:
                places[key] = rest_of(side, part) if side.body is None else at((side, part))
            return places[key]

        turns = {id(profile): np.exp(1j * (profile.over(t) + ahead[1] * (profile is ahead[0]))) for profile in self.profiles}
        forces: dict = {}
        for k, row in enumerate(self.rows):
            for product in row.products:
                turn = turns.get(id(product.turning.profile), 1.0)
                e, f = turn * product.turning.at(place), product.still.at(place)
                for piece, other, w in ((product.turning, f, turn), (product.still, e, 1.0)):
                    for side, part, weight in self._of_b(piece):
                        key = (id(side), part)
                        forces[key] = side, part, forces.get(key, (None, None, 0.0))[2] - lam[:, k] * np.conj(w * weight) * other
        none = np.zeros(len(t), complex)
        if self._points:
            return np.concatenate([pairs_of(force + none) for _, _, force in forces.values()], axis=1)
        force = sum((force for _, part, force in forces.values() if part == "point"), none)
        moment = none.real
        if self._turns:
            moment = sum(((np.conj(self._arm(side, part, place)) * force).imag for side, part, force in forces.values()), moment)
        # one row pushes with `-lam d phi/dx_b`: its part along d phi/dx_b has the sign of -lam
        found = {"x N": force.real, "y N": force.imag, " N m": moment, " N": -np.sign(lam[:, 0]) * np.abs(force)}
        return np.stack([found[f"{axis} {unit}"] for axis, unit in self.components], axis=1)

    def _of_b(self, piece):
        """The terms of a piece that are of side b."""
        return piece.of_ground if self.joint.b.body is None else [term for term in piece.terms if term[0].body is self.joint.b.body]

    def _arm(self, side, part, place):
        """What turns a force into a moment about the point of b."""
        if part == "direction":
            return place(side, part)
        return 0.0 if _same(side, self.joint.b) else place(side, part) - place(self.joint.b, "point")


def _same(side, other):
    """Whether two sides have the same point, wherever their body is."""
    if side is other or side.body is None:
        return side is other or np.array_equal(side.point, other.point)
    return np.array_equal(side.nodes, other.nodes) and np.array_equal(side.weights, other.weights)
