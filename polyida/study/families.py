"""The end of a motion by methods of unlike families, for references: what two of them agree on is known so well.

`by_explicit`: DOP853 on the index-1 equations; `by_radau`: Radau IIA on the stabilised form; `by_bdf`: IDA; `extrapolated`: Simo and
Tarnow's energy-momentum method, or generalized-alpha. They share the model, its consistent accelerations and no formula of a step.
"""

from types import SimpleNamespace

import numpy as np

from polyida.environment import one_blas_thread
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import consistent_acceleration, consistent_state, restarted
from polyida.run.solve import solve

PARTS = ("q", "v", "lam")
LEGS = 32  # of explicit runs: angle motors drift by 2e-10 rad in 1 s without, by round-off within a leg
MOST, SMALL = 3e7, 200  # evaluations times (coordinates + SMALL) of an explicit run at most: fifteen seconds; their projection stops it
LONG = 300_000  # steps that BDF may take
TOLD = 2000  # evaluations or steps after which the projection is made


class TooStiff(Exception):
    """A run would take too many steps or evaluations."""


class Limit:
    """Counts steps or evaluations, and raises TooStiff where a run, as far as it has come, would take more than `most` of them."""

    def __init__(self, name, what, most, t_end, t0=0.0):
        self.name, self.what, self.most, self.t_end, self.t0, self.count = name, what, most, t_end, t0, 0

    def __call__(self, t):
        self.count += 1
        if self.count % TOLD == 0 and t > self.t0:
            projected = self.count * (self.t_end - self.t0) / (t - self.t0)
            if projected > self.most:
                raise TooStiff(f"{self.name}: it would take {projected:.1g} {self.what}, for the motion is stiff")


def explicit(model, t_end, rtol, t0=0.0, q0=None, v0=None, times=None, legs=1, spare=False):
    """[(q, v, a, lam)] at the increasing `times` (default t_end alone), by DOP853 on (q, v)' = (v, a) with a of the
    index-1 equations.

    It shares the model's equations and the consistent start with the integrators, no formula of a step. Pieces end at
    the kinks of loads and motors. legs: equal parts of the time, between which q and v, which drift off nonlinear
    constraints, are put back on them. spare: raise TooStiff rather than take long.
    """
    state, wanted, found = consistent_state(model, t0, q0, v0), np.atleast_1d(t_end if times is None else times), []
    y, t, put_back = np.concatenate([state.q, state.v]), t0, np.linspace(t0, wanted[-1], legs + 1)[1:-1]
    most = MOST / (model.n + SMALL) if spare else np.inf
    rate = _Rate(model, Limit("DOP853", "evaluations", most, wanted[-1], t0))
    with one_blas_thread():
        for end in sorted({*model.kinks(t0, wanted[-1]), *put_back, wanted[-1]}):
            within = (wanted > t) & (wanted <= end) | (wanted == t0) & (t == t0)
            values, y = _piece(rate, t, end, y, wanted[within], rtol)
            y = _put_back(model, end, y) if end in put_back else y
            found, t = found + values, end
    return found


def _put_back(model, t, y):
    state = restarted(model, SimpleNamespace(t=t, q=y[: model.n], v=y[model.n :]))
    return np.concatenate([state.q, state.v])


class _Rate:
    """The right side (t, y) -> y'; counted: called with t each time."""

    def __init__(self, model, counted):
        self.model, self.counted = model, counted

    def __call__(self, t, y):
        n = self.model.n
        self.counted(t)
        return np.concatenate([y[n:], consistent_acceleration(self.model, t, y[:n], y[n:])[0]])


def _piece(rate, t, end, y, wanted, rtol):
    """States at the wanted times in (t, end], and y at the end."""
    from scipy.integrate import solve_ivp

    model, n, at = rate.model, rate.model.n, np.union1d(wanted, [end])
    run = solve_ivp(rate, (t, end), y, method="DOP853", t_eval=at, rtol=rtol, atol=rtol * 1e-3, first_step=min(1e-6, end - t))
    if not run.success:
        raise RuntimeError(f"DOP853: {run.message}")
    known = dict(zip(at, run.y.T))
    return [(known[s][:n], known[s][n:], *consistent_acceleration(model, s, known[s][:n], known[s][n:])) for s in wanted], run.y[:, -1]


def by_explicit(model, t_end, rtol, q0=None, v0=None, spare=False):
    """{"q", "v", "lam"} at t_end by `explicit`."""
    q, v, _, lam = explicit(model, t_end, rtol, q0=q0, v0=v0, legs=LEGS, spare=spare)[0]
    return {"q": q, "v": v, "lam": lam}


def by_radau(model, t_end, rtol, q0=None, v0=None):
    """{"q", "v", "lam"} at t_end by Radau IIA of order 5 with error control. RuntimeError where it does not come there."""
    return end_by(model, t_end, RadauIIA(rtol=rtol), q0, v0)


def by_bdf(model, t_end, rtol, q0=None, v0=None):
    """{"q", "v", "lam"} at t_end by BDF, of IDA. RuntimeError where it does not come there, TooStiff where it would take long."""
    return end_by(model, t_end, IDA(rtol=rtol, max_num_steps=2 * LONG), q0, v0, progress=Limit("IDA", "steps", LONG, t_end))


def extrapolated(model, t_end, method, h, q0=None, v0=None):
    """{"q", "v", "lam"} at t_end by a method of order 2, function of h: `(4 x(h/2) - x(h)) / 3` at the end alone.

    RuntimeError where one of both runs does not come there.
    """
    coarse, fine = (end_by(model, t_end, method(h=step), q0, v0) for step in (h, h / 2))
    return {part: (4 * fine[part] - coarse[part]) / 3 for part in PARTS}


def end_by(model, t_end, integrator, q0=None, v0=None, progress=None):
    """{"q", "v", "lam"} at t_end by an integrator. RuntimeError where it does not come there."""
    return vars(last_state(whole(model, t_end, integrator, q0, v0, progress, every=10**9)))


def whole(model, t_end, integrator, q0=None, v0=None, progress=None, every=1):
    """The run of an integrator to t_end. RuntimeError where it does not come there."""
    run = solve(model, t_end, integrator, q0=q0, v0=v0, every=every, progress=progress)
    if run.status == "interrupted":
        raise KeyboardInterrupt
    if not run.success:
        raise RuntimeError(f"reference by {integrator}: {run.message}")
    return run


def distance(one, other):
    """{part: the largest absolute difference} of what both know."""
    return {part: float(np.abs(one[part] - other[part]).max(initial=0.0)) for part in one if part in other}


def last_state(run):
    """q, v and lam at the end of a run."""
    return SimpleNamespace(q=run.q[-1], v=run.v[-1], lam=run.lam[-1])
