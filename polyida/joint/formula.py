"""The formula language of joints: vectors of points and directions, and rows of phi made of their products.

A `Vector` is linear in the coordinates; parts of it may be turned by a profile of time. `cross`, `dot`, sums, numbers and profiles make
`Row`s of vectors. Vectors and rows are data: the assembly translates them into tables for compiled kernels.
"""

import re
from dataclasses import dataclass, replace

import numpy as np

from polyida.errors import InputError
from polyida.profile import Profile, difference
from polyida.validation import is_number, named_keywords

ADVICE = "a row is a sum of products of at most two factors, so use pi.dot and pi.cross, and square the condition of a length: `pi.dot(w, w) - r**2`"


@dataclass(frozen=True, eq=False)
class Summand:
    """`R(theta(t)) (constant + sum_j w_j z_j)` in complex numbers, z_j the "point" or "direction" of an attachment.

    terms: (attachment, "point" or "direction", w) each. profile: theta, rad, or None without rotation. of_ground: the places of the ground
    that the constant contains, in the form of terms.
    """

    terms: tuple = ()
    constant: complex = 0j
    profile: Profile | None = None
    of_ground: tuple = ()

    def times(self, w):
        """Return the product with the complex number w."""
        terms, of_ground = (tuple((side, part, w * u) for side, part, u in group) for group in (self.terms, self.of_ground))
        return replace(self, terms=terms, constant=w * self.constant, of_ground=of_ground)

    def plus(self, other):
        """Return the sum with a summand of the same profile."""
        terms, of_ground = self.terms + other.terms, self.of_ground + other.of_ground
        return replace(self, terms=terms, constant=self.constant + other.constant, of_ground=of_ground)

    def at(self, place):
        """Return the value without the rotation theta; `place(attachment, "point" or "direction")` returns z_j."""
        return self.constant + sum(w * place(side, part) for side, part, w in self.terms)

    @property
    def rest(self):
        """The value in the reference configuration without the rotation theta."""
        return self.at(rest_of)


@dataclass(frozen=True, eq=False)
class Vector:
    """A vector of the plane, m, linear in the coordinates. In the list of `rows()` of a joint it stands for its two components."""

    summands: tuple
    __array_ufunc__ = None  # numpy leaves the operators to this class

    def __repr__(self):
        return f"<vector of {_sides_of(self.summands)}>"

    def __add__(self, other: "Vector") -> "Vector":
        summands = {id(s.profile): s for s in self.summands}
        for s in _vector(other).summands:
            known = summands.get(id(s.profile))
            summands[id(s.profile)] = s if known is None else known.plus(s)
        return Vector(tuple(summands.values()))

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
        """Return the vector turned by an angle, rad: a number or a profile of time."""
        if isinstance(angle, Profile):
            if any(s.profile is not None for s in self.summands):
                raise InputError("turned: a part of the vector is turned by a profile already; use the profile of the whole angle")
            return Vector(tuple(replace(s, profile=angle) for s in self.summands))
        if not is_number(angle):
            raise InputError(f"turned: {angle!r} is neither a number in rad nor a profile")
        return self._times(np.exp(1j * angle))

    def onto(self, other: "Vector") -> "Vector":
        """Return the vector turned by the constant angle that makes it parallel to `other` in the reference configuration."""
        own, target = self.rest, _vector(other).rest
        if not (abs(own) > 0 and abs(target) > 0):
            raise InputError("onto: one of the two vectors is zero at rest and has no direction")
        turn = target * own.conjugate()
        return self._times(turn / abs(turn))

    def _times(self, w):
        return Vector(tuple(s.times(w) for s in self.summands))

    @property
    def rest(self) -> complex:
        """Value in the reference configuration with all profiles zero, as a complex number."""
        return sum((s.rest for s in self.summands), 0j)


@dataclass(frozen=True)
class Product:
    """`E . F` of two summands; only E may have a profile. one_way: see `Row.one_way`."""

    rotated: Summand
    unrotated: Summand
    one_way: bool = False

    @property
    def linear(self):
        """True if it is linear in the coordinates and does not depend on time."""
        return self.rotated.profile is None and not (self.rotated.terms and self.unrotated.terms)


