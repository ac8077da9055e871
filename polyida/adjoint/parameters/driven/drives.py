"""What the values, rates and second derivatives of a scene's profiles are multiplied by in the sum over a Work."""

from dataclasses import replace

import numpy as np

from polyida.adjoint.parameters.driven.times import ORDERS, element_work, over
from polyida.adjoint.parameters.rebuilt import holding_profile
from polyida.assembly.own.forces import OwnForce
from polyida.assembly.rows.increments import drive_table
from polyida.force.force_element import ForceElement, profiles_of
from polyida.given import complex_of_pairs
from polyida.model.differences import along


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
