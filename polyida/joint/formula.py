"""The formula language of joints: vectors of points and directions, and rows of phi made of their products.

A `Vector` is linear in the coordinates; parts of it may be turned by a profile of time. `cross`, `dot`, sums, numbers and profiles make
`Row`s of vectors; with the `rate` of a vector in each product these are velocity rows, `W(t, q) v + w(t)`. A row may have a law in place of
the equation, of unilateral contact or of dry friction. Vectors and rows are data: the assembly translates them into tables for compiled kernels.
"""

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.profile import Profile, difference
from polyida.validation import is_number, named_keywords

ADVICE = "a row is a sum of products of at most two factors, so use pi.dot and pi.cross, and square the condition of a length: `pi.dot(w, w) - r**2`; other curves need a helper body (guide, own parts)"


@dataclass(frozen=True, eq=False)
class Summand:
    """`R(theta(t)) (constant + sum_j w_j z_j)` in complex numbers, z_j the "point" or "direction" of an attachment, or its rate in time.

    terms: (attachment, "point" or "direction", w) each. profile: theta, rad, or None without rotation. of_ground: the places of the ground
    that the constant contains, in the form of terms. rate: True for `sum_j w_j z_j'`, without constant and rotation.
    """

    terms: tuple = ()
    constant: complex = 0j
    profile: Profile | None = None
    of_ground: tuple = ()
    rate: bool = False

    def times(self, w):
        """Return the product with the complex number w, a Summand."""
        terms, of_ground = (tuple((side, part, w * u) for side, part, u in group) for group in (self.terms, self.of_ground))
        return replace(self, terms=terms, constant=w * self.constant, of_ground=of_ground)

    def plus(self, other):
        """Return the sum with another Summand that has the same profile."""
        terms, of_ground = self.terms + other.terms, self.of_ground + other.of_ground
        return replace(self, terms=terms, constant=self.constant + other.constant, of_ground=of_ground)

    def at(self, place):
        """Return the value without the rotation theta; `place(attachment, "point" or "direction")` returns z_j. A rate is zero in the reference configuration."""
        return 0j if self.rate else self.constant + sum(w * place(side, part) for side, part, w in self.terms)

    @property
    def rest(self):
        """The value in the reference configuration without the rotation theta."""
        return self.at(rest_of)


@dataclass(frozen=True, eq=False)
class Vector:
    """A vector of the plane, m, or its rate, m/s, linear in the coordinates. In a joint's list of rows it stands for its two components."""

    summands: tuple
    __array_ufunc__ = None  # numpy leaves the operators to this class

    def __repr__(self):
        """One line with the sides of which the vector is made."""
        return f"<vector of {_sides_of(self.summands)}>"

    def __add__(self, other: "Vector") -> "Vector":
        """The sum of two vectors, or of two rates of vectors."""
        if self._is_rate != _vector(other)._is_rate:
            raise InputError("a vector is added to a rate of a vector; a product has one rate, and a sum has rates alone or none")
        summands = {id(s.profile): s for s in self.summands}
        for s in _vector(other).summands:
            known = summands.get(id(s.profile))
            summands[id(s.profile)] = s if known is None else known.plus(s)
        return Vector(tuple(summands.values()))

    def __radd__(self, other: object) -> "Vector":
        """The sum of another vector and this one."""
        return self + _vector(other)

    def __sub__(self, other: "Vector") -> "Vector":
        """The difference of this vector and another one."""
        return self + -_vector(other)

    def __rsub__(self, other: object) -> "Vector":
        """The difference of another vector and this one."""
        return -self + _vector(other)

    def __neg__(self) -> "Vector":
        """The vector times -1, a Vector."""
        return self * -1.0

    def __mul__(self, number: float) -> "Vector":
        """The vector times a finite number, a Vector."""
        if not is_number(number):
            hint = "pi.dot and pi.cross multiply two vectors" if isinstance(number, Vector) else "use a finite number"
            raise InputError(f"a vector of a joint is multiplied by {in_words(number)}; {hint}{_most(number)}")
        return self._times(complex(number))

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> "Vector":
        """The vector divided by a finite number other than 0."""
        return self * _inverse("a vector", number)

    def turned(self, angle: float | Profile) -> "Vector":
        """Return the vector turned by an angle, rad: a number or a profile of time."""
        if isinstance(angle, Profile):
            if self._is_rate:
                raise InputError("turned: a rate cannot be turned by a profile; turn the other factor of the product by minus the profile")
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
        """The vector times a complex number w: rotated by its argument and scaled by |w|."""
        return Vector(tuple(s.times(w) for s in self.summands))

    @property
    def rate(self) -> "Vector":
        """The derivative in time, a Vector in m/s, for `velocity_rows()` of a joint."""
        if any(s.profile is not None or s.rate for s in self.summands):
            raise InputError("rate: there is no rate of a rate, nor of a vector that a profile turns")
        return Vector(tuple(replace(s, constant=0j, rate=True) for s in self.summands))

    @property
    def _is_rate(self):
        """True if the vector is a rate, m/s."""
        return any(s.rate for s in self.summands)

    @property
    def rest(self) -> complex:
        """Value in the reference configuration with all profiles zero, as a complex number."""
        return sum((s.rest for s in self.summands), 0j)


