"""Checks of a model before a run: its `needs`, derivatives of phi, and energies whose slopes are forces; `check_derivatives`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.linear.lu import dense
from polyida.model import Model, differences
from polyida.model.functions import writes
from polyida.model.guarded import SAME, guard, require_functions, require_written
from polyida.registry import is_built_in
from polyida.validation import floats, is_number, is_whole, named_keywords

REACHES = (0.1, 1e-3, 1e-6, 0.0)  # of the coordinates' size: distance of a random state from the start, the first for which phi is finite
SCALES = (1.0, 1e-2, 1e-4)  # of a difference's step: if two of them agree, the difference is known
AGREES = 1e-5  # of its size: accepted error of a derivative
DOUBT = 10.0  # times the disagreement of differences
DIFFERENCE_ROUND_OFF = 64 * np.finfo(float).eps  # round-off of a difference times its step, over the size of the function
RAISED = Exception, SystemExit, GeneratorExit  # what functions of users may raise at random places
CLOSE = 2e-5  # s, step of differences of profiles
RATE = 1e-3  # accepted relative error of the derivatives of profiles
MOMENTS = 8  # times at which phi is evaluated
JACOBIAN_ROUND_OFF = 4 * np.finfo(float).eps / differences.FIRST_ORDER_STEP  # of `differences.jacobian`, over the size of its function
TRIES = 8  # random states until forces are finite
ONE_SIDED = 8  # factor of the round-off of a difference beside a kink
FINER = 1.0 / 8.0  # of the steps of differences, which are repeated with it: beside a kink the results differ
VELOCITY_ROWS = "; a velocity constraint that has no phi is written as psi(t, q, v), with the number p of its rows"


class Energy(NamedTuple):
    """An energy of a model, and the forces that must be minus its slope."""

    part: Any  # the OwnForce of a scene, or the model
    energy: Callable  # function x -> J
    forces: Callable  # function x -> minus the slope that the energy must have, of the shape of x; None where it need not have one
    x: NDArray  # places of the part at q, or q itself
    sizes: Any  # typical sizes of x, a number or an array


def energies(model, t, q):
    """Yield the Energy of each body and force element of a scene, or of a user's model, at (t, q)."""
    if not model.is_scene:

        def conservative(q):  # a model that has powers, or time in its force, need not have its force at rest as slope of its potential
            """Minus the force at v = 0, without states, (n,); None if it varies in time, and for models with powers or no potential."""
            if writes(model, "powers") or model.potential(q) is None:
                return None
            here, later = (model.force(time, q, np.zeros(model.n)) for time in (t, t + differences.LATER))
            return -model.without_states(here) if np.array_equal(here, later) else None

        yield Energy(model, model.potential, conservative, q, _size(q))
        return
    for own in model.own_forces:
        yield Energy(own, own.energy, partial(own.conservative, t), own.places(q), own.sizes)


def require_energies(model, t, q, strain_only=False):
    """Raise InputError unless the forces at v = 0 of users' parts and models are minus the slope of their energies.

    Compared are bodies (with strain_only bodies alone), force elements and models that are conservative, at two random places near q (n,).
    """
    random = np.random.default_rng(0)
    for energy in energies(model, t, q):
        part = energy.part
        if model.is_scene and (strain_only and not part.strain or is_built_in(type(part.element))):
            continue
        if not (wrong := _wrong_slope(energy, random)):
            continue
        if not model.is_scene:
            advice = "correct it, or, if forces do more than that, give powers(t, q, v, lam)"
            raise InputError(f"{model.name}.potential(q) must have force(t, q, 0) as its slope: {wrong}; {advice}")
        what = "elastic(z) as its gradient" if part.strain else "minus the forces at v = 0 as its gradient"
        advice = "correct one of them" + ("" if part.strain else "; an element that works on what does not move says `works = True`")
        raise InputError(f"{part.name}: its energy must have {what}: {wrong}; {advice}")


