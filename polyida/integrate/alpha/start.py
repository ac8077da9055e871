"""The states from which generalized-alpha starts: at a run's beginning, behind a kink, at another step, after a step that was cut.

`started` gives them. The method's own state is (q, v, a_alg): a_alg is q'' at t + (alpha_m - alpha_f) h, and v deviates from the velocity
constraint by `B l/h`, `l/h = (1 - 6 beta - 3 (alpha_m - alpha_f))/6 h^2 q'''`, which is the local error of q along the constraints (Arnold,
Bruels 2007). A start without them gives a first-order transient in lam. In the stabilised form v satisfies its constraint.

a_alg and v take from q'' and q''' what a step resolves, `F = (M + gamma h C + beta h^2 K)^-1 M`, constraints kept. F is
1/(1 + beta h^2 omega^2) for a mode without damping, 1/(1 + gamma h d) for one of damping alone. The start is right for modes with h omega < 1
and far too large beyond: noise of 1e-4 J became 20 J in one step with rho_inf = 0. `2 F - F^2` of q'' and `F^2` of q''' limit what no step
resolves; of a smooth motion they remove h^4 omega^4 of q'' and h^2 omega^2 of q''' (with damping h^2 d^2 and h d), below the order of both.
"""

from functools import singledispatch
from math import isclose

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.discontinuities import at_kink
from polyida.integrate.start import behind_samples, consistent_acceleration, far_side, rows_at, start_values
from polyida.integrate.state import Counts, State
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import ExactSaddle
from polyida.model.differences import beside

MUCH_LONGER = 2.5  # times the step before; adaptive steps grow by less


def jerk(model, state, h, begin=None):
    """q''' at a state, (n,), by one-sided differences of consistent accelerations over h/20.

    The differences look ahead for h > 0 and back for h < 0, so that a kink at the state has no effect. begin: the state's own time, or one
    beside a kink.
    """
    s, begin = h / 20, state.t if begin is None else begin

    def acceleration(s):
        """The consistent q'', (n,), at the time s later, where q and v follow the state's own v and a."""
        q = state.q + s * state.v + s * s / 2 * state.a
        return consistent_acceleration(model, begin + s, q, state.v + s * state.a)[0]

    return (4 * acceleration(s) - acceleration(2 * s) - 3 * acceleration(0.0)) / (2 * s)


def started(settings, model, state, h, system=None):
    """The state from which steps of h start; `memory` holds a_alg and h.

    A state of this method with this step is not changed; one with another step is rescaled; behind a kink velocities and accelerations jump.
    Any other state begins a run. After a step that was cut a_alg is q''. system: a step matrix that is factored for h, or None.
    """
    memory = state.memory
    right = beside(state.t, h) if at_kink(model, state.t) else None  # the time behind a kink here
    if "a_alg" not in memory:
        state = behind_samples(model, state) if right is None else far_side(model, state, right)
        phi, rate = start_values(model, state, right)
        state = _with(state, a_alg=state.a, h=h, phi=phi, rate=rate)
        if settings.start == "plain" or "cut" in memory:
            return state
        a_alg, q3 = _resolved(settings, model, state, h, state.a, jerk(model, state, h, right))
        deviation, rate_of_deviation = _velocity_deviation(settings, model, state, h, q3)
        return _with(state, v=state.v + deviation, a_alg=a_alg, rate=state.memory["rate"] + rate_of_deviation)
    if right is not None:
        state = _behind_kink(settings, model, state, float(memory["h"]))
    elif (v := model.sampled(state.t, state.q, state.v)) is not state.v:
        state = _behind_samples(settings, model, state, v, float(memory["h"]), system)
    return state if isclose(memory["h"], h, rel_tol=1e-9) else _rescaled(settings, model, state, h, right)


def motor_jump(model, state, h):
    """v behind a kink at a state: with outputs of controllers, and the jump of the motors' rates; h: a step, whose sign is the direction of time."""
    t, right, left = state.t, beside(state.t, h), beside(state.t, -h)
    v = model.sampled(t, state.q, state.v)
    if not model.m:
        return v
    jump = model.phi_t(right, state.q) - model.phi_t(left, state.q)
    return v + model.mass_system(t, state.q).solve(np.zeros(model.n), jump)[0]


