"""Sums of multipliers by the profiles of a scene and by time.

What the values, rates and second derivatives of profiles are multiplied by in `sum w . r + mu . phi + kappa . rate + nu . bias`, how
profiles change with their numbers, and slopes of the entries of that sum in their own times.
"""

from dataclasses import replace

import numpy as np

from polyida.adjoint.parameters.parameter import holding_profile, total
from polyida.assembly.own.forces import OwnForce
from polyida.assembly.rows.increments import drive_table
from polyida.force.force_element import ForceElement, profiles_of
from polyida.given import complex_of_pairs
from polyida.integrate.kinks import beside
from polyida.model.differences import FIRST_ORDER_STEP, along, around, within
from polyida.profile import REACH, Profile

ORDERS = ("value", "d1", "d2")


def over(profile, t, order=0):
    """Value or derivative of a profile at times t (k,), (k,); the third by differences that stay on one side of its kinks."""
    if order == len(ORDERS):
        step = FIRST_ORDER_STEP * min(1.0, profile.shortest or 1.0)
        return np.array([within(lambda s, at=at: profile.d2(at + s), around(profile.kinks, at), step) for at in t.tolist()])
    return profile.over(t, order)


def slope_over(profile, made, scale, speeds, orders, t):
    """What `made(s)`, which is the profile at s = 0, changes by with s, in value and derivatives of these orders at times t, (k, orders).

    speeds: of its kinks. Differences are taken along times that move as the kinks do, so that none of them crosses one; what that is too
    much is taken back by the derivatives in time.
    """
    moved = np.interp(t, profile.kinks, speeds) if speeds.any() else np.zeros(len(t))
    if moved.any():
        t = np.array([_beside_kink(profile, at) for at in t.tolist()])

    def table(s):
        near = made(s)
        return np.stack([over(near, t + s * moved, order) for order in orders], axis=1)

    result = along(table, scale)
    return result - np.stack([moved * over(profile, t, order + 1) for order in orders], axis=1) if moved.any() else result


def _beside_kink(profile, t):
    """t, or of a kink the time on the side of which the profile has its values there: both move, and round-off would choose the side."""
    if not any(abs(kink - t) <= 8 * np.spacing(max(1.0, abs(t))) for kink in profile.kinks):
        return t
    at = np.array([beside(t, -1), t, beside(t, 1)])
    apart = sum(np.abs(values - values[1]) for values in (over(profile, at, order) for order in range(len(ORDERS))))
    return float(at[0] if apart[0] < apart[2] else at[2])


def kink_speeds(made, scale):
    """By how much the kinks of `made(s)` move with s at s = 0, (kinks,): evenly."""
    return np.subtract(made(scale / 4).kinks, made(-scale / 4).kinks) / (scale / 2)


def at_sides(own, x):
    """What x (k, n) is at the sides of an OwnForce, (k, sides, 2)."""
    return (own.A @ x.T).T.reshape(len(x), -1, 2)


def element_work(own, element, work):
    """`-w . A^T f` of each entry, (k,), of an element on the sides of an OwnForce, which is of one like it."""
    x, v = own.rest + at_sides(own, work.q), at_sides(own, work.v)
    forces = [element.forces(*state) for state in zip(work.t.tolist(), x, v)]
    return -np.einsum("kie,kie->k", at_sides(own, work.w), np.reshape(forces, x.shape))


def drive_works(model, work):
    """(k, profiles, 3): the slopes of each entry of the sum in value, rate and second derivative of every profile of a scene."""
    found = np.zeros((len(work.t), len(model.profiles), 3))
    _add_loads(model, work, found)
    _add_shifts(model, work, found)
    _add_products(model, work, found)
    for name, part in model.parts.items():
        if isinstance(part, ForceElement):
            _add_element(model, name, part, work, found)
    return found


def _add_loads(model, work, found):
    """Forces times a value: `r = ... - value F`."""
    s = model.arrays.plates
    w = work.w.reshape(len(work.t), -1, 2)
    for k, drive in enumerate(s.load_drive):
        of = slice(s.load_ptr[k], s.load_ptr[k + 1])
        found[:, drive, 0] -= np.einsum("kie,ie->k", w[:, s.load_nodes[of]], s.load_values[of])


def _add_shifts(model, work, found):
    """Profiles that are added to rows of phi."""
    s = model.arrays.links
    for row, drive, factor in zip(s.shift_row, s.shift_drive, s.shift_factor):
        for order, given in enumerate((work.mu, work.kappa, work.nu)):
            if given is not None:
                found[:, drive, order] += factor * given[:, row]


