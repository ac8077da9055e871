"""Parameters of the profiles of a scene, and slopes in time.

The module sums multipliers by profile (`sum w . r + mu . phi + kappa . rate + nu . bias`), differentiates profiles in their numbers, and
the entries of that sum in their own times.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache, partial
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.adjoint.parameter import AdjointMultipliers, Parameter, part_with_profile, select_entries, total, with_profile
from polyida.assembly.increments import drive_table
from polyida.assembly.own_forces import OwnForce
from polyida.assembly.placement import GRAVITY
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, profiles_of
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.model.differences import FIRST_ORDER_STEP, along, around, beside, within
from polyida.profile import MAKERS, REACH, SAMPLES, Profile, polynomial, scaled
from polyida.registry import is_built_in
from polyida.validation import complex_of_pairs, floats, is_number

ORDERS = ("value", "d1", "d2")
SCALE = REACH[1] / FIRST_ORDER_STEP  # s, over which functions of time of one's own vary
DEFAULTS = tuple(kind.profile for kind in (PointLoad, EdgeTraction))  # of loads that were given none


def over(profile, t, order=0):
    """Value or derivative of a profile at times t (k,), (k,); the third by differences that stay on one side of its kinks."""
    if order == len(ORDERS):
        step = FIRST_ORDER_STEP * min(1.0, profile.shortest or 1.0)
        return np.array([within(lambda s, at=at: profile.d2(at + s), around(profile.kinks, at), step) for at in t.tolist()])
    return profile.over(t, order)


def slope_over(profile, profile_at, scale, speeds, orders, t):
    """The derivative of `profile_at(s)` in s at s = 0, in value and derivatives of these orders at times t (k,), (k, orders).

    speeds (kinks,): derivatives of its kinks in s. Differences follow the kinks, so that none crosses one:

        dp_s(t)/ds = d/ds p_s(t + s moved) - moved p'(t),    moved (k,): the speeds, interpolated between kinks
    """
    moved = np.interp(t, profile.kinks, speeds) if speeds.any() else np.zeros(len(t))
    if moved.any():
        at_kink = (np.abs(t[:, None] - profile.kinks) <= 8 * np.spacing(np.maximum(1.0, np.abs(t)))[:, None]).any(axis=1)
        t = np.array(t)
        t[at_kink] = [_beside_kink(profile, at) for at in t[at_kink].tolist()]

    def table(s):
        """`profile_at(s)` in these orders, (k, orders), at the times t moved along with the kinks."""
        near = profile_at(s)
        return np.stack([over(near, t + s * moved, order) for order in orders], axis=1)

    result = along(table, scale)
    return result - np.stack([moved * over(profile, t, order + 1) for order in orders], axis=1) if moved.any() else result


def _beside_kink(profile, t):
    """The time just beside a kink t, on the side whose values the profile takes, since round-off would choose the side."""
    at = np.array([beside(t, -1), t, beside(t, 1)])
    apart = sum(np.abs(values - values[1]) for values in (over(profile, at, order) for order in range(len(ORDERS))))
    return float(at[0] if apart[0] < apart[2] else at[2])


def at_sides(own, x):
    """Values (k, sides, 2) of x (k, n) at the sides of an OwnForce."""
    return (own.A @ x.T).T.reshape(len(x), -1, 2)


def element_work(own, element, work):
    """`-w . A^T f` of each entry, (k,), of an element on the sides of an OwnForce, with its states."""
    own, x, v = own.with_element(element), own.rest + at_sides(own, work.q), at_sides(own, work.v)
    forces = [own.forces(*state) for state in zip(work.t.tolist(), x, v)]
    return -np.einsum("kie,kie->k", at_sides(own, work.w), np.reshape(forces, x.shape))


def profile_works(model, work):
    """Slopes (k, profiles, 3) of each entry of the sum in value, rate and second derivative of every profile of a scene."""
    result = np.zeros((len(work.t), len(model.profiles), 3))
    s, links = model.arrays.plates, model.arrays.links
    w = work.w.reshape(len(work.t), -1, 2)
    for k, drive in enumerate(s.load_drive):  # forces times a value: `r = ... - value F`
        of = slice(s.load_ptr[k], s.load_ptr[k + 1])
        result[:, drive, 0] -= np.einsum("kie,ie->k", w[:, s.load_nodes[of]], s.load_values[of])
    for row, drive, factor, shift in zip(
        links.shift_row, links.shift_drive, links.shift_factor, links.shift_order
    ):  # profiles added to rows
        for order, factors in enumerate((work.mu, work.kappa, work.nu)):
            if factors is not None and order + shift > 0:
                result[:, drive, order + shift - 1] += factor * factors[:, row]
    _add_products(model, work, result)
    for name, part in model.parts.items():
        if isinstance(part, ForceElement):
            _add_element(model, name, part, work, result)
    return result


def _add_products(model, work, result):
    """Add the slopes in angles theta of drives that turn vectors to result, from rows `R(theta) E . F` of a scene's joints.

    result[:, drive] (count, 3) += multiplier or adjoint in work times slope, for the profile's value and its two derivatives. With
    `across = (R E) x F` and `along = R E . F`, slopes in theta are as follows.

    The value's is `across`; the rate's `theta' across + E' . F + E . F'`; the bias' that of `2 E' . F' + theta'' across
    - theta'^2 along + 2 theta' (E' x F + E x F')`. A turn by a right angle makes across of along, and minus along of across.
    Of velocity rows `R(theta) E . F'` the rate is the row itself and the bias `E' . F' + theta' E x F'`; their force acts on F alone.

    In the code, complex (k, products): e, f: the turned and the other vector; u, g: their rates without the turn; we, wf: their changes along
    w.
    """
    s = model.arrays.links
    turned, used, of_first, of_other = model.once(_turned_vectors, of_shape=True)
    if not (len(turned) and len(work.t)):
        return
    angles = drive_table(model, work.t, (work.t[0], work.t[-1]))[:, s.product_drive[turned]]
    rotation, speed, second = np.exp(1j * angles[..., 0]), angles[..., 1], angles[..., 2]
    first, other, rows = s.product_first[turned], s.product_second[turned], s.product_row[turned]

    def moved(x):
        """Changes (count, products) of both vectors of each product along x (count, n), complex; the drive turns the first one."""
        z = complex_of_pairs(x.reshape(len(x), -1, 2)[:, used])
        return rotation * (z @ of_first), z @ of_other

    rest = complex_of_pairs(s.vector_rest)
    (e, f), (we, wf) = moved(work.q), moved(work.w)
    e, f = e + rotation * rest[first], f + rest[other]
    held = 1.0 - s.product_rate[turned]  # 0 of velocity rows
    slopes = np.zeros((len(work.t), len(turned), 3))
    slopes[..., 0] = work.lam[:, rows] * (held * _cross(we, f) + _cross(e, wf))
    if work.mu is not None:
        slopes[..., 0] += work.mu[:, rows] * _cross(e, f)
    if work.kappa is not None or work.nu is not None:
        u, g = moved(work.v)
        mixed = held * _cross(u, f) + _cross(e, g)
        if work.kappa is not None:
            _add_rates_of_products(slopes, work.kappa[:, rows], held, speed, mixed, e, f)
        if work.nu is not None:
            _add_biases_of_products(slopes, work.nu[:, rows], held, speed, second, mixed, (e, f), (u, g))
    for p, drive in enumerate(s.product_drive[turned]):
        result[:, drive] += slopes[:, p]


def _add_rates_of_products(slopes, kappa, held, speed, mixed, e, f):
    """Add those of `kappa . rate` to slopes (k, products, 3). mixed: `E' x F + E x F'`; held: 0 of velocity rows, else 1."""
    slopes[..., 0] += kappa * (mixed - held * speed * _dot(e, f))
    slopes[..., 1] += kappa * held * _cross(e, f)


def _add_biases_of_products(slopes, nu, held, speed, second, mixed, vectors, rates):
    """Add those of `nu . bias` to slopes (k, products, 3). speed, second: derivatives of the angle; vectors (e, f), and their rates (u, g)."""
    (e, f), (u, g), of_phi = vectors, rates, nu * held
    slopes[..., 0] += (nu + of_phi) * _cross(u, g) - of_phi * (second * _dot(e, f) + speed**2 * _cross(e, f))
    slopes[..., 0] -= speed * (2.0 * of_phi * _dot(u, f) + (nu + of_phi) * _dot(e, g))
    slopes[..., 1] += (nu + of_phi) * mixed - 2.0 * of_phi * speed * _dot(e, f)
    slopes[..., 2] += of_phi * _cross(e, f)


def _turned_vectors(model):
    """The products of two vectors of which a drive turns one.

    Returns (their numbers, the nodes of the points, changes of the first and of the other vector by these nodes, (nodes, products) complex).
    """
    from scipy.sparse import csr_array

    s = model.arrays.links
    turned, used = np.flatnonzero(s.product_drive >= 0), np.unique(s.point_nodes)
    vectors = csr_array((s.vector_weights @ (1, 1j), s.vector_points, s.vector_start), (len(s.vector_rest), model.n_points))
    weights = model.point_weights[:, used].T
    return turned, used, *((weights @ vectors[ends[turned]].T).toarray() for ends in (s.product_first, s.product_second))


def _cross(a, b):
    """The cross products of plane vectors as complex numbers."""
    return (a.conj() * b).imag


def _dot(a, b):
    """The scalar products of plane vectors as complex numbers."""
    return (a.conj() * b).real


def _add_element(model, name, element, work, result):
    """Add the slopes of a force element in its profiles, by differences of its forces; in rates too if it is Python."""
    own = OwnForce(name, element, model)
    for drive, profile in enumerate(model.profiles):
        if not any(known is profile for known in profiles_of(element)):
            continue
        for order, function in enumerate(ORDERS[:1] if element.by_numba else ORDERS):
            of_time, size = getattr(profile, function), max(1.0, np.abs(over(profile, work.t, order)).max())

            def pushed(s, profile=profile, function=function, of_time=of_time):
                """The work of the element, (k,), if s is added to this function of the profile: its value, rate or second derivative."""
                other = replace(profile, formula=(), **{function: lambda t: of_time(t) + s})
                return element_work(own, part_with_profile(element, profile, other), work)

            result[:, drive, order] += along(pushed, size)


def in_time(model, work):
    """The slope of `w . r + mu . phi + kappa . rate + nu . bias` of each entry in its time at fixed state, (k,).

    By derivatives of profiles for a scene, by differences for users' models and force elements.
    """
    result = np.zeros(len(work.t))
    if not model.is_scene:
        for k, t in enumerate(work.t.tolist()):
            entry = select_entries(work, slice(k, k + 1))
            result[k] = along(lambda s, entry=entry: total(model, entry._replace(t=entry.t + s)), SCALE, model._smooth(t))
        return result
    each = profile_works(model, work)
    for drive, profile in enumerate(model.profiles):
        for order in range(len(ORDERS)):
            used = np.flatnonzero(each[:, drive, order])
            result[used] += each[used, drive, order] * over(profile, work.t[used], order + 1)
    elements = [(name, part) for name, part in model.parts.items() if isinstance(part, ForceElement)]
    for name, part in elements:
        functions = (value for value in vars(part).values() if callable(value) and not isinstance(value, Profile))
        if is_built_in(type(part)) and not any(functions):  # time is in its forces by profiles alone
            continue
        own = OwnForce(name, part, model)

        def later(s, own=own, element=part):
            """Works of the element at times that are later by s, with profiles that are late by as much."""
            copy = element
            for profile in profiles_of(element):
                late = {order: partial(_delayed, getattr(profile, order), s) for order in ORDERS}
                copy = part_with_profile(copy, profile, replace(profile, formula=(), **late))
            return element_work(own, copy, work._replace(t=work.t + s))

        result += along(later, SCALE)
    return result


def _delayed(function, s, t):
    """Value at time t of a function of time that is late by s."""
    return function(t - s)


@dataclass(frozen=True, eq=False)
class ProfileNumber(Parameter):
    """A number of a profile, wherever the scene has this profile."""

    drive: int  # number of the profile in the model
    profile_at: Callable[[Any], Profile]  # function of the number -> profile
    scale: Callable[[Any], float]  # function of times (k,) -> size over which the profile varies with the number
    works: Callable  # function of AdjointMultipliers -> `profile_works`
    slopes: Callable  # function (t, q, adjoint) -> MotionSlopes of the start
    only_by_name: bool = False  # True if other numbers of the profile are equivalent
    _last: dict = field(default_factory=dict, init=False, repr=False)  # {(orders, times): their `_slopes`}, the last ones
    reason = "the numbers of the profile have slopes of their own"

    @property
    def profile(self):
        """The profile of the model to which the number belongs."""
        return self.model.profiles[self.drive]

    def slope(self, work):
        """`sum (w . dr/dp + mu . dphi/dp + ...)` by the profile's slopes in value, rate and second derivative."""
        each = self.works(work)[:, self.drive]
        used, orders = np.flatnonzero(each.any(axis=1)), np.flatnonzero(each.any(axis=0))
        if not len(used):
            return 0.0 * self.value
        times, places = np.unique(work.t[used], return_inverse=True)  # entries of a start have one time
        at = orders.tobytes(), times.tobytes()
        if at not in self._last:  # several objectives have the same times
            self._last.clear()
            self._last[at] = self._slopes(orders, times)
        return np.tensordot(each[np.ix_(used, orders)], self._last[at][places], 2)

    def start(self, t, q, adjoint):
        """Slope if driven joints change the given motions."""
        motion = self.slopes(t, q, adjoint)
        if motion is None:
            return None
        none = np.zeros_like(motion.lam)
        entries = (motion.v, motion.lam, motion.left, none, motion.kappa), (motion.v, none, -motion.left, none, none)  # but for loads
        v, lam, w, mu, kappa = map(np.stack, zip(*entries))
        return self.slope(AdjointMultipliers(np.full(2, t), np.stack((q, q)), v, np.zeros_like(v), lam, w, mu, kappa))

    def _slopes(self, orders, t):
        """Slopes (k, orders) of the profile in the number at times t."""
        return slope_over(self.profile, self._near, self.scale(t), self._speeds, orders, t)

    @cached_property
    def _speeds(self):
        """The derivatives of the profile's kinks, (kinks,), assumed constant."""
        scale = self.scale(np.zeros(0))
        return np.subtract(self._near(scale / 4).kinks, self._near(-scale / 4).kinks) / (scale / 2)

    @cached_property
    def _near(self):
        """The profile with the number changed by s, a function of s: differences take the same s stretch after stretch."""
        return lru_cache(maxsize=8)(lambda s: self.profile_at(self.value + s))

    def replaced(self, value):
        """A copy of the scene with another number in the profile."""
        if not is_number(value):
            raise InputError(f"{self.name}: {value!r} must be a finite number")
        return with_profile(self.model, self.profile, self.profile_at(float(value)))

    def kinks(self, t0, t1):
        """The kinks of the profile that depend on the number."""
        moving = zip(self.profile.kinks, self._speeds.tolist())
        return {kink: speed for kink, speed in moving if speed and t0 < kink < t1}