def _behind_kink(settings, model, state, h):
    """The state on the far side of a kink: what jumps is added, what the method carries stays.

    Velocities jump with the motors' rates, in the metric of M; accelerations and multipliers with loads and rates; a_alg and v also with
    the jump of q'''. All are differences of consistent values on both sides, in which ringing mesh modes cancel.
    """
    t, right, left = state.t, beside(state.t, h), beside(state.t, -h)
    v, system = motor_jump(model, state, h), model.mass_system(t, state.q)
    bias = model.phi_bias(left, state.q, state.v) if model.m else np.zeros(0)
    before = system.solve(model.force(left, state.q, state.v), bias)
    after = consistent_acceleration(model, right, state.q, v)
    a, lam = state.a + after[0] - before[0], state.lam + after[1] - before[1]
    behind = _with(state, v=v, a=a, lam=lam)
    jump_of_q3 = jerk(model, behind, h, right) - jerk(model, state, -h, left)
    jump_of_a_alg, jump_of_q3 = _resolved(settings, model, behind, h, a - state.a, jump_of_q3)
    phi, rate = start_values(model, state, left)
    deviation, rate_of_deviation = _velocity_deviation(settings, model, state, h, jump_of_q3)
    a_alg = state.memory["a_alg"] + jump_of_a_alg
    return _with(behind, v=v + deviation, a_alg=a_alg, h=h, phi=phi, rate=rate + rate_of_deviation)


def _behind_samples(settings, model, state, v, h, system):
    """The state behind samples of controllers, whose outputs are in v. Outputs that act on rates only change the states' derivatives alone.

    system: a factored step matrix for h, or None.
    """
    t, q = state.t, state.q
    jump = model.force_change(t, q, state.v, v)
    if not model.without_states(jump).any():
        change = np.zeros(model.n)
        change[model.state_columns] = -jump[model.state_columns] / model.mass(q).diagonal()[model.state_columns]
        return _with(state, v=v, a=state.a + change, a_alg=state.memory["a_alg"] + change)
    inertia = model.mass_system(t, q)
    change, impulse = inertia.solve(jump, np.zeros(model.m))
    behind = _with(state, v=v, a=state.a + change, lam=state.lam + impulse)
    # the jump of q''' by a difference at one place, on the way of the motion before: what is the same on both sides cancels
    s = h / 20
    t = t + s
    q = q + s * state.v + s * s / 2 * state.a
    speeds = [side.v + s * side.a for side in (state, behind)]
    bias = model.phi_bias(t, q, speeds[1]) - model.phi_bias(t, q, speeds[0]) if model.m else np.zeros(0)
    jump_of_q3 = (model.mass_system(t, q).solve(model.force_change(t, q, *speeds), bias)[0] - change) / s
    if system is None:
        jump_of_a_alg, jump_of_q3 = _resolved(settings, model, behind, h, change, jump_of_q3)
    else:
        jump_of_a_alg = _resolved_by_factor(settings, model, behind, h, change, jump_of_q3, system)
    deviation, rate_of_deviation = _velocity_deviation(settings, model, state, h, jump_of_q3, inertia)
    phi, rate = start_values(model, state)
    return _with(behind, v=v + deviation, a_alg=state.memory["a_alg"] + jump_of_a_alg, phi=phi, rate=rate + rate_of_deviation)


def _rescaled(settings, model, state, h, right):
    """The state at another step: a_alg - q'' scales with h, the deviation of v from the velocity constraint with h^2.

    right: the time behind a kink here.
    """
    growth, memory, v = h / float(state.memory["h"]), state.memory, state.v
    # behind a much shorter step (a pulse between two kinks) both shrink instead: scaled up so far, noise of mesh modes in a_alg would add momentum
    scale = growth if growth <= MUCH_LONGER else 1.0 / growth
    phi, rate = start_values(model, state, right)
    if model.m and settings.form == "index3":
        v = v + (1 - scale**2) * model.mass_system(state.t, state.q).solve(np.zeros(model.n), rate)[0]
    return _with(state, v=v, a_alg=state.a + scale * (memory["a_alg"] - state.a), h=h, phi=phi, rate=scale**2 * rate)