def _wrong_slope(energy, random):
    """The slope of an Energy near its x along a direction by forces and by differences, in words; empty if they agree or are unknown."""
    x, sizes = energy.x, energy.sizes
    for reach in (0.3, 0.03):  # a large and a small distance from x: far away forces may not exist
        place = x + reach * sizes * random.standard_normal(x.shape)
        direction = sizes * random.standard_normal(x.shape)
        with suppress(*RAISED), np.errstate(all="ignore"):
            force = energy.forces(place)
            if force is None:
                continue
            size = np.abs(force * direction).sum()
            written_slope = np.array([-np.vdot(force, direction)])

            def energy_along(s, place=place, direction=direction):
                """The energy at a place along the direction, (1,)."""
                return np.array([energy.energy(place + s * direction)])

            compared = Compared("energy", "its slope", lambda slope=written_slope: slope, energy_along)
            wrong = _wrong(compared, lambda size=size: np.array([size]))
            if wrong:
                return wrong.replace("row 0", "along a direction it")
    return ""


def require_declared(model, t, q, v, t_end=None):
    """Raise InputError if a value at (t, q, v) is wrong or not finite, or if `needs` or a derivative of phi that the model writes is wrong.

    Needs and derivatives are compared at two random states near q and v (n,), at times between t and t_end. Values that are not finite
    there, exceptions, and derivatives whose differences with different steps disagree, as beside a kink, are ignored. Of velocity rows
    psi = phi_rate it compares the slope in v with phi_q = W, and phi_bias.
    """
    require_functions(model, t, q, v)
    if model.is_scene:
        require_energies(model, t, q, strain_only=True)
        return
    random = np.random.default_rng(0)
    with np.errstate(all="ignore"):
        for first in range(2):
            state = _near(model, t, t if t_end is None else t_end, q, v, random, REACHES[first:])
            if state is not None:
                _require_needs(model, *state, random)
                _require_derivatives(model, *state, random)


def require_profiles(model, t, t_end):
    """Raise InputError if a user's function that drives a joint has another rate at t, or at a random time before t_end, than its difference.

    At t the difference looks ahead: what the function was before is no part of the run.
    """
    for k in sorted({*model.motor_profiles, *model.path_profiles}):
        name, profile = model.named_profiles[k]
        if profile.formula:
            continue
        times = t + (t_end - t) * np.array([0.0, *np.random.default_rng(0).random(3)])
        largest = max(abs(profile.value(at)) for at in times)
        for function, rate, what, noise in ((profile.value, profile.d1, "d1", 1e-6), (profile.d1, profile.d2, "d2", 1e-3)):
            bounds = [(max(low, t - at), high) for at in times for low, high in [differences.around(profile.kinks, at)]]
            exact = [differences.within(lambda s, at=at: function(at + s), bound, CLOSE) for at, bound in zip(times, bounds)]  # noqa: B023
            found = [rate(differences.beside(at, 1.0) if low == 0.0 else at) for at, (low, _) in zip(times, bounds)]
            wrong = np.abs(np.subtract(found, exact))
            allowed = RATE * np.abs(exact).max() + noise * largest
            if (worst := int(wrong.argmax())) == 0 and wrong[0] > allowed:
                raise InputError(
                    f"{name}: its profile has the derivative {what} = {found[0]:.6g} at t = {t:.6g} s, where the run begins, but just after it "
                    f"changes at {exact[0]:.6g}: give kinks=[{t:.6g}], the time at which it is not smooth, or correct {what}"
                )
            if wrong[worst] > allowed:
                raise InputError(
                    f"{name}: its profile has the derivative {what} = {found[worst]:.6g} at t = {times[worst]:.6g} s, but it changes at "
                    f"{exact[worst]:.6g}: correct {what}, or leave it out to have it made by differences"
                )