@dataclass(frozen=True)
class Row:
    """One row of phi: a constant, a sum of products, and in `drives` (factor, profile of time) pairs.

    label, unit: of its multiplier, as in "angle", "N m".
    """

    products: tuple
    constant: float = 0.0
    drives: tuple = ()
    label: str = ""
    unit: str = ""
    __array_ufunc__ = None  # numpy leaves the operators to this class

    def __repr__(self):
        return f"<row of {_sides_of(s for product in self.products for s in (product.rotated, product.unrotated))}>"

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
        scaled = tuple(replace(p, unrotated=p.unrotated.times(complex(number))) for p in self.products)
        drives = tuple((number * factor, profile) for factor, profile in self.drives)
        return replace(self, products=scaled, constant=number * self.constant, drives=drives)

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> "Row":
        return self * _inverse("a row", number)

    @property
    def driven(self):
        """True if the row depends on a profile of time."""
        return bool(self.drives) or any(product.rotated.profile is not None for product in self.products)

    def named(self, label: str, unit: str = "") -> "Row":
        """Return the row with a name and unit for its multiplier."""
        if not (isinstance(label, str) and isinstance(unit, str)):
            raise InputError(f"named: label {label!r:.40} and unit {unit!r:.40} of a row must be texts")
        return replace(self, label=label, unit=unit)

    def one_way(self) -> "Row":
        """Return a `cross` row that excludes its second solution: a state with one vector turned by half a turn is rejected."""
        return replace(self, products=tuple(replace(p, one_way=True) for p in self.products))


@named_keywords
def cross(a: Vector, b: Vector) -> Row:
    """Return the row `a_x b_y - a_y b_x` of a joint's formula.

    Parameters
    ----------
    a, b : Vector

    Returns
    -------
    Row
        Bilinear in a and b, of the product of their units.

    Raises
    ------
    InputError
        If a or b is not a vector.
    """
    return dot(_vector(a)._times(1j), b)


@named_keywords
def dot(a: Vector, b: Vector) -> Row:
    """Return the row `a . b` of a joint's formula.

    Parameters
    ----------
    a, b : Vector

    Returns
    -------
    Row
        Bilinear in a and b, of the product of their units.

    Raises
    ------
    InputError
        If a or b is not a vector.
    """
    products = []
    for e in _vector(a).summands:
        for f in _vector(b).summands:
            rotated, unrotated = (f, e) if e.profile is None and f.profile is not None else (e, f)
            if unrotated.profile is not None:  # R(alpha) E . R(beta) F = R(alpha - beta) E . F
                angle = None if rotated.profile is unrotated.profile else difference(rotated.profile, unrotated.profile)
                rotated = replace(rotated, profile=angle)
            products.append(Product(rotated, replace(unrotated, profile=None)))
    return Row(tuple(products))


def rows_of(formula):
    """Yield the Rows in the list that a joint's `rows()` returns, two for each vector. Raise InputError for any other entry."""
    for number, vector in enumerate(formula, 1):
        if isinstance(vector, Row):
            yield vector
        elif not isinstance(vector, Vector):
            wanted = "the list needs a vector there, which stands for two rows, or a row made by pi.dot or pi.cross"
            raise InputError(f"entry {number} of {len(formula)} is {in_words(vector)}; {wanted}")
        else:
            of_points = any(part == "point" for s in vector.summands for _, part, _ in s.terms)
            for label, axis in (("x", 1 + 0j), ("y", 1j)):
                yield dot(along(axis), vector).named(label, "N" if of_points else "N m")


def along(direction):
    """Return a constant vector."""
    return Vector((Summand(constant=complex(direction)),))


def rest_of(side, part):
    """Return the "point" or "direction" of a side in the reference configuration as a complex number."""
    x, y = side.point if part == "point" else side.direction
    return complex(x, y)


def _vector(value):
    if isinstance(value, Vector):
        return value
    wanted = "a joint's formula needs a vector here, the .x or .d of an attachment or a sum of them"
    raise InputError(f"{wanted}, not {in_words(value)}{_most(value)}")


def _row(value):
    if isinstance(value, Row):
        return value
    if isinstance(value, Profile):
        return Row((), drives=((1.0, value),))
    if is_number(value):
        return Row((), constant=float(value))
    raise InputError(f"a row of a joint is added to {in_words(value)}; use pi.cross, pi.dot, finite numbers and profiles")


def in_words(value):
    """Return a description of an entry of a formula for messages."""
    if isinstance(value, (Row, Vector)):
        return f"a {repr(value)[1:-1]}"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    if isinstance(value, (list, tuple, dict)):
        return f"a {type(value).__name__} of {len(value)}"
    return "a profile of time" if isinstance(value, Profile) else f"{'the text ' * isinstance(value, str)}{value!r:.60}"


def _most(value):
    return f"; {ADVICE}" if isinstance(value, (Row, Vector)) else ""


def advice_on(error):
    """Advice about an exception in `rows()`: of the operations that rows and vectors do not have, such as roots, powers, `@` and indices."""
    return f"; {ADVICE}" if isinstance(error, TypeError) and re.search(r"\b(Row|Vector)\b", str(error)) else ""


def _inverse(what, number):
    if not is_number(number) or not number:
        raise InputError(f"{what} of a joint is divided by {in_words(number)}; divide by a number that is not 0")
    return 1.0 / number


def _sides_of(summands):
    return ", ".join(dict.fromkeys(repr(side) for s in summands for side, _, _ in s.terms)) or "the ground alone"
