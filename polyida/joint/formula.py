"""The formula language of joints: vectors of points and directions, and rows of phi made of their products.

A `Vector` is linear in the coordinates, parts of it turned in time; `cross`, `dot`, sums, numbers and profiles make `Row`s of vectors.
Everything here is data: the assembly compiles it, and one set of kernels evaluates it.
"""

from dataclasses import dataclass, replace

import numpy as np

from polyida.errors import InputError
from polyida.profile import Profile, difference
from polyida.validation import is_number, named_keywords


@dataclass(frozen=True, eq=False)
class Piece:
    """`R(theta(t)) (constant + sum_j w_j z_j)`, complex numbers for the plane: z_j the "point" or "direction" of an attachment.

    terms: (attachment, "point" or "direction", w). profile: theta, rad, or None where nothing turns. of_ground: what of the constant places
    of the ground give, as terms.
    """

    terms: tuple = ()
    constant: complex = 0j
    profile: Profile | None = None
    of_ground: tuple = ()

    def times(self, w):
        """The piece turned and stretched by the complex number w."""
        terms, of_ground = (tuple((side, part, w * u) for side, part, u in given) for given in (self.terms, self.of_ground))
        return replace(self, terms=terms, constant=w * self.constant, of_ground=of_ground)

    def plus(self, other):
        """The sum with a piece that the same profile turns."""
        terms, of_ground = self.terms + other.terms, self.of_ground + other.of_ground
        return replace(self, terms=terms, constant=self.constant + other.constant, of_ground=of_ground)

    def at(self, place):
        """Its value before it is turned, `place(attachment, "point" or "direction")` giving the z_j."""
        return self.constant + sum(w * place(side, part) for side, part, w in self.terms)

    @property
    def rest(self):
        """Its value in the reference configuration, before it is turned."""
        return self.at(rest_of)


@dataclass(frozen=True, eq=False)
class Vector:
    """A vector of the plane, m: a sum of pieces, linear in the coordinates. As a row of a joint it stands for its two components."""

    pieces: tuple
    __array_ufunc__ = None  # numpy leaves its operators to those below

    def __repr__(self):
        return f"<vector of {_sides_of(self.pieces)}>"

    def __add__(self, other: "Vector") -> "Vector":
        pieces = {id(piece.profile): piece for piece in self.pieces}
        for piece in _vector(other).pieces:
            known = pieces.get(id(piece.profile))
            pieces[id(piece.profile)] = piece if known is None else known.plus(piece)
        return Vector(tuple(pieces.values()))

    def __radd__(self, other: object) -> "Vector":
        return self + _vector(other)

    def __sub__(self, other: "Vector") -> "Vector":
        return self + -_vector(other)

    def __rsub__(self, other: object) -> "Vector":
        return -self + _vector(other)

    def __neg__(self) -> "Vector":
        return self * -1.0

    def __mul__(self, number: float) -> "Vector":
        if not is_number(number):
            hint = "pi.dot and pi.cross multiply two vectors" if isinstance(number, Vector) else "use a finite number"
            raise InputError(f"a vector of a joint is multiplied by {in_words(number)}; {hint}{_most(number)}")
        return self._times(complex(number))

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> "Vector":
        return self * _inverse("a vector", number)

    def turned(self, angle: float | Profile) -> "Vector":
        """The vector turned by an angle in rad: a number, or a profile of time."""
        if isinstance(angle, Profile):
            if any(piece.profile is not None for piece in self.pieces):
                raise InputError("turned: a part of the vector is turned by a profile already; use the profile of the whole angle")
            return Vector(tuple(replace(piece, profile=angle) for piece in self.pieces))
        if not is_number(angle):
            raise InputError(f"turned: {angle!r} is neither a number in rad nor a profile")
        return self._times(np.exp(1j * angle))

    def onto(self, other: "Vector") -> "Vector":
        """The vector turned by the constant angle that lays it along `other` in the reference configuration."""
        here, there = self.rest, _vector(other).rest
        if not (abs(here) > 0 and abs(there) > 0):
            raise InputError("onto: one of the two vectors is zero at rest, which has no direction")
        turn = there * here.conjugate()
        return self._times(turn / abs(turn))

    def _times(self, w):
        return Vector(tuple(piece.times(w) for piece in self.pieces))

    @property
    def rest(self) -> complex:
        """Its value in the reference configuration, profiles at zero, as a complex number."""
        return sum((piece.rest for piece in self.pieces), 0j)


@dataclass(frozen=True)
class Product:
    """`E . F`: E a piece that a profile may turn, F one that none does. one_way: see `Row.one_way`."""

    turning: Piece
    still: Piece
    one_way: bool = False

    @property
    def linear(self):
        """Whether it is linear in the coordinates, and the same at all times."""
        return self.turning.profile is None and not (self.turning.terms and self.still.terms)