def _near(model, t, t_end, q, v, random, reaches):
    """(times, q, v) near a state at which the model's functions are finite, or None."""
    times = t + (t_end - t) * np.array([*(0.2 + 0.6 * random.random(MOMENTS)), 0.0, 1.0])
    drawn = [random.standard_normal(model.n) for _ in range(2)]
    for reach in reaches:
        with suppress(*RAISED):
            sizes = _size(q), _size(v, _size(q))
            at, speed = (x + reach * size * d for x, size, d in zip((q, v), sizes, drawn))
            values = [model.mass(at).sum(), model.force(times[0], at, speed)]
            values += [model.phi(times[0], at), model.phi_q(times[0], at).sum()] if model.m else []
            if all(np.isfinite(x).all() for x in values):
                return times, at, speed
    return None


def _size(x, otherwise=1.0):
    """Largest absolute entry of x; `otherwise` if it is zero or x is empty."""
    return float(np.abs(x).max(initial=0.0)) or otherwise


class Promise(NamedTuple):
    """What a model promises by one of its `needs` being False: calls of a function have equal results."""

    need: str  # name of the attribute of Needs
    function: str
    how: str  # how the function breaks the promise, in words
    calls: list  # two or more functions without arguments whose results must be equal


def _require_needs(model, times, q, v, random):
    """Raise InputError if one of `needs` is False and should be True."""
    t = times[0]
    move = 1e-3 * _size(q) * random.standard_normal(model.n)
    other_velocity = _size(v) * random.standard_normal(model.n)
    masses = [lambda: model.written_mass(q), lambda: model.written_mass(q + move)]
    forces = [lambda: model.force(t, q, v), lambda: model.force(t, q, other_velocity)]
    promises = [Promise("mass_varies", "mass", "changes with q", masses), Promise("velocity_forces", "force", "changes with v", forces)]
    if model.m:
        positions = [lambda at=at: model.phi(at, q) for at in times]
        jacobians = [lambda: model.phi_q(t, q), lambda: model.phi_q(t, q + move)]
        promises.append(Promise("driven", "phi", "changes with t", positions))
        promises.append(Promise("phi_q_varies", "phi_q", "changes with q", jacobians))
    if model.velocity_rows.size:

        def psi_at_zero_velocity():
            """w(t, q) of psi = W v + w."""
            return model.phi_t(t, q)[model.velocity_rows]

        zeros = np.zeros(model.velocity_rows.size)
        promises.append(Promise("driven", "psi", "is not zero at v = 0", [lambda: zeros, psi_at_zero_velocity]))
    needs = model.needs
    for need, function, how, calls in promises:
        if not getattr(needs, need) and (change := _change(calls)) is not None:
            raise InputError(
                f"{model.name}.{function} {how}, an entry by {change:.3g}, though its needs promise {need}=False: "
                f"its needs must say {need}=True, or {function} must not change"
            )


def _change(calls):
    """The largest change of an entry from that of the first call, None if it is round-off."""
    values = []
    for call in calls:
        with suppress(*RAISED):
            values.append(call())
    finite = [value for value in values if np.isfinite(_largest(value))]
    change = max((_largest(value - finite[0]) for value in finite[1:]), default=0.0)
    return float(change) if change > SAME * max(map(_largest, finite), default=0.0) else None


def _largest(array):
    """The largest absolute entry, of a sparse matrix too, which stays sparse."""
    return abs(array).max() if 0 not in array.shape else 0.0


@dataclass(frozen=True)
class Compared:
    """A derivative that a model writes: `written()` against d^order/ds^order function(s) at s = 0, (rows,) each."""

    name: str  # of the function
    meaning: str  # of the derivative, in words
    written: Callable
    function: Callable
    scale: float = 1.0  # of s, over which the function varies
    bounds: tuple = differences.EVERYWHERE  # range of s in which the function is smooth
    order: int = 1


