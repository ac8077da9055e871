"""The end of a motion by the methods of which references are made: each independent of the others, with a tolerance or a step.

Each function returns {part: value at t_end}, parts as in study/ivp.py, or raises RuntimeError if the run fails and TooStiff if it would take
too long. `explicit` is DOP853 on the index-1 equations; the others run integrators of this package. study/refinement.py makes references of
them.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from polyida.environment import one_blas_thread
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import consistent_acceleration, consistent_state, restarted
from polyida.model.guarded import guard
from polyida.run.solve import solve
from polyida.study.ivp import values_of
from polyida.trajectory import Trajectory

LEGS = 32  # parts of an explicit run; without projection between them, angle motors drift by 2e-10 rad in 1 s
MAX_EVALUATIONS = 3e7  # times (coordinates + SMALL_MODEL): limit of an explicit run, about fifteen seconds
SMALL_MODEL = 200  # coordinates: the cost of an evaluation that does not depend on their number
COUNTS_BEFORE_PROJECTION = 2000  # evaluations or steps before the total is estimated


class TooStiff(Exception):
    """A run would take too many steps or evaluations."""


class WorkLimit:
    """Counts steps or evaluations at increasing t and raises TooStiff if the projected total exceeds `limit`."""

    def __init__(self, name, what, limit, t_end, t0=0.0):
        """Begin to count at t0; name and what: the method and the counted things, for the message."""
        self.name = name
        self.what = what
        self.limit = limit
        self.t_end = t_end
        self.t0 = t0
        self.count = 0  # steps or evaluations so far

    def __call__(self, t):
        """Count a step or evaluation at t. Raises TooStiff if the total, projected from the time covered so far, is too large."""
        self.count += 1
        if self.count % COUNTS_BEFORE_PROJECTION == 0 and t > self.t0:
            total = self.count * (self.t_end - self.t0) / (t - self.t0)
            if total > self.limit:
                raise TooStiff(f"{self.name}: it would take {total:.1g} {self.what}, for the motion is stiff")


def explicit(model, t_end, rtol, t0=0.0, q0=None, v0=None, times=None, legs=1, limited=False):
    """[(q, v, a, lam)] just before increasing `times` (default: t_end) by DOP853 on (q, v)' = (v, a), with a from the index-1 equations.

    Integration restarts at the kinks of loads and motors. legs: equal parts of the time, after which q and v are projected onto the
    constraints. limited: raise TooStiff for long runs.
    """
    from scipy.integrate import solve_ivp

    model, end_times, states = guard(model), np.atleast_1d(t_end if times is None else times), []
    state = consistent_state(model, t0, q0, v0)
    n, y, t = model.n, np.concatenate([state.q, state.v]), t0
    projections = np.linspace(t0, end_times[-1], legs + 1)[1:-1]
    count = WorkLimit("DOP853", "evaluations", MAX_EVALUATIONS / (n + SMALL_MODEL) if limited else np.inf, end_times[-1], t0)

    def rate(t, y):
        """(v, a) at (q, v) = y, (2 n,)."""
        count(t)
        return np.concatenate([y[n:], consistent_acceleration(model, t, y[:n], y[n:])[0]])

    with one_blas_thread():
        for end in sorted({*model.kinks(t0, end_times[-1]), *projections, end_times[-1]}):
            # a time at the start belongs to the first interval
            within = end_times[(end_times > t) & (end_times <= end) | (end_times == t0) & (t == t0)]
            at, options = np.union1d(within, [end]), {"rtol": rtol, "atol": rtol * 1e-3, "first_step": min(1e-6, end - t)}
            run = solve_ivp(rate, (t, end), y, method="DOP853", t_eval=at, **options)
            if not run.success:
                raise RuntimeError(f"DOP853: {run.message}")
            known = dict(zip(at, run.y.T))
            states += [
                (known[s][:n], known[s][n:], *consistent_acceleration(model, np.nextafter(s, t0), known[s][:n], known[s][n:]))
                for s in within
            ]
            y, t = run.y[:, -1], end
            if end in projections:
                state = restarted(model, SimpleNamespace(t=end, q=y[:n], v=y[n:]))
                y = np.concatenate([state.q, state.v])
    return states


def by_explicit(model, t_end, rtol, q0=None, v0=None, limited=False, quantity=None):
    """{part: value} at t_end by `explicit`, or those of a Quantity."""
    times = quantity.times if quantity else None
    states = explicit(model, t_end, rtol, q0=q0, v0=v0, times=times, legs=LEGS, limited=limited)
    if quantity:
        return quantity.of_run(Trajectory(model, "DOP853", times, *map(np.array, zip(*states))))
    q, v, _, lam = states[0]
    return values_of(guard(model), q, v, lam)


def by_radau(model, t_end, rtol, q0=None, v0=None, quantity=None):
    """{part: value} at t_end by Radau IIA of order 5 with error control. Raises RuntimeError if the run fails."""
    return end_state(model, t_end, RadauIIA(rtol=rtol), q0, v0, quantity=quantity)


def extrapolated(model, t_end, method, h, q0=None, v0=None, quantity=None):
    """{part: value} at t_end by `(4 y(h/2) - y(h)) / 3` of a method of order 2. Raises RuntimeError if a run fails."""
    coarse, fine = (end_state(model, t_end, method(h=step), q0, v0, quantity=quantity) for step in (h, h / 2))
    return {part: (4 * fine[part] - value) / 3 for part, value in coarse.items()}


def end_state(model, t_end, integrator, q0=None, v0=None, progress=None, quantity=None):
    """{part: value} at t_end by an integrator, or those of a Quantity. Raises RuntimeError if the run fails."""
    if quantity:
        return quantity.of_run(_consistent(full_run(model, t_end, integrator, q0, v0, progress, output=quantity.times)))
    return end_of(full_run(model, t_end, integrator, q0, v0, progress, every=10**9))


def full_run(model, t_end, integrator, q0=None, v0=None, progress=None, **frames):
    """The Trajectory from (q0, v0) to t_end with these frames. Raises RuntimeError if the run fails, KeyboardInterrupt after Ctrl-C."""
    run = solve(model, t_end, integrator, q0=q0, v0=v0, progress=progress, **frames)
    if run.status == "interrupted":
        raise KeyboardInterrupt
    if not run.success:
        raise RuntimeError(f"reference by {integrator}: {run.message}")
    return run


def _consistent(run):
    """A copy of a run whose a and lam are computed from the equations of motion at t, q and v of each frame but the last.

    The run's own are only linear over a step in frames within steps. The equations are evaluated just before the time of the frame, for
    steps end where loads jump. The last frame keeps the run's own.
    """
    model, a, lam = guard(run.model), np.array(run.a), np.array(run.lam)
    for k in range(len(run) - 1):
        a[k], lam[k] = consistent_acceleration(model, np.nextafter(run.t[k], -np.inf), run.q[k], run.v[k])
    return replace(run, a=a, lam=lam)


def end_of(run):
    """{part: value} of the motion, such as q, v and lam, at the end of a run."""
    return values_of(guard(run.model), run.q[-1], run.v[-1], run.lam[-1])


def distance(one, other):
    """{part: largest absolute difference} of the parts that both have."""
    return {part: float(np.abs(one[part] - other[part]).max(initial=0.0)) for part in one if part in other}
