"""`check_derivatives`: the derivatives that a model writes, compared with differences of what they are derivatives of."""

from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import floats, is_number, is_whole
from polyida.keywords import named_keywords
from polyida.linear.lu import dense
from polyida.model import Model, differences
from polyida.model.check import DOUBT, RAISED, energies
from polyida.model.guarded import guard, require_constraints, writes

ROUND_OFF = 4 * np.finfo(float).eps / differences.FIRST_ORDER_STEP  # of a difference, over the size of what it is taken of
TRIES = 8  # states that are drawn until forces are finite
ONE_SIDED = 8  # by how much more of it a difference beside a kink has
FINER = 1.0 / 8.0  # of the steps of differences, at which they are taken again: beside a kink they are others


@named_keywords
def check_derivatives(
    model: Model,
    t: float = 0.0,
    q: ArrayLike | None = None,
    v: ArrayLike | None = None,
    a: ArrayLike | None = None,
    lam: ArrayLike | None = None,
    seed: int = 0,
) -> dict[str, float]:
    """Compare every derivative of a model with differences of what it is the derivative of.

    States that are not given are drawn at random (q of size 1, v of size 1), where forces are finite. Returns {name: relative error}, the
    largest deviation over the largest entry; about 1e-9 where the derivative is right, about 1 where it is wrong. What round-off of the
    force leaves of its differences is none: where forces are large, as of plates bent at random, small slopes are seen less sharply.
    """
    model = guard(model, "check_derivatives")
    if not (is_number(t) and is_whole(seed, 0)):
        raise InputError(f"check_derivatives: t = {t!r} must be a finite time in s, seed = {seed!r} a whole number")
    require_constraints(model)
    random = np.random.default_rng(seed)
    q, v, a = _drawn(model, t, random, [None if x is None else _vector(name, x, model.n) for name, x in (("q", q), ("v", v), ("a", a))])
    lam = random.standard_normal(model.m) if lam is None else _vector("lam", lam, model.m)
    n, m = model.n, model.m
    force = ROUND_OFF * np.abs(Model.residual(model, t, q, v, a, lam)).max()
    blur = {"force_v": force, "tangent, v": force, "phi_t": ONE_SIDED * ROUND_OFF * np.abs(model.phi(t, q)).max(initial=0.0)}
    pairs = {
        "force_q": (model.force_q(t, q, v), differences.jacobian(lambda x: model.force(t, x, v), q, n)),
        "force_v": (model.force_v(t, q, v), differences.jacobian(lambda x: model.force(t, q, x), v, n)),
        "mass_a_q": (model.mass_a_q(q, a), differences.jacobian(lambda x: model.mass(x) @ a, q, n)),
        "tangent": (
            model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0),
            differences.jacobian(lambda x: Model.residual(model, t, x, v, a, lam), q, n),
        ),
        "tangent, v": (
            model.tangent(t, q, v, a, lam, 0.0, 1.0, 0.0),
            differences.jacobian(lambda x: Model.residual(model, t, q, x, a, lam), v, n),
        ),
    }
    if m:
        pairs |= {
            "phi_q": (model.phi_q(t, q), differences.jacobian(lambda x: model.phi(t, x), q, m)),
            "reaction_q": (model.reaction_q(t, q, lam), differences.jacobian(lambda x: model.phi_q(t, x).T @ lam, q, n)),
            "phi_t": (model.phi_t(t, q), differences.along(lambda s: model.phi(t + s, q), room=model._smooth(t))),
            "phi_bias": (model.phi_bias(t, q, v), Model.phi_bias(model, t, q, v)),
        }
    for name in model.parameters:
        least = np.abs(model.parameter(name)).min() or 1.0
        blur[f"residual_p {name}"] = force / least
        state = t, q, v, a, lam
        slopes: dict[str, tuple] = {
            "residual_p": (model.residual_p, Model.residual_p, state),
            "phi_p": (model.phi_p, Model.phi_p, state[:2]),
        }
        written = {key: entry for key, entry in slopes.items() if writes(model.user, key)}
        pairs |= {f"{key} {name}": (own(name, *at), plain(model, name, *at)) for key, (own, plain, at) in written.items()}
    for part, energy, forces, x, sizes in energies(model, t, q):
        force, reach = _said(lambda forces=forces, x=x: forces(x)), np.broadcast_to(sizes, x.shape)
        if force is None:
            continue
        name, force = f"energy of {part.name}" if model.is_scene else "potential", (reach * force).ravel()
        moved = lambda s, energy=energy, x=x, reach=reach: np.array([energy(x + reach * s.reshape(x.shape))])  # noqa: E731
        slope, doubt = _slope(moved, force.size)
        blur[name] = ROUND_OFF * max(np.abs(moved(np.zeros(force.size))).max(), np.abs(force).max()) + doubt
        pairs[name] = slope, -force
    return {name: _deviation(*pair, blur.get(name, 0.0)) for name, pair in pairs.items()}


def _slope(function, size):
    """(slope at 0 of a function of (size,) by differences, (size,), how far it may be off: beside a kink, finer ones are others)."""
    one, finer = (differences.jacobian(lambda s, part=part: function(part * s), np.zeros(size), 1)[0] / part for part in (1.0, FINER))
    return one, DOUBT * np.abs(one - finer).max()


def _said(call):
    """What a call gives; None where it raises, as at times at which forces are not known."""
    with suppress(*RAISED):
        return call()
    return None


def _drawn(model, t, random, given):
    """q, v and a, those that are None drawn at random until forces are finite."""
    for _ in range(TRIES):
        q, v, a = (random.standard_normal(model.n) if x is None else x for x in given)
        if np.isfinite(model.force(t, q, v)).all():
            break
    return q, v, a


def _deviation(exact, difference, blur):
    exact = dense(exact)
    size = max(np.abs(exact).max(initial=0), np.abs(difference).max(initial=0))
    return float(max(0.0, np.abs(exact - difference).max(initial=0) - blur) / size) if size > 1e-12 else 0.0


def _vector(name, value, size):
    array = floats(value)
    if array is None or array.shape != (size,):
        raise InputError(f"check_derivatives: {name} = {value!r} must be {size} finite numbers")
    return array
