"""The base class of joints, their reactions, and joints that are added in motion.

The force of a joint on the coordinates is `-phi_q^T lam`, of velocity rows `W v + w` it is `-W^T nu` (nu are entries of lam too). If the
body of b, or the ground, moves by dx and turns by dphi about the point of b, this force does the work `f . dx + m dphi`: f is the sum of
the forces on the points of b in the rows, m the sum of their moments and of the moments on its directions.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from polyida.fields import check_fields
from polyida.joint.attachment import Attachment, Ground, OwnPart, require_directions, require_sides
from polyida.joint.formula import Row, Vector, all_rows, rest_of
from polyida.validation import pairs_of, settle

FORCE = (("x", "N"), ("y", "N"))  # axis and unit of the components of a reaction
MOMENT = (("", "N m"),)
ALONG = (("", "N"),)
Place = tuple[Any, str]  # an attachment or a place of the ground, and "point" or "direction" of it


@dataclass(frozen=True, eq=False)
class Joint(OwnPart, part=False):
    """A constraint between attachments a and b of two bodies, or of a body and the ground.

    A user's joint is a subclass with `rows()` or `velocity_rows()` or both. `rows()` is a list of rows made of `self.a.x`, `self.a.d`,
    `self.b.x`, `self.b.d` (point, m, and direction of a side, no unit) by `pi.cross`, `pi.dot`, `+`, `-`, numbers, `.turned(profile)`, and
    profiles that shift a row in time, as in `pi.dot(self.a.d, self.b.x - self.a.x) - self.stroke`. A product has at most two factors; a
    vector stands for its two components. `velocity_rows()` is a list of rows `W(t, q) v + w(t)` that restrict velocities alone
    (nonholonomic constraints): each of their products has one factor with `.rate`, as in `pi.cross(self.b.d, self.b.x.rate)` of a skate.
    Further fields (numbers, profiles, attachments) make the class a frozen dataclass; files store them. Rows of phi that do not depend on
    time must vanish in the reference configuration, to 1e-6 of the scene's size.

    Parameters
    ----------
    a, b : Attachment or Ground
    name : str, optional

    Raises
    ------
    InputError
        If a side is not an attachment or ground, if both sides belong to one body or to the ground, or if a class with fields is no
        dataclass.
    """

    a: Any
    b: Any
    name: str | None = field(default=None, kw_only=True)
    kind: ClassVar[str | None] = None  # base of the automatic name ("revolute 1"); the class's name if None
    placing: ClassVar[str] = "place the bodies so that its rows are zero"  # advice in the message that they are not, as drawn
    directed: ClassVar[tuple[str, ...]] = ()  # the sides, "a" and "b", that must have a direction

    def __post_init__(self):
        """Check both sides, their directions if the joint needs them, and the fields, set to the checked values. Raises InputError."""
        require_sides(self.label, self.a, self.b)
        if self.directed:
            self.require_directions(*(getattr(self, side) for side in self.directed))
        check_fields(self, self.label)

    def rows(self) -> list[Row | Vector]:
        """Return the rows of phi, none by default."""
        return []

    def velocity_rows(self) -> list[Row | Vector]:
        """Return the velocity rows, none by default."""
        return []

    @property
    def components(self) -> tuple[tuple[str, str], ...] | None:
        """(axis, unit) of the components of the reaction.

        None: force and moment, as far as the rows contain them. For one row that acts only on the point of b: one number, N, the force
        along d phi/dx_b.
        """
        return None

    def require_directions(self, *sides: Any) -> None:
        """Raise InputError unless these sides, by default both, have a direction."""
        require_directions(self.label, *(sides or (self.a, self.b)))

    @property
    def by_points(self) -> bool:
        """True if the reaction lists the force on each point of b in the rows, False if it is their sum and moment."""
        return False

    def keep_drawing(self) -> None:
        """Store what rows() takes from the drawing. `Scene.assemble` calls this before it moves bodies."""

    def facing(self) -> Self:
        """Return the joint with plain `ground` replaced by the reference place of the other side."""
        a, b = (side.facing(other) if isinstance(side, Ground) else side for side, other in ((self.a, self.b), (self.b, self.a)))
        return replace(self, a=a, b=b)


class Reaction:
    """The reaction of a joint as a function of its multipliers and of the places in its rows.

    whole: force and moment, independent of the joint's own components. components: (axis, unit) of each. needed: the Places of bodies that
    it depends on. profiles: those that turn vectors in the rows.
    """

    def __init__(self, joint: Joint, whole: bool = False):
        """whole: True for force and moment in any case, whatever components the joint lists."""
        self.joint, self.rows = joint, all_rows(joint)
        products = [product for row in self.rows for product in row.products]
        summands = [s for product in products for s in (product.rotated, product.unrotated)]
        on_b = [(side, part) for product in products for s in _loaded(product) for side, part, _ in self._of_b(s)]
        self._has_moment = any(part == "direction" or not _same(side, joint.b) for side, part in on_b)
        has_force = any(part == "point" for _, part in on_b) or not on_b
        self._points = len({id(side) for side, _ in on_b}) if joint.by_points and not whole else 0
        free = ALONG if len(self.rows) == 1 and not self._has_moment else FORCE * has_force + MOMENT * self._has_moment
        self.components = FORCE + MOMENT if whole else joint.components or FORCE * self._points or free
        about = [(joint.b, "point")] if self._has_moment and has_force and joint.b.body is not None else []
        places = {(id(side), part): (side, part) for side, part in [(s, p) for summand in summands for s, p, _ in summand.terms] + about}
        self.needed: list[Place] = list(places.values())
        self.profiles = list({id(s.profile): s.profile for s in summands if s.profile is not None}.values())

    def __call__(
        self, t: np.ndarray, lam: np.ndarray, at: Callable[[Place], np.ndarray], ahead: tuple[Any, float] = (None, 0.0)
    ) -> np.ndarray:
        """Return the reaction, (frames, components), for t (frames,), lam (frames, rows) and at(place) (frames,) complex.

        ahead: a profile and a number, rad, that is added to its values.
        """
        known: dict = {}

        def place(side, part):
            """The place of a side, computed once; of the ground in the reference configuration."""
            key = (id(side), part)
            if key not in known:
                known[key] = rest_of(side, part) if side.body is None else at((side, part))
            return known[key]

        turns = {id(profile): np.exp(1j * (profile.over(t) + ahead[1] * (profile is ahead[0]))) for profile in self.profiles}
        forces: dict = {}
        for k, row in enumerate(self.rows):
            for product in row.products:
                turn = turns.get(id(product.rotated.profile), 1.0)
                e, f = turn * product.rotated.at(place), product.unrotated.at(place)
                for summand in _loaded(product):
                    other, w = (f, turn) if summand is product.rotated else (e, 1.0)
                    for side, part, weight in self._of_b(summand):
                        key = (id(side), part)
                        forces[key] = side, part, forces.get(key, (None, None, 0.0))[2] - lam[:, k] * np.conj(w * weight) * other
        none = np.zeros(len(t), complex)
        if self._points:
            return np.concatenate([pairs_of(force + none) for _, _, force in forces.values()], axis=1)
        total, moment = none, none.real
        for side, part, force in forces.values():
            if part == "point":
                total = total + force
            if self._has_moment and (part == "direction" or not _same(side, self.joint.b)):
                arm = place(side, part) - (place(self.joint.b, "point") if part == "point" else 0.0)
                moment = moment + (np.conj(arm) * force).imag
        # a single row acts with the force `-lam d phi/dx_b`: its component along d phi/dx_b has the sign of -lam
        values = {"x N": total.real, "y N": total.imag, " N m": moment, " N": -np.sign(lam[:, 0]) * np.abs(total)}
        return np.stack([values[f"{axis} {unit}"] for axis, unit in self.components], axis=1)

    def _of_b(self, summand):
        """The terms of a summand that belong to the body of side b, or to the ground if side b is on it."""
        body = self.joint.b.body
        return summand.of_ground if body is None else [term for term in summand.terms if term[0].body is body]


def _loaded(product):
    """The summands of a product on whose places its multiplier acts."""
    return (product.unrotated,) if product.unrotated.rate else (product.rotated, product.unrotated)


def _same(side, other):
    """True if two sides of one body have the same point."""
    if side is other or side.body is None:
        return side is other or np.array_equal(side.point, other.point)
    return np.array_equal(side.nodes, other.nodes) and np.array_equal(side.weights, other.weights)


def held_at(joint, place):
    """The joint as added where its sides are now, with the sides in the reference configuration; place((side, "point" or "direction")): complex, of now.

    Plain `ground` is the present place of the other side. Rows of directions alone hold at their present value, rows of places as they are
    written.
    """
    now, held = copy(joint), copy(joint)
    for one in fields(joint):
        if isinstance(side := getattr(now, one.name), Attachment):
            settle(now, **{one.name: _moved(side, place)})
    facing = now.facing()
    for name in ("a", "b"):
        settle(held, **{name: getattr(getattr(facing, name), "drawn", getattr(facing, name))})
    rows, number = [_held(row, place) for row in all_rows(facing)], sum(row.rate is not True for row in all_rows(facing))
    settle(held, rows=lambda: rows[:number], velocity_rows=lambda: rows[number:])
    return held


def _moved(side, place):
    """An attachment whose place in the reference configuration is the present one; drawn: the attachment itself."""
    here = {"point": pairs_of(place((side, "point")))}
    if side.has_direction:
        here["direction"] = pairs_of(place((side, "direction")))
    kind = type(type(side).__name__, (type(side),), here | {"drawn": side, "each": lambda own: [_moved(one, place) for one in side.each()]})
    other = object.__new__(kind)
    other.__dict__.update(vars(side))
    return other


def _held(row, place):
    """The row on the attachments themselves; `place` gives their present places. A constant row of directions alone is made zero there."""

    def drawn(summand):
        """The summand on the attachments themselves in place of those that `_moved` has made."""
        return replace(summand, terms=tuple((getattr(side, "drawn", side), part, w) for side, part, w in summand.terms))

    products = tuple(replace(one, rotated=drawn(one.rotated), unrotated=drawn(one.unrotated)) for one in row.products)
    held = replace(row, products=products)
    parts = {part for one in products for summand in (one.rotated, one.unrotated) for _, part, _ in summand.terms}
    if row.rate or row.driven or parts != {"direction"}:
        return held
    at = lambda side, part: place((side, part))  # noqa: E731
    value = row.constant + sum((np.conj(one.rotated.at(at)) * one.unrotated.at(at)).real for one in products)
    return replace(held, constant=row.constant - value)