@dataclass(frozen=True)
class Product:
    """`E . F` of two summands; only E may have a profile, and only F may be a rate. one_way: see `Row.one_way`."""

    rotated: Summand
    unrotated: Summand
    one_way: bool = False

    @property
    def linear(self):
        """True if it is linear in the coordinates and does not depend on time."""
        return self.rotated.profile is None and not (self.rotated.terms and self.unrotated.terms)


@dataclass(frozen=True, eq=False)
class Law:
    """The law of a row in place of `phi = 0`: unilateral contact if restitution is a number, else dry friction.

    Contact: `0 <= -lam, phi >= 0, lam phi = 0`, impacts with restitution e. Friction: `|lam| <= constant + mu |lam_on|`, with equality against
    the rate where this is not zero. on: rows or vectors of the same joint, whose multipliers make the norm |lam_on|.
    """

    restitution: float | None = None
    mu: float = 0.0
    on: tuple = ()
    constant: float = 0.0


@dataclass(frozen=True)
class Row:
    """One row of phi or velocity row: a constant, a sum of products, and in `drives` (factor, profile of time) pairs.

    label, unit: of its multiplier, as in "angle", "N m". law: of contact or friction; None for an equation.
    """

    products: tuple
    constant: float = 0.0
    drives: tuple = ()
    label: str = ""
    unit: str = ""
    law: Law | None = None
    __array_ufunc__ = None  # numpy leaves the operators to this class

    def __repr__(self):
        """One line with the sides of which the row is made."""
        return f"<row of {_sides_of(s for product in self.products for s in (product.rotated, product.unrotated))}>"

    def __add__(self, other: "Row | Profile | float") -> "Row":
        """The sum of the row and another row, a profile of time, or a number."""
        row = _row(other)
        products, drives = self.products + row.products, self.drives + row.drives
        return replace(self, products=products, constant=self.constant + row.constant, drives=drives)

    __radd__ = __add__

    def __sub__(self, other: "Row | Profile | float") -> "Row":
        """The difference of the row and another row, a profile, or a number."""
        return self + -_row(other)

    def __rsub__(self, other: "Row | Profile | float") -> "Row":
        """The difference of a profile or a number and the row."""
        return -self + other

    def __neg__(self) -> "Row":
        """The row times -1, a Row."""
        return self * -1.0

    def __mul__(self, number: float) -> "Row":
        """The row times a finite number, a Row."""
        if not is_number(number):
            raise InputError(f"a row of a joint is multiplied by {in_words(number)}; use a finite number{_most(number)}")
        scaled = tuple(replace(p, unrotated=p.unrotated.times(complex(number))) for p in self.products)
        drives = tuple((number * factor, profile) for factor, profile in self.drives)
        return replace(self, products=scaled, constant=number * self.constant, drives=drives)

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> "Row":
        """The row divided by a finite number other than 0."""
        return self * _inverse("a row", number)

    @property
    def rate(self):
        """True for a velocity row, whose products all have a rate; False if none has; None for anything else."""
        rates = {product.unrotated.rate for product in self.products}
        return rates.pop() if len(rates) == 1 else False if not rates else None

    @property
    def driven(self):
        """True if the row depends on a profile of time, or is a velocity row with a constant: it can do work."""
        return (
            bool(self.drives) or bool(self.rate and self.constant) or any(product.rotated.profile is not None for product in self.products)
        )

    @property
    def gap(self):
        """True for a unilateral row `phi >= 0`, which may open."""
        return self.law is not None and self.law.restitution is not None

    def named(self, label: str, unit: str = "") -> "Row":
        """Return the row with a name and unit for its multiplier."""
        if not (isinstance(label, str) and isinstance(unit, str)):
            raise InputError(f"named: label {label!r:.40} and unit {unit!r:.40} of a row must be texts")
        return replace(self, label=label, unit=unit)

    @named_keywords
    def opens(self, restitution: float = 0.0) -> "Row":
        """Return the row as a gap `phi >= 0`, which carries pressure alone and may open: `0 <= -lam`, `lam phi = 0`.

        Parameters
        ----------
        restitution : float
            e in [0, 1] of impacts: `phi' = -e phi'` of before (Newton).

        Returns
        -------
        Row

        Raises
        ------
        InputError
            If e is not in [0, 1], or the row is a velocity row.
        """
        if not (is_number(restitution) and 0.0 <= restitution <= 1.0):
            raise InputError(f"opens: restitution = {restitution!r:.60} must be a number in [0, 1]")
        if self.rate:
            raise InputError("opens: a velocity row is no gap; use a row of rows()")
        return replace(self, law=Law(restitution=float(restitution)))

    @named_keywords
    def rubs(self, mu: float, on: Any = (), constant: float = 0.0) -> "Row":
        """Return the row as one of dry friction (Coulomb): `|lam| <= constant + mu |lam_on|`; it slips only where that is an equation.

        Parameters
        ----------
        mu : float
            Friction coefficient, mu >= 0; of a row in rad, times the radius, m.
        on : list of Row or Vector
            Entries of the same list of rows whose multipliers press; |lam_on| is the root of the sum of their squares.
        constant : float, N or N m
            Friction without pressure, >= 0.

        Returns
        -------
        Row
            Only its rate is restricted. A row of `rows()` becomes a velocity row.

        Raises
        ------
        InputError
            For a negative or missing number, or entries of `on` that are neither rows nor vectors.
        """
        for name, value in (("mu", mu), ("constant", constant)):
            if not (is_number(value) and value >= 0.0):
                raise InputError(f"rubs: {name} = {value!r:.60} must be a number of at least 0")
        rows = tuple(on) if isinstance(on, (list, tuple)) else (on,)
        if not all(isinstance(row, (Row, Vector)) for row in rows):
            raise InputError(f"rubs: on = {on!r:.60} must be a list of rows or vectors that press")
        if mu and not rows:
            raise InputError(f"rubs: mu = {mu:g} needs `on`, the rows that press, for example on=[gap]")
        return replace(self, law=Law(mu=float(mu), on=rows, constant=float(constant)))

    def velocity(self) -> "Row":
        """Return the derivative in time as a velocity row."""
        if self.driven:
            raise InputError("a row of friction depends on a profile of time; give its slip as a velocity row, with .rate")
        products = []
        for product in self.products:
            one, other = product.rotated, product.unrotated
            products += [replace(product, unrotated=replace(other, constant=0j, rate=True))] if other.terms else []
            products += [replace(product, rotated=other, unrotated=replace(one, constant=0j, rate=True))] if one.terms else []
        return replace(self, products=tuple(products), constant=0.0)

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
            if e.rate and f.rate:
                raise InputError("a product of two rates is not linear in the velocities; a velocity row has one rate in each product")
            rotated, unrotated = (f, e) if e.rate or (e.profile is None and f.profile is not None and not f.rate) else (e, f)
            if unrotated.profile is not None:  # R(alpha) E . R(beta) F = R(alpha - beta) E . F
                angle = None if rotated.profile is unrotated.profile else difference(rotated.profile, unrotated.profile)
                rotated = replace(rotated, profile=angle)
            products.append(Product(rotated, replace(unrotated, profile=None)))
    return Row(tuple(products))


