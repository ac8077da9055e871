"""What every joint is: two sides and the formula of its rows; and what it does to its side b, from these rows by virtual work.

The force of a joint on the coordinates is `-phi_q^T lam`. Where the body of b, or the ground, moves by dx and turns by dphi about the point
of b, its work is `f . dx + m dphi`: f is the sum of the forces on the points of b in the rows, m that of their moments and of those on its
directions.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from polyida import registry
from polyida.joint.attachment import Ground, labelled, require_directions, require_sides
from polyida.joint.formula import Row, Vector, rest_of, rows_of
from polyida.validation import pairs_of

FORCE = (("x", "N"), ("y", "N"))  # axis and unit of the components of a reaction


@dataclass(frozen=True, eq=False)
class Joint:
    """A holonomic constraint between attachments a and b of two bodies, or of a body and the ground.

    A joint of one's own is a class with `rows()`, a list of rows made of `self.a.x`, `self.a.d`, `self.b.x`, `self.b.d` (place, m,
    and direction of a side, without unit) by `pi.cross`, `pi.dot`, `+`, `-`, numbers, `.turned(profile)` and profiles, which move a row
    in time, as in `pi.dot(self.a.d, self.b.x - self.a.x) - self.stroke`; a product has at most two factors; a vector stands for its two
    components. Further fields (numbers,
    profiles, attachments) make it a frozen dataclass; they are saved with it. A joint without driven rows must be closed in the reference
    configuration: what is apart by less than 1e-6 of the scene's size counts as that.
    """

    a: Any
    b: Any
    name: str | None = field(default=None, kw_only=True)
    kind: ClassVar[str | None] = None  # what a joint without a name is called with a number; the class's name where None
    placing: ClassVar[str] = "place the bodies so that they meet"  # what to do where it is not closed at rest

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        registry.parts[registry.name_of(cls)] = cls

    directed: ClassVar[tuple[str, ...]] = ()  # the sides, "a" and "b", that must have a direction

    def __post_init__(self):
        require_sides(labelled(type(self).__name__, self.name), self.a, self.b)
        if self.directed:
            self.require_directions(*(getattr(self, side) for side in self.directed))

    def rows(self) -> list[Row | Vector]:
        """Rows of phi, a list of Row and Vector."""
        raise NotImplementedError(f"{type(self).__name__} gives no rows()")

    @property
    def components(self) -> tuple[tuple[str, str], ...] | None:
        """(axis, unit) of the components of its reaction.

        None: force and moment, as far as the rows act by them on b. Of one row that acts on the point of b alone, the force along
        d phi/dx_b, its direction: one number, N.
        """
        return None

    def require_directions(self, *sides: Any) -> None:
        """Raise InputError unless these sides have a direction, or both where none are given."""
        require_directions(labelled(type(self).__name__, self.name), *(sides or (self.a, self.b)))

    @property
    def by_points(self) -> bool:
        """Whether its reaction is the force on each point of b in its rows, not the sum of these and their moment."""
        return False

    def keep_drawing(self) -> None:
        """Called before `scene.assemble()` moves bodies: keep of the drawing what rows() would take from another one otherwise."""

    def facing(self) -> Self:
        """The joint with plain `ground` put where its other side is in the reference configuration."""
        a, b = (side.facing(other) if isinstance(side, Ground) else side for side, other in ((self.a, self.b), (self.b, self.a)))
        return replace(self, a=a, b=b)


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
