"""Static equilibrium: `g(t, q, 0) + phi_q^T lam = 0`, `phi(t, q) = 0`, by Newton's method along a growing load."""

import warnings

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import is_flag, is_number, is_whole
from polyida.integrate.start import given
from polyida.integrate.state import StepFailure
from polyida.integrate.statics.loading import Equilibrium, Loading
from polyida.keywords import named_keywords
from polyida.model import Model
from polyida.model.check import require_declared
from polyida.model.guarded import guard

HALVINGS = 10  # of a part of the load, at most, in a row
ATTEMPTS = 200  # at parts, at most, beyond those that were asked for


@named_keywords
def static(
    model: Model,
    t: float = 0.0,
    q0: ArrayLike | None = None,
    steps: int = 1,
    tolerance: float = 1e-10,
    max_iterations: int = 50,
    linear: bool = False,
) -> Equilibrium:
    """The Equilibrium at time t: a State at rest with `stable`; one that is not stable comes with a warning.

    The load grows in `steps` equal parts: at a factor s of it `g(q) + phi_q^T lam = (1 - s) g(0)`, g(0) being the load at q = 0. Where
    Newton's method fails a part is halved, and grows again after two that succeeded; the summary says so.
    Converged where |dq| <= tolerance max(1, |q|) (largest entries).
    linear: for small displacements, `K q + B^T lam = -g`, `phi + B q = 0`, all of q = 0 and lam = 0: one factor, no iterations, and what
    linear elasticity says; q0, steps, tolerance and max_iterations have no part in it. Raises InputError for a wrong setting and for redundant
    constraints, StepFailure where a part of 1/1024 fails or the structure can move freely. Beyond the greatest load that a structure
    bears go `pi.equilibrium_path`.
    """
    model = guard(model, "static")
    loading = whole_load("static", model, t, tolerance, max_iterations)
    if not is_whole(steps):
        raise InputError(f"static: steps = {steps!r} must be a whole number of at least 1")
    if not is_flag(linear):
        raise InputError(f"static: linear = {linear!r} must be True or False")
    q = given(model, "q0", q0)
    require_declared(model, loading.t, q, np.zeros(model.n))
    if linear:
        return loading.small()
    found = _climb(loading, q, steps)
    if found.stable is False:
        warnings.warn(f"static: {found.summary()}; look for another from a disturbed q0", stacklevel=2)
    return found


def whole_load(part, model, t, tolerance, max_iterations):
    """The Loading from no load, factor 0, to all of the model's, factor 1. Raises InputError, in the name of `part`, for wrong settings."""
    if not is_whole(max_iterations):
        raise InputError(f"{part}: max_iterations = {max_iterations!r} must be a whole number of at least 1")
    if not is_number(t):
        raise InputError(f"{part}: t = {t!r} must be a finite time in s")
    if not (is_number(tolerance) and 0 < tolerance < 1):
        raise InputError(f"{part}: tolerance = {tolerance!r} must be between 0 and 1")
    load = model.force(float(t), np.zeros(model.n), np.zeros(model.n))
    load = np.where(np.isfinite(load), load, 0.0)  # a model that is singular at q = 0 has all of its load on at once
    return Loading(model, float(t), load, -load, tolerance, max_iterations)


def _climb(loading, q, steps):
    """The Equilibrium at factor 1, from q, in parts of 1/steps or less."""
    factor, part, lam, system = 0.0, 1.0 / steps, None, None
    parts = halved = in_a_row = 0
    while factor < 1.0:
        target = 1.0 if factor + part > 1.0 - 1e-9 else factor + part
        try:
            guess = loading.multipliers(q, target) if lam is None else lam
            *now, system = loading.solve(q, guess, target)
            loading.require_accepted(now[0])
        except StepFailure as failure:
            if part * steps < 0.5**HALVINGS * 1.5 or parts + halved > steps + ATTEMPTS:
                raise _at(failure, factor) from None
            part, halved, in_a_row = part / 2, halved + 1, 0
            continue
        factor, parts, (q, lam) = target, parts + 1, now
        part, in_a_row = (min(2 * part, 1.0 / steps), 0) if in_a_row else (part, 1)
    return loading.found(q, lam, system.solve, parts=parts, halved=halved)


def _at(failure, factor):
    """The failure, with the part of the load that was borne."""
    if not factor:
        return failure
    hint = f"{failure.reason}; {factor:.6g} of the load is borne: if that is the most, pi.equilibrium_path goes beyond"
    return StepFailure(failure.status, hint, failure.t, **failure.seen)
