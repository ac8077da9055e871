"""The error of the time steps of a quantity J from runs with other steps, and whether these runs earn trust.

One other run gives a number for any J, also where steps do not resolve the motion: of 790 such numbers 145 were wrong by more than a factor
of two. Two other runs give two differences. With constant steps of order p <= 2 these are of runs with 2 h, h and h / 2, whose ratio must
be about 2^p. Methods of higher order take long steps, and 2 h may be too long; with a tolerance errors fall unevenly. There both other runs
are finer, and the last one must change the error by little.
"""

from copy import copy
from dataclasses import is_dataclass, replace
from typing import NamedTuple

import numpy as np

from polyida.errors import InputError
from polyida.integrate.state import declared
from polyida.model.guarded import guard, unguarded
from polyida.run.solve import solve
from polyida.validation import is_whole

DEFAULT_RTOL = 1e-5  # of a run whose tolerance is unknown
TENTH = 0.1  # of the tolerances, from one run to the next
LOW = 2  # order up to which a run with 2 h is made
BAND = 0.5, 2.0  # of 2^p: ratios of two differences that earn trust
SHARE = 0.5  # of the estimate: change by the finest run that earns trust


class Again(NamedTuple):
    """error: what must be added to J; reasons: why it is not trusted, empty if it is."""

    error: float
    reasons: tuple[str, ...]


def time_again(run, objective, value):
    """The Again of a run whose J is `value`. Raises InputError for an unknown order, and if the run with the next finer steps fails."""
    settings, one = run.integrator, declared(run.integrator)
    if one.fixed_step() and is_whole(one.order):
        order, names = int(one.order), ("h / 2", "2 h" if one.order <= LOW else "h / 4")
        changes = [{"h": settings.h * factor} for factor in (0.5, 2.0 if one.order <= LOW else 0.25)]
    elif one.fixed_step() or not hasattr(settings, "rtol"):
        name = type(settings).__name__
        raise InputError(f"error_of: the order of {name} is not known: the class needs the attribute `order`, a whole number of at least 1")
    else:
        order, names = 0, ("1/10 of the tolerances", "1/100 of the tolerances")
        changes = [_tolerances(run, factor) for factor in (TENTH, TENTH**2)]
    nearer = solved_again(run, run.model, changed(settings, **changes[0]), objective)
    low = 0 < order <= LOW
    error = (nearer - value) * (2.0**order / (2.0**order - 1.0) if low else 1.0)
    try:
        third = solved_again(run, run.model, changed(settings, **changes[1]), objective)
    except InputError as failure:
        return Again(error, (f"there is no run with {names[1]} to compare with: {str(failure).removeprefix('error_of: ')}",))
    return _of_order(value, nearer, third, order, error) if low else _of_finest(value, nearer, third, names)


def _of_order(value, nearer, coarser, order, error):
    """The Again of runs with h, h / 2 and 2 h."""
    far, near = value - coarser, nearer - value
    if far == near == 0.0 or BAND[0] < far / (near or np.nan) / 2.0**order < BAND[1]:
        return Again(error, ())
    ratio = f"{far / near:.2g}" if near else "infinite"
    return Again(error, (f"the differences between runs with 2 h, h and h / 2 have the ratio {ratio}, of order {order} it is {2**order}",))


def _of_finest(value, nearer, finest, names):
    """The Again of runs of which each is finer than the one before."""
    error, change = finest - value, finest - nearer
    if abs(change) <= SHARE * abs(error):
        return Again(error, ())
    part = f"{100 * abs(change / error):.0f} %" if error else "as much as it is"
    return Again(error, (f"the run with {names[1]} differs from that with {names[0]} by {part} of the estimate",))


def _tolerances(run, factor):
    """{setting: value} of an integrator: its rtol or ida_rtol, and its atol if it has one, times a factor."""
    settings = run.integrator
    rtol, atol = settings.rtol or run.state.memory.get("rtol", DEFAULT_RTOL), getattr(settings, "atol", None)
    passed = getattr(settings, "ida_rtol", None)
    finer = {"ida_rtol": factor * passed} if passed else {"rtol": factor * rtol}
    finer |= {} if atol is None else {"atol": factor * np.asarray(atol, float)}
    return {name: float(x) if np.ndim(x) == 0 else tuple(x.tolist()) for name, x in finer.items()}


def changed(settings, **values):
    """An integrator with other settings; that of a user may be a plain class."""
    if is_dataclass(settings):
        return replace(settings, **values)
    other = copy(settings)
    vars(other).update(values)
    return other


def solved_again(run, model, settings, objective, places=None):
    """J of the run solved again. places: (pairs of q, pairs of the other model's q) if that has more coordinates, False to begin in the
    reference configuration.
    Raises InputError if it fails.
    """
    if run.plan.get("output") or run.status == "stopped":
        raise InputError("error_of: again=True needs a run without `output` and `until`")
    model = guard(model)
    q, v = (np.asarray(x[0], float) for x in (run.q, run.v))
    if places:
        q, v = (_placed(x, model.n, *places) for x in (q, v))
    start = {} if places is False else {"q0": q, "v0": v}
    options = {"every": run.plan.get("every", 1), "t0": float(run.t[0]), **start}
    other = solve(unguarded(model), float(run.t[-1]), settings, **options)
    if not other.success:
        raise InputError(f"error_of: the run with {settings!r:.100} failed: {other.message}")
    return float(objective(other))


def _placed(x, n, before, after):
    """q or v of the other model, zero at coordinates that the run does not have."""
    result = np.zeros((n // 2, 2))
    result[after] = x.reshape(-1, 2)[before]
    return result.ravel()