def rows_of(formula):
    """Yield the Rows in a joint's list of rows, two for each vector. Raise InputError for any other entry."""
    for number, vector in enumerate(formula, 1):
        if isinstance(vector, Row):
            yield vector
        elif not isinstance(vector, Vector):
            expected = "the list needs a vector there, which stands for two rows, or a row made by pi.dot or pi.cross"
            raise InputError(f"entry {number} of {len(formula)} is {in_words(vector)}; {expected}")
        else:
            of_points = any(part == "point" for s in vector.summands for _, part, _ in s.terms)
            for label, axis in (("x", 1 + 0j), ("y", 1j)):
                yield dot(along(axis), vector).named(label, "N" if of_points else "N m")


def with_laws(formula):
    """The Rows of a joint's list of rows. Rows of friction become velocity rows, and `on` of their laws numbers in the list.

    Raises InputError if an entry of `on` is not in the list.
    """
    rows, numbers, first = list(rows_of(formula)), {}, 0
    for entry in formula:
        last = first + (2 if isinstance(entry, Vector) else 1)
        numbers[id(entry)], first = range(first, last), last
    for k, row in enumerate(rows):
        if row.law and not row.gap:
            if not all(id(entry) in numbers for entry in row.law.on):
                raise InputError(
                    f"row {k + 1} of {len(rows)}: rubs(on=...) must name entries of the same list of rows, as in [gap, slip.rubs(0.3, on=[gap])]"
                )
            on = tuple(number for entry in row.law.on for number in numbers[id(entry)])
            rows[k] = replace(row if row.rate else row.velocity(), law=replace(row.law, on=on))
    return rows