class PolynomialCoefficients(ProfileNumber):
    """The coefficients of a polynomial, (k,)."""

    def _slopes(self, orders, t):
        """Slopes (k, orders, coefficients) of the polynomial at times t."""
        units = [polynomial(unit) for unit in np.eye(len(self.value))]
        return np.stack([np.stack([over(unit, t, order) for order in orders], axis=1) for unit in units], axis=2)

    def replaced(self, value: ArrayLike):
        """A copy of the scene with as many other coefficients."""
        coefficients = floats(value)
        if coefficients is None or coefficients.shape != self.value.shape:
            raise InputError(f"{self.name}: {value!r} must be {len(self.value)} finite numbers")
        return with_profile(self.model, self.profile, polynomial(coefficients))

    def kinks(self, t0, t1):
        """Empty: a polynomial has no kinks."""
        return {}


def profile_parameters(model, works, slopes):
    """Yield the parameters of all profiles of the parts of a scene and of gravity."""
    for drive, name in named_drives(model).items():
        profile, shared = model.profiles[drive], (works, slopes)
        if any(profile is default for default in DEFAULTS):
            continue
        kind, *numbers = profile.formula or ("",)
        kind = "" if kind == SAMPLES else kind  # they have the scale alone
        if kind == "polynomial" and len(numbers) > 1:
            yield PolynomialCoefficients(f"{name}.coefficients", np.array(numbers), model, drive, polynomial, lambda t: 1.0, *shared)
        elif kind:
            keys = ["value"] if kind == "polynomial" else list(signature(MAKERS[kind]).parameters)
            for i, key in enumerate(keys):
                maker = partial(_with_number, kind, numbers, i)
                yield ProfileNumber(f"{name}.{key}", numbers[i], model, drive, maker, _scale_of(key, dict(zip(keys, numbers))), *shared)
        yield ProfileNumber(f"{name}.scale", 1.0, model, drive, partial(scaled, profile), lambda t: 1.0, *shared, bool(kind))