def _resolved(settings, model, state, h, a, q3):
    """(a_alg, q''' used for v), (n,) each, that a step of h resolves, of q'' = a and q''' = q3, or their jumps for jumps.

    a and q3 may be taped. a_alg is q'' at t + (alpha_m - alpha_f) h.
    """
    resolve = resolution(model, settings, state, h)
    once, q3 = resolve(a), resolve(resolve(q3))
    return 2 * once - resolve(once) + settings.coefficients.offset * h * q3, q3


def _resolved_by_factor(settings, model, state, h, a, q3, system):
    """The a_alg of `_resolved`, (n,), with F from a factored step matrix `c_m M + c_v C + K` for h; a, q3: q'' and q''', or their jumps.

    For v the caller uses q''' itself: F does not change phi_q q''', on which alone the deviation of v depends. F has here
    beta (1 - alpha_f)/(1 - alpha_m) in place of beta; it is `saddle` with r = -c_m M x and phi = -phi_q x, for both vectors at once. As
    phi_q F x = phi_q x, the rows of x serve F x too. The last solve gives -F^2 a + (alpha_m - alpha_f) h F^2 q'''.
    """
    c_m, mass, B = settings.coefficients.rates(h)[0], model.mass(state.q), model.phi_q(state.t, state.q)

    def resolve(x, rows):
        """F x for x (n,) or (n, columns); rows = phi_q x."""
        return system.saddle(state.t, state.q, state.lam, -c_m * (mass @ x), -rows)[0]

    both, weights = np.stack([a, q3], axis=1), (-1.0, settings.coefficients.offset * h)
    rows = B @ both
    once = resolve(both, rows)
    return 2 * once[:, 0] + resolve(once @ weights, rows @ weights)


def _velocity_deviation(settings, model, state, h, q3, inertia=None):
    """(deviation of v from the velocity constraint (n,), phi_q times it (m,)) for q''' = q3; zero unless the form is index 3.

    inertia: the model's mass_system at the state, if it is known.
    """
    if not model.m or settings.form != "index3":
        return 0.0, np.zeros(model.m)
    c = settings.coefficients
    offset = (1 - 6 * c.beta - 3 * c.offset) / 6 * h * h * q3
    rate = rows_at(model, state.t, state.q) @ offset
    if model.velocity_rows.size:
        rate = rate * ~np.isin(np.arange(model.m), model.velocity_rows)  # v satisfies these rows at every step
    return (inertia or model.mass_system(state.t, state.q)).solve(np.zeros(model.n), -rate)[0], rate


def _with(state, v=None, a=None, lam=None, **memory):
    """A copy of a State with other v, a or lam where these are given, and with these entries in its memory."""
    v, a, lam = (old if new is None else new for old, new in ((state.v, v), (state.a, a), (state.lam, lam)))
    return State(state.t, state.q, v, a, lam, state.memory | memory)


@singledispatch
def resolution(model, settings, state, h):
    """The function x -> F x, (n,), with phi_q F x = phi_q x; x and F x have the same unit. Raises StepFailure if F does not exist."""
    c, t, q = settings.coefficients, state.t, state.q
    c_m = 1 / (c.beta * h * h)  # 1/s^2
    system = ExactSaddle(model, c_m, c.gamma / (c.beta * h), Counts())
    system.at(t, q, state.v, state.a, state.lam)
    mass, B = system.M, system.B
    try:
        system.solve(np.zeros(model.n), np.zeros(model.m))  # it raises if F does not exist
    except SingularSystem as error:
        raise StepFailure("singular", f"the start's M + gamma h C + beta h^2 K: {error}", t) from None

    def resolve(x):
        """F x, (n,), by the equations of a step at the state."""
        return system.solve(c_m * (mass @ x), B @ x)[0]

    return resolve