def _require_derivatives(model, times, q, v, random):
    """Raise InputError for a wrong derivative of phi that is written."""
    if not model.m:
        return
    t = times[0]
    direction = _size(q) * random.standard_normal(model.n)

    def size():
        """Size of what phi is the sum of, (m,), whose round-off it has."""
        return abs(model.phi_q(t, q)) @ (np.abs(q) + np.abs(v)) + np.abs(model.phi_t(t, q) * t)

    velocity_rows = model.velocity_rows
    holonomic = np.setdiff1d(np.arange(model.m), velocity_rows)
    for one in _compared_of_phi(model, times, q, v, direction) if holonomic.size else ():
        if writes(model, one.name) and (wrong := _wrong(one, size, holonomic)):
            advice = VELOCITY_ROWS if one.name in ("phi_rate", "phi_bias") else ""
            raise InputError(f"{model.name}.{one.name} is not {one.meaning}: {wrong}, at t = {t:.6g} s; correct it{advice}")
    if (
        velocity_rows.size
        and writes(model, "phi_q")
        and (wrong := _wrong(_compared_of_psi(model, t, q, v, direction), size, velocity_rows))
    ):
        raise InputError(f"{model.name}.psi must be linear in v, with psi_v, if it is written, as its slope: {wrong}, at t = {t:.6g} s")


def _compared_of_phi(model, times, q, v, direction):
    """[Compared] of the derivatives of phi at the first time and (q, v); those in q along a direction (n,)."""
    t = times[0]
    first, last = times.min() - t, times.max() - t
    duration = last - first or 1.0
    travel_time = min(duration, _size(q) / _size(v))
    smooth = model._smooth(t)
    bounds = smooth if first == last else (max(smooth[0], first), min(smooth[1], last))

    def moving(s):
        """Phi after the time s at constant v."""
        return model.phi(t + s, q + s * v)

    return [
        Compared("phi_rate", "d phi/dt = phi_q v + phi_t", lambda: model.phi_rate(t, q, v), moving, travel_time, bounds),
        Compared("phi_bias", "d2 phi/dt2 at constant v", lambda: model.phi_bias(t, q, v), moving, travel_time, bounds, order=2),
        Compared("phi_q", "the derivative of phi in q", lambda: model.phi_q(t, q) @ direction, lambda s: model.phi(t, q + s * direction)),
        Compared("phi_t", "the derivative of phi in t", lambda: model.phi_t(t, q), lambda s: model.phi(t + s, q), duration, bounds),
    ]


def _compared_of_psi(model, t, q, v, direction):
    """The Compared of the slope of psi in v, along a direction (n,)."""
    written = lambda: model.phi_q(t, q) @ direction  # noqa: E731
    return Compared("phi_q", "the slope of psi in v", written, lambda s: model.phi_rate(t, q, v + s * direction))


def _wrong(compared, size, rows=slice(None)):
    """A derivative that is written and differences, in words; empty if they agree, or if the differences are unknown.

    size(): sizes of what the function is the sum of. rows: the rows that are compared.
    """
    with suppress(*RAISED):
        written = np.asarray(compared.written()[rows])
        derivative, doubt = _derivative_and_doubt(compared, size, rows)
        off = np.abs(written - derivative) - DOUBT * doubt - AGREES * np.maximum(np.abs(written), np.abs(derivative))
        worst = int(np.argmax(off))
        if np.isfinite(off).all() and off[worst] > 0.0:
            return f"row {worst} is {written[worst]:.6g} and by differences {derivative[worst]:.6g}"
    return ""