def _with_number(kind, numbers, i, value):
    """The profile of a kind, such as "ramp", whose number i of those it was made with is another value."""
    return MAKERS[kind](*numbers[:i], value, *numbers[i + 1 :])


def named_drives(model):
    """{number of a profile: its name}: the first part that has it, with the field or axis if the part has several.

    Without profiles of a user's joint that turns two vectors in one row: the row depends on their difference.
    """
    by_part = [(name, _fields(part)) for name, part in model.parts.items()] + [(GRAVITY, zip("xy", model.gravity))]
    named = [(name, _named(name, values)) for name, values in by_part]
    known = {key for _, profiles in named for key in profiles}
    mixed = {name for name, profile in model.named_profiles if name and id(profile) not in known}
    names = {key: called for name, profiles in reversed(named) if name not in mixed for key, called in profiles.items()}
    return {drive: names[id(profile)] for drive, profile in enumerate(model.profiles) if id(profile) in names}


def _fields(part):
    """(name, value) of the fields of a part; of a pair of profiles each axis."""
    for one in fields(part):
        value = getattr(part, one.name)
        pair = isinstance(value, tuple) and len(value) == 2
        yield from zip("xy", value) if pair else [(one.name, value)]


def _named(name, values):
    """{id of a profile: name} of the values of a part."""
    profiles = [(key, value) for key, value in values if isinstance(value, Profile)]
    return {id(value): name if len(profiles) == 1 else f"{name}.{key}" for key, value in profiles}


def _scale_of(key, numbers):
    """Function of times t: the size over which a profile varies with one of its numbers."""
    if key in ("begin", "duration"):
        return lambda t: numbers["duration"]
    if key == "frequency":
        return lambda t: 1.0 / (2 * np.pi * max(1.0, np.abs(t).max(initial=0.0)))
    return lambda t: max(1.0, abs(numbers[key]))