def _add_products(model, work, found):
    """Angles that turn a vector: of `R(theta) E . F`, with `across = (R E) x F` and `along = R E . F`, the slopes of value, rate and bias.

    The value's is `across`; the rate's `theta' across + E' . F + E . F'`; the bias' that of `2 E' . F' + theta'' across
    - theta'^2 along + 2 theta' (E' x F + E x F')`. A turn by a right angle makes across of along, and minus along of across.
    """
    s = model.arrays.links
    turned = np.flatnonzero(s.product_drive >= 0)
    if not (len(turned) and len(work.t)):
        return
    angles = drive_table(model, work.t, (work.t[0], work.t[-1]))[:, s.product_drive[turned]]
    turn, speed, second = np.exp(1j * angles[..., 0]), angles[..., 1], angles[..., 2]
    vectors, used = _vectors(s, model.n_points), np.unique(s.point_nodes)
    weights = model.point_weights[:, used].toarray().T
    first, other, rows = s.product_first[turned], s.product_second[turned], s.product_row[turned]

    def moved(x):
        z = complex_of_pairs(x.reshape(len(x), -1, 2)[:, used]) @ weights
        return turn * (vectors[first] @ z.T).T, (vectors[other] @ z.T).T

    rest = complex_of_pairs(s.vector_rest)
    (e, f), (we, wf) = moved(work.q), moved(work.w)
    e, f = e + turn * rest[first], f + rest[other]
    slopes = np.zeros((len(work.t), len(turned), 3))
    slopes[..., 0] = work.lam[:, rows] * (_cross(we, f) + _cross(e, wf))
    if work.mu is not None:
        slopes[..., 0] += work.mu[:, rows] * _cross(e, f)
    if work.kappa is not None or work.nu is not None:
        u, g = moved(work.v)
        mixed = _cross(u, f) + _cross(e, g)
    if work.kappa is not None:
        slopes[..., 0] += work.kappa[:, rows] * (mixed - speed * _dot(e, f))
        slopes[..., 1] += work.kappa[:, rows] * _cross(e, f)
    if work.nu is not None:
        nu, pushed = work.nu[:, rows], _dot(u, f) + _dot(e, g)
        slopes[..., 0] += nu * (2.0 * _cross(u, g) - second * _dot(e, f) - speed**2 * _cross(e, f) - 2.0 * speed * pushed)
        slopes[..., 1] += nu * 2.0 * (mixed - speed * _dot(e, f))
        slopes[..., 2] += nu * _cross(e, f)
    for p, drive in enumerate(s.product_drive[turned]):
        found[:, drive] += slopes[:, p]


def _vectors(s, points):
    """W, (vectors, points), complex, sparse: vectors are `rest + W dz`."""
    from scipy.sparse import csr_array

    return csr_array((s.vector_weights @ (1, 1j), s.vector_points, s.vector_start), (len(s.vector_rest), points))


def _cross(a, b):
    return (a.conj() * b).imag


def _dot(a, b):
    return (a.conj() * b).real


def _add_element(model, name, element, work, found):
    """Profiles of a force element, by differences of its forces, which take their rates too if they are Python."""
    own = OwnForce(name, element, model)
    for drive, profile in enumerate(model.profiles):
        if not any(known is profile for known in profiles_of(element)):
            continue
        for order, function in enumerate(ORDERS[:1] if element.by_numba else ORDERS):
            of_time, size = getattr(profile, function), max(1.0, np.abs(over(profile, work.t, order)).max())

            def pushed(s, profile=profile, function=function, of_time=of_time):
                other = replace(profile, formula=(), **{function: lambda t: of_time(t) + s})
                return element_work(own, holding_profile(element, profile, other), work)

            found[:, drive, order] += along(pushed, size)


SCALE = REACH[1] / FIRST_ORDER_STEP  # s, over which functions of time of one's own vary


def in_time(model, work):
    """The slope of `w . r + mu . phi + kappa . rate + nu . bias` of each entry in its time, its state as it is, (k,).

    Of a scene by its profiles' derivatives; of models and force elements of one's own by differences.
    """
    if not model.is_scene:
        return np.array([_by_differences(model, entry) for entry in _each(work)])
    return _by_profiles(model, work) + sum(
        _of_element(OwnForce(name, part, model), part, work)
        for name, part in model.parts.items()
        if isinstance(part, ForceElement) and not _by_our_law(part)
    )


def _by_profiles(model, work):
    each, result = drive_works(model, work), np.zeros(len(work.t))
    for drive, profile in enumerate(model.profiles):
        for order in range(len(ORDERS)):
            used = np.flatnonzero(each[:, drive, order])
            result[used] += each[used, drive, order] * over(profile, work.t[used], order + 1)
    return result


def _by_our_law(element):
    """Whether time is in its forces by profiles alone."""
    functions = (value for value in vars(element).values() if callable(value) and not isinstance(value, Profile))
    return type(element).__module__.startswith("polyida.") and not any(functions)


def _of_element(own, element, work):
    """Of the time that forces of one's own are given, their profiles late by as much."""

    def later(s):
        held = element
        for profile in profiles_of(element):
            held = holding_profile(held, profile, _late(profile, s))
        return element_work(own, held, work._replace(t=work.t + s))

    return along(later, SCALE)


def _late(profile, s):
    functions = {order: getattr(profile, order) for order in ORDERS}
    return replace(profile, formula=(), **{order: lambda t, f=function: f(t - s) for order, function in functions.items()})


def _by_differences(model, entry):
    room = model._smooth(float(entry.t[0]))
    return float(along(lambda s: total(model, entry._replace(t=entry.t + s)), SCALE, room))


def _each(work):
    return (type(work)(*(x if x is None else x[k : k + 1] for x in work)) for k in range(len(work.t)))