def _derivative_and_doubt(compared, size, rows):
    """Return (derivative, uncertainty), (rows,) each, from differences with the steps of SCALES, longest first.

    Uncertainty of step k: the largest disagreement of the steps from k on, less their round-off, plus the round-off of step k. The step with
    the least sum of uncertainties is taken.
    """
    order = compared.order

    def function(s):
        """The compared rows of the function."""
        return compared.function(s)[rows]

    steps = [differences.FIRST_ORDER_STEP * compared.scale * part for part in SCALES]
    derivatives = [differences.within(function, compared.bounds, step, order) for step in steps]
    round_off = [DIFFERENCE_ROUND_OFF * (np.abs(np.asarray(function(0.0))) + size()[rows]) / step**order for step in steps]
    disagreements = [
        np.maximum(np.abs(longer - shorter) - blur, 0.0) for longer, shorter, blur in zip(derivatives, derivatives[1:], round_off[1:])
    ]
    doubts = [np.max(disagreements[k:], axis=0) + round_off[k] for k in range(len(disagreements))]
    chosen = int(np.argmin([doubt.sum() if np.isfinite(doubt).all() else np.inf for doubt in doubts]))
    return derivatives[chosen], doubts[chosen]


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
    """Compare every derivative of a model with differences.

    The round-off of differences is subtracted: if forces are large, as of plates bent at random, errors of small slopes are less visible.

    Parameters
    ----------
    model : Model
    t : float, s
    q, v, a : (n,) float, optional
        By default random, of size 1, with finite forces.
    lam : (m,) float, optional
        By default random, of size 1.
    seed : int
        Of the random numbers.

    Returns
    -------
    dict
        {name: largest deviation over the largest entry}; about 1e-9 for a correct derivative, about 1 for a wrong one.
    """
    model = guard(model, "check_derivatives")
    if not (is_number(t) and is_whole(seed, 0)):
        raise InputError(f"check_derivatives: t = {t!r} must be a finite time in s, seed = {seed!r} a whole number")
    require_written(model)
    random = np.random.default_rng(seed)
    q, v, a = _drawn(
        model,
        t,
        random,
        [
            None if x is None else _vector(name, x, model.n - len(model.hidden), len(model.hidden))
            for name, x in (("q", q), ("v", v), ("a", a))
        ],
    )
    lam = random.standard_normal(model.m) if lam is None else _vector("lam", lam, model.m)
    pairs = _of_forces(model, t, q, v, a, lam) | _of_phi(model, t, q, v, lam) | _of_parameters(model, t, q, v, a, lam)
    force = JACOBIAN_ROUND_OFF * np.abs(Model.residual(model, t, q, v, a, lam)).max()
    blur = {"force_v": force, "tangent, v": force, "phi_t": ONE_SIDED * JACOBIAN_ROUND_OFF * np.abs(model.phi(t, q)).max(initial=0.0)}
    for name in model.parameters:
        blur[f"residual_p {name}"] = force / (np.abs(model.parameter(name)).min() or 1.0)
    for name, slope, difference, doubt in _of_energies(model, t, q):
        pairs[name], blur[name] = (slope, difference), doubt
    errors = {}
    for name, (exact, difference) in pairs.items():
        exact = dense(exact)
        size = max(np.abs(exact).max(initial=0), np.abs(difference).max(initial=0))
        off = max(0.0, np.abs(exact - difference).max(initial=0) - blur.get(name, 0.0))
        errors[name] = float(off / size) if size > 1e-12 else 0.0
    return errors


def _of_forces(model, t, q, v, a, lam):
    """{name: (written, by differences)} of the derivatives of forces."""
    n, residual = model.n, partial(Model.residual, model)
    return {
        "force_q": (model.force_q(t, q, v), differences.jacobian(lambda x: model.force(t, x, v), q, n)),
        "force_v": (model.force_v(t, q, v), differences.jacobian(lambda x: model.force(t, q, x), v, n)),
        "mass_a_q": (model.mass_a_q(q, a), differences.jacobian(lambda x: model.mass(x) @ a, q, n)),
        "tangent": (model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0), differences.jacobian(lambda x: residual(t, x, v, a, lam), q, n)),
        "tangent, v": (model.tangent(t, q, v, a, lam, 0.0, 1.0, 0.0), differences.jacobian(lambda x: residual(t, q, x, a, lam), v, n)),
    }