@dataclass(frozen=True)
class Row:
    """One row of phi: a constant, a sum of products, and profiles of time, (factor, profile) each, in `drives`.

    label, unit: of its multiplier, as in "angle", "N m".
    """

    products: tuple
    constant: float = 0.0
    drives: tuple = ()
    label: str = ""
    unit: str = ""
    __array_ufunc__ = None  # numpy leaves its operators to those below

    def __repr__(self):
        return f"<row of {_sides_of(piece for product in self.products for piece in (product.turning, product.still))}>"

    def __add__(self, other: "Row | Profile | float") -> "Row":
        row = _row(other)
        products, drives = self.products + row.products, self.drives + row.drives
        return replace(self, products=products, constant=self.constant + row.constant, drives=drives)

    __radd__ = __add__

    def __sub__(self, other: "Row | Profile | float") -> "Row":
        return self + -_row(other)

    def __rsub__(self, other: "Row | Profile | float") -> "Row":
        return -self + other

    def __neg__(self) -> "Row":
        return self * -1.0

    def __mul__(self, number: float) -> "Row":
        if not is_number(number):
            raise InputError(f"a row of a joint is multiplied by {in_words(number)}; use a finite number{_most(number)}")
        scaled = tuple(replace(p, still=p.still.times(complex(number))) for p in self.products)
        drives = tuple((number * factor, profile) for factor, profile in self.drives)
        return replace(self, products=scaled, constant=number * self.constant, drives=drives)

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> "Row":
        return self * _inverse("a row", number)

    @property
    def driven(self):
        """Whether a profile turns a vector in it, or is a part of it."""
        return bool(self.drives) or any(product.turning.profile is not None for product in self.products)

    def named(self, label: str, unit: str = "") -> "Row":
        """The row with the name and unit of its multiplier."""
        if not (isinstance(label, str) and isinstance(unit, str)):
            raise InputError(f"named: label {label!r:.40} and unit {unit!r:.40} of a row must be texts")
        return replace(self, label=label, unit=unit)

    def one_way(self) -> "Row":
        """The row of a `cross` that vanishes also with a vector turned by half a turn: states with that are not accepted."""
        return replace(self, products=tuple(replace(p, one_way=True) for p in self.products))


@named_keywords
def cross(a: Vector, b: Vector) -> Row:
    """`a_x b_y - a_y b_x` of two vectors, a Row."""
    return dot(_vector(a)._times(1j), b)


@named_keywords
def dot(a: Vector, b: Vector) -> Row:
    """`a . b` of two vectors, a Row."""
    return Row(tuple(_product(e, f) for e in _vector(a).pieces for f in _vector(b).pieces))


def rows_of(formula):
    """The Rows of what a joint's `rows()` gives: Rows as they are, vectors as two. Raises InputError, naming the entry, for anything else."""
    for number, vector in enumerate(formula, 1):
        if isinstance(vector, Row):
            yield vector
        elif not isinstance(vector, Vector):
            wanted = "the list needs a vector there, which stands for two rows, or a row made by pi.dot or pi.cross"
            raise InputError(f"entry {number} of {len(formula)} is {in_words(vector)}; {wanted}")
        else:
            places = any(part == "point" for piece in vector.pieces for _, part, _ in piece.terms)
            for label, axis in (("x", 1 + 0j), ("y", 1j)):
                yield dot(along(axis), vector).named(label, "N" if places else "N m")


def along(direction):
    """A constant vector, from a complex number."""
    return Vector((Piece(constant=complex(direction)),))


def _product(e, f):
    if e.profile is f.profile:
        return Product(replace(e, profile=None), replace(f, profile=None))
    if e.profile is None:
        return Product(f, e)
    if f.profile is None:
        return Product(e, f)
    return Product(replace(e, profile=difference(e.profile, f.profile)), replace(f, profile=None))


def rest_of(side, part):
    """The "point" or "direction" of an attachment or of a place of the ground, in the reference configuration."""
    x, y = side.point if part == "point" else side.direction
    return complex(x, y)


def _vector(given):
    if isinstance(given, Vector):
        return given
    wanted = "a joint's formula needs a vector here, the .x or .d of an attachment or a sum of them"
    raise InputError(f"{wanted}, not {in_words(given)}{_most(given)}")


def _row(given):
    if isinstance(given, Row):
        return given
    if isinstance(given, Profile):
        return Row((), drives=((1.0, given),))
    if is_number(given):
        return Row((), constant=float(given))
    raise InputError(f"a row of a joint is added to {in_words(given)}; use pi.cross, pi.dot, finite numbers and profiles")


def in_words(given):
    """What stands in a formula, for messages."""
    if isinstance(given, (Row, Vector)):
        return f"a {repr(given)[1:-1]}"
    if isinstance(given, np.ndarray):
        return f"an array of shape {given.shape}"
    if isinstance(given, (list, tuple, dict)):
        return f"a {type(given).__name__} of {len(given)}"
    return "a profile of time" if isinstance(given, Profile) else f"{'the text ' * isinstance(given, str)}{given!r:.60}"


def _most(given):
    return "; a row is a sum of products of at most two factors" if isinstance(given, (Row, Vector)) else ""


def _inverse(what, number):
    if not is_number(number) or not number:
        raise InputError(f"{what} of a joint is divided by {in_words(number)}; divide by a number that is not 0")
    return 1.0 / number


def _sides_of(pieces):
    """The sides that pieces are made of, in words."""
    return ", ".join(dict.fromkeys(repr(side) for piece in pieces for side, _, _ in piece.terms)) or "the ground alone"