def all_rows(part):
    """All Rows of a joint, the velocity rows last, or the rows of a body."""
    return [*rows_of(part.rows()), *rows_of(part.velocity_rows() if hasattr(part, "velocity_rows") else ())]


def along(direction):
    """Return a vector (x + i y) that does not move."""
    return Vector((Summand(constant=complex(direction)),))


def rest_of(side, part):
    """Return the "point" or "direction" of a side in the reference configuration as a complex number."""
    x, y = side.point if part == "point" else side.direction
    return complex(x, y)


def _vector(value):
    """The value if it is a Vector; InputError for anything else."""
    if isinstance(value, Vector):
        return value
    expected = "a joint's formula needs a vector here, the .x or .d of an attachment or a sum of them"
    raise InputError(f"{expected}, not {in_words(value)}{_most(value)}; a constant vector is `pi.ground.at(point, direction).d`")


def _row(value):
    """A row of a Row, a profile or a number; InputError for anything else."""
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
    """The end of a message, with the advice on formulas, if the value is a Row or a Vector; otherwise empty."""
    return f"; {ADVICE}" if isinstance(value, (Row, Vector)) else ""


def advice_on(error):
    """Advice about an exception in `rows()`: of the operations that rows and vectors do not have, such as roots, powers, `@` and indices."""
    if isinstance(error, AttributeError) and isinstance(error.obj, Vector) and hasattr(Row, error.name):
        return f"; `{error.name}` is of rows, which pi.dot and pi.cross make of vectors"
    return f"; {ADVICE}" if isinstance(error, TypeError) and re.search(r"\b(Row|Vector)\b", str(error)) else ""


def _inverse(what, number):
    """Return 1 / number. Raises InputError unless it is a finite number other than 0; what: the divided thing, in words."""
    if not is_number(number) or not number:
        raise InputError(f"{what} of a joint is divided by {in_words(number)}; divide by a number that is not 0")
    return 1.0 / number


def _sides_of(summands):
    """The sides that summands are made of, each once, as a text; "the ground alone" if there are none."""
    return ", ".join(dict.fromkeys(repr(side) for s in summands for side, _, _ in s.terms)) or "the ground alone"