def _of_phi(model, t, q, v, lam):
    """{name: (written, by differences)} of the derivatives of phi; in velocity rows those of psi."""
    n, m = model.n, model.m
    if not m:
        return {}
    rows_q = differences.jacobian(lambda x: model.phi(t, x), q, m)
    changes = differences.along(lambda s: model.phi(t + s, q), bounds=model._smooth(t))
    for row in model.velocity_rows:
        rows_q[row] = differences.jacobian(lambda x: model.phi_rate(t, q, x), v, m)[row]
        changes[row] = model.phi_rate(t, q, np.zeros(n))[row]
    return {
        "phi_q": (model.phi_q(t, q), rows_q),
        "reaction_q": (model.reaction_q(t, q, lam), differences.jacobian(lambda x: model.phi_q(t, x).T @ lam, q, n)),
        "phi_t": (model.phi_t(t, q), changes),
        "phi_bias": (model.phi_bias(t, q, v), Model.phi_bias(model, t, q, v)),
    }


def _of_parameters(model, t, q, v, a, lam):
    """{name: (written, by differences)} of residual_p and phi_p of each parameter, if the class gives them."""
    slopes = {"residual_p": (model.residual_p, Model.residual_p, (t, q, v, a, lam)), "phi_p": (model.phi_p, Model.phi_p, (t, q))}
    written = {function: entry for function, entry in slopes.items() if writes(model, function)}
    return {
        f"{function} {name}": (own(name, *at), default(model, name, *at))
        for name in model.parameters
        for function, (own, default, at) in written.items()
    }


def _of_energies(model, t, q):
    """Yield (name, slope by differences, minus the forces, round-off of the slope) of the energies of a scene or a user's model."""
    for part, energy, forces, x, sizes in energies(model, t, q):
        force, reach = None, np.broadcast_to(sizes, x.shape)
        with suppress(*RAISED):  # as at times at which forces are not known
            force = forces(x)
        if force is None:
            continue
        force = (reach * force).ravel()

        def moved(s, energy=energy, x=x, reach=reach):
            """The energy, (1,), after a move of s sizes."""
            return np.array([energy(x + reach * s.reshape(x.shape))])

        slope, doubt = _slope(moved, force.size)
        doubt = JACOBIAN_ROUND_OFF * max(np.abs(moved(np.zeros(force.size))).max(), np.abs(force).max()) + doubt
        yield f"energy of {part.name}" if model.is_scene else "potential", slope, -force, doubt


def _slope(function, size):
    """(slope at 0 of a function of (size,) by differences, (size,), its uncertainty from differences with finer steps)."""

    def slope_with(part):
        """The slope by differences whose steps are this part of the usual ones."""
        return differences.jacobian(lambda s: function(part * s), np.zeros(size), 1)[0] / part

    slope, finer = slope_with(1.0), slope_with(FINER)
    return slope, DOUBT * np.abs(slope - finer).max()


def _drawn(model, t, random, state):
    """q, v and a, random if None, with finite forces and energies."""
    for _ in range(TRIES):
        q, v, a = (random.standard_normal(model.n) if x is None else x for x in state)
        with np.errstate(all="ignore"):
            sizes = model.force(t, q, v), *(one.energy(one.x) or 0.0 for one in energies(model, t, q))
        if all(np.isfinite(size).all() for size in sizes):
            break
    return q, v, a


def _vector(name, value, size, behind=0):
    """A given vector of a size, with zeros for the coordinates of states behind it. Raises InputError for anything else."""
    array = floats(value)
    if array is None or array.shape not in ((size,), (size + behind,)):
        raise InputError(f"check_derivatives: {name} = {value!r} must be {size} finite numbers")
    return np.append(array, np.zeros(size + behind - len(array)))
