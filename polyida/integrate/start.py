"""Consistent initial conditions for every integrator, and the states from which generalized-alpha starts.

In a consistent state q and v satisfy the constraints, and accelerations and multipliers the equations of motion.

`started` gives the states from which generalized-alpha starts: a run's beginning, behind a kink, at another step, after a step that was cut.
The method's own state is (q, v, a_alg): a_alg is q'' at t + (alpha_m - alpha_f) h, and v deviates from the velocity constraint by `B l/h`,
`l/h = (1 - 6 beta - 3 (alpha_m - alpha_f))/6 h^2 q'''`, which is the local error of q along the constraints (Arnold, Bruels 2007). A start
without them gives a first-order transient in lam. In the stabilised form v satisfies its constraint.

a_alg and v take from q'' and q''' what a step resolves, `F = (M + gamma h C + beta h^2 K)^-1 M`, constraints kept. F is
1/(1 + beta h^2 omega^2) for a mode without damping, 1/(1 + gamma h d) for one of damping alone. The start is right for modes with h omega < 1
and far too large beyond: noise of 1e-4 J became 20 J in one step with rho_inf = 0. `2 F - F^2` of q'' and `F^2` of q''' limit what no step
resolves; of a smooth motion they remove h^4 omega^4 of q'' and h^2 omega^2 of q''' (with damping h^2 d^2 and h d), below the order of both.
"""

from functools import singledispatch
from math import isclose

import numpy as np
from numpy.typing import ArrayLike

from polyida.assembly.independence import UnitRows
from polyida.errors import InputError, StepFailure
from polyida.integrate.discontinuities import at_kink
from polyida.integrate.left_out import LeftOut
from polyida.integrate.row_sizes import rate_sizes, row_sizes
from polyida.integrate.sizes import ROUND_OFF, extent
from polyida.integrate.state import Counts, State
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import ExactSaddle, require_independent
from polyida.model import Model
from polyida.model.differences import beside
from polyida.model.guarded import guard, require_functions
from polyida.validation import floats, is_number, named_keywords

EPS, STALLED = 2.0**-52, 1e-10  # of the scene's size: round-off, and the largest correction that is accepted if it no longer falls
VIOLATION = 1e-6  # of the model's size: a larger violation is a mistake, a smaller one is projected away
MUCH_LONGER = 2.5  # times the step before; adaptive steps grow by less


@named_keywords
def consistent_state(
    model: Model, t0: float = 0.0, q0: ArrayLike | None = None, v0: ArrayLike | None = None, x0: ArrayLike | None = None
) -> State:
    """Return a state at t0 that satisfies phi = 0, `phi_q v + phi_t = 0` and the equations of motion.

    Parameters
    ----------
    model : Model
        The model.
    t0 : float, s
        Time of the state.
    q0 : (n,) array_like, optional
        Coordinates, zero by default. Their round-off in phi is removed in the metric of M.
    v0 : (n,) array_like, optional
        Velocities; they are projected onto the velocity constraint in the metric of M. By default those of the bodies' velocity and spin.
    x0 : (k,) array_like, optional
        First-order states. By default those of a v0 that has columns of states, or those of the force elements or of the model.

    Returns
    -------
    State
        With a and lam from `[[M, phi_q^T], [phi_q, 0]] (a, lam) = (-g, -phi_bias)`.

    Raises
    ------
    InputError
        For wrong shapes or values of q0, v0 or of what the model's functions return; for a start, or a v0, that violates its constraint by
        more than 1e-6 of its size or that the model rejects; for redundant or inconsistent constraints.

    Notes
    -----
    Velocity and spin of bodies are first changed as rigid-body motions by the least kinetic energy that the joints need (a hinged bar keeps
    its angular momentum about the hinge); a change of more than a tenth gives a warning. Bodies at rest follow joints that move at t0.
    """
    model = guard(model, "consistent_state")
    q, v = vector_of("q0", q0, model), velocities_of(v0, x0, model)
    if not is_number(t0):
        raise InputError(f"t0 = {t0!r} must be a finite time in s")
    require_functions(model, float(t0), q, v)
    if model.row_laws:
        contacts = _contacts(model)
        return contacts.begin(_consistent(contacts.base, t0, q0, v0, x0, q, v))
    return _consistent(model, t0, q0, v0, x0, q, v)


def _contacts(model):
    """The Contacts of a model with laws."""
    from polyida.integrate.nonsmooth.contacts import Contacts

    return Contacts(model)


def _consistent(model, t0, q0, v0, x0, q, v):
    """The State of a guarded model from the arguments of `consistent_state` and their values q and v."""
    if model.m:
        state = State(float(t0), q, v, v, np.zeros(model.m))
        if not (model.is_scene and model.looks_apart == 1 and UnitRows(model, state).begin(state)):  # else proved in linear time
            try:
                require_independent(model, rows_at(model, t0, q), q)
            except InputError as error:
                if q0 is None and not model.is_scene:
                    raise InputError(f"{error}; q0 was not given and is zero") from None
                raise
        drawn = q0 is None and model.is_scene
        remedy = "draw its bodies where they begin, or let scene.assemble() move them" if drawn else "give a consistent q0"
        sizes = row_sizes(model, q, rows_at(model, t0, q))
        require_near(model, "the drawing" if drawn else "q0", "phi", model.phi(t0, q), sizes, remedy)
        q = on_position(model, t0, q)
        if reason := LeftOut(model).contradiction(t0, q):
            raise InputError(f"{'the drawing' if drawn else 'q0'}: {reason}")
    if objection := model.rejection_reason(t0, q):
        raise InputError(f"the start cannot be accepted: {objection}")
    if v0 is None:
        v = velocities_of(model.initial_velocity(t0, q), x0, model, "initial_velocity")
    if model.m:
        rate = model.phi_rate(t0, q, v)
        sizes = rate_sizes(model, q, v, rows_at(model, t0, q)) if v0 is not None else np.inf
        require_near(model, "v0", "phi_q v + phi_t", rate, sizes, "give a consistent v0, or leave it out to have it made")
        v = on_velocity(model, t0, q, v, rate)
    return State(float(t0), q, v, *consistent_acceleration(model, t0, q, v)).of(model)


def restarted(model, state):
    """The State at an interpolated state's time, with its q and v projected onto the constraints, and consistent a and lam."""
    q, v = np.array(state.q, float), np.array(state.v, float)
    if model.row_laws:
        contacts = _contacts(model)
        return contacts.begin(restarted(contacts.base, state))
    if model.m:
        q = on_position(model, state.t, q)
        v = on_velocity(model, state.t, q, v)
    return State(float(state.t), q, v, *consistent_acceleration(model, state.t, q, v))


def on_drives(model, state, gap=0.0):
    """An interpolated state, or in a driven model of rigid bodies the State there that satisfies the constraints, with consistent a and lam.

    Where drives determine the motion, an integrator takes long steps, between which its polynomial is off by more than its tolerance. With
    flexible bodies steps are short, and consistent multipliers of an interpolated state are noise. gap: |phi| over the model's size below which
    the interpolated state is returned; so it is where the constraints cannot be solved.
    """
    if model.flexible or not model.needs.driven or (model.row_laws and not model.is_scene):
        return state
    contacts = model.once(_contacts) if model.row_laws else None
    if np.abs((contacts.base if contacts else model).phi(state.t, state.q)).max(initial=0) < gap * extent(model, state.q):
        return state
    try:
        return contacts.with_known_forces(restarted(contacts.base, state), state.lam) if contacts else restarted(model, state)
    except (InputError, StepFailure, SingularSystem, np.linalg.LinAlgError):  # constraints that depend on each other: the run decides
        return state


def consistent_acceleration(model, t, q, v):
    """(a, lam) from the equations of motion and the second derivative of phi."""
    bias = model.phi_bias(t, q, v) if model.m else np.zeros(0)
    return model.mass_system(t, q).solve(model.force(t, q, v), bias)


def on_velocity(model, t, q, v, rate=None):
    """v projected in the metric of M onto `phi_q v + phi_t = 0`; rate: `phi_q v + phi_t` if it is known."""
    if rate is None:
        rate = model.phi_rate(t, q, v) if model.m else np.zeros(0)
    return v + model.mass_system(t, q).solve(np.zeros(model.n), rate)[0] if rate.any() else v


def far_side(model, state, t):
    """The state just behind a kink, at t: v on the velocity constraint, which may have jumped, a and lam of the new loads."""
    v = on_velocity(model, t, state.q, model.sampled(state.t, state.q, state.v))
    return State(state.t, state.q, v, *consistent_acceleration(model, t, state.q, v), state.memory)


def behind_samples(model, state):
    """The state behind the samples of controllers at its time, with consistent a and lam; the state itself if none samples."""
    v = model.sampled(state.t, state.q, state.v)
    return state if v is state.v else State(state.t, state.q, v, *consistent_acceleration(model, state.t, state.q, v), state.memory)


def jerk(model, state, h, begin=None):
    """q''' at a state, (n,), by one-sided differences of consistent accelerations over h/20.

    The differences look ahead for h > 0 and back for h < 0, so that a kink at the state has no effect. begin: the state's own time, or one
    beside a kink.
    """
    s, begin = h / 20, state.t if begin is None else begin

    def acceleration(s):
        q = state.q + s * state.v + s * s / 2 * state.a
        return consistent_acceleration(model, begin + s, q, state.v + s * state.a)[0]

    return (4 * acceleration(s) - acceleration(2 * s) - 3 * acceleration(0.0)) / (2 * s)


@singledispatch
def start_values(model, state, t=None):
    """(phi, rate) of a state from its memory, or evaluated, with round-off set to zero; t: time of the rate if it is beside a kink."""
    if "phi" in state.memory and "rate" in state.memory:
        return np.array(state.memory["phi"], float), np.array(state.memory["rate"], float)
    phi = np.array(model.phi(state.t, state.q), float)
    phi = np.where(np.abs(phi) > ROUND_OFF * extent(model, state.q), phi, 0.0)
    return phi, velocity_rate(model, state.t if t is None else t, state.q, state.v)


@singledispatch
def velocity_rate(model, t, q, v):
    """phi_q v + phi_t, with round-off set to zero."""
    if not model.m:
        return np.zeros(0)
    phi_t, phi_q = model.phi_t(t, q), rows_at(model, t, q)
    rate = phi_q @ v + phi_t
    size = abs(phi_q.copy()) @ np.abs(v) + np.abs(phi_t)  # abs sorts a sparse matrix in place
    return np.where(np.abs(rate) > ROUND_OFF * size, rate, 0.0)


def rows_at(model, t, q):
    """phi_q, dense if the model is a small scene."""
    return (model.small_phi_q if model.is_scene and model.small else model.phi_q)(t, q)


def vector_of(name, value, model):
    """A copy of the value as n floats, zeros for None and behind the coordinates of bodies or a user. Raises InputError for anything else."""
    own = model.n - len(model.hidden)
    array = np.zeros(own) if value is None else floats(value)
    if array is None:
        entries = value if isinstance(value, (list, tuple)) else value.ravel().tolist() if isinstance(value, np.ndarray) else ()
        wrong = next((f"{name}[{k}] = {entry!r:.60}" for k, entry in enumerate(entries) if not is_number(entry)), f"{name} = {value!r:.60}")
        raise InputError(f"{wrong}: {name} must be {own} finite numbers")
    if array.shape not in ((model.n,), (own,)):
        raise InputError(f"{name}: shape {array.shape}, it must be {own} finite numbers")
    return np.append(array, np.zeros(model.n - len(array)))


def velocities_of(v0, x0, model, name="v0"):
    """A copy of v0 as n floats, zeros for None, with the states x0. Raises InputError for anything else."""
    v = vector_of(name, v0, model)
    if v0 is None or np.size(v0) < model.n:
        v[model.state_columns] = model.state_start
    if x0 is not None:
        x = floats(x0)
        if np.shape(x) != (model.k,):
            raise InputError(f"x0 = {x0!r:.100} must be {model.k} finite numbers, the states of the model")
        v[model.state_columns] = x / model.state_units
    return v


def require_state(part, model, state):
    """The State with arrays of floats. Raises InputError, in the name of `part`, for other types and for states of another model."""
    if not is_number(getattr(state, "t", None)):
        raise InputError(f"{part}: state = {state!r} must be a State, the `state` of an earlier run")
    arrays = {name: floats(getattr(state, name, None)) for name in ("q", "v", "a", "lam")}
    sizes = {name: None if array is None else array.shape for name, array in arrays.items()}
    n, m = model.n, model.m
    if sizes != {"q": (n,), "v": (n,), "a": (n,), "lam": (m,)}:
        raise InputError(f"{part}: the state is of another model: its shapes are {sizes}, this model has n = {n}, m = {m}")
    return State(float(state.t), **arrays, memory=dict(getattr(state, "memory", {})), restart=getattr(state, "restart", True))


def require_near(model, name, what, violation, sizes, remedy):
    """Raise InputError, in the name of a start, if its constraints are not finite or violated by VIOLATION of their sizes."""
    if not np.isfinite(violation).all():
        worst = int(np.argmin(np.isfinite(violation)))
        raise InputError(f"{name}: {model.constraint_name(worst)} is not finite at the start")
    beyond = np.abs(violation) - VIOLATION * sizes
    worst = int(np.argmax(beyond))
    if beyond[worst] > 0:
        constraint = f"the constraint {model.constraint_name(worst)}: {what} = {violation[worst]:.3g} instead of 0"
        raise InputError(f"{name} violates {constraint}; {remedy}")


@singledispatch
def on_position(model, t, q):
    """q after Newton's method on phi = 0 along M^-1 phi_q^T, up to corrections of round-off or that no longer halve."""
    before, size = np.inf, float(np.abs(q if model.reference is None else model.reference).max(initial=0.0)) or 1.0
    for _ in range(50):
        phi = model.phi(t, q)
        correction = model.mass_system(t, q).solve(np.zeros(model.n), phi)[0] if phi.any() else phi
        moved = float(np.abs(correction).max(initial=0.0))
        if moved <= EPS * size or 0.5 * before <= moved < STALLED * size:
            return q
        q, before = q + correction, moved
    worst = int(np.argmax(np.abs(phi)))
    stays = f"{model.constraint_name(worst)} stays at phi = {phi[worst]:.3g}"
    raise InputError(f"the constraints are inconsistent: {stays}; no configuration near q0 satisfies all of them")


def started(settings, model, state, h, system=None):
    """The state from which steps of h start; `memory` holds a_alg and h.

    A state of this method with this step is not changed; one with another step is rescaled; behind a kink velocities and accelerations jump.
    Any other state begins a run. After a step that was cut a_alg is q''. system: a step matrix that is factored for h, or None.
    """
    memory, right = state.memory, beside(state.t, h) if at_kink(model, state.t) else None
    if "a_alg" not in memory:
        state = behind_samples(model, state) if right is None else far_side(model, state, right)
        phi, rate = start_values(model, state, right)
        state = _with(state, a_alg=state.a, h=h, phi=phi, rate=rate)
        if settings.start == "plain" or "cut" in memory:
            return state
        ahead, third = _resolved(settings, model, state, h, state.a, jerk(model, state, h, right))
        deviation, rate = _velocity_deviation(settings, model, state, h, third)
        return _with(state, v=state.v + deviation, a_alg=ahead, rate=state.memory["rate"] + rate)
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
    third = jerk(model, behind, h, right) - jerk(model, state, -h, left)
    ahead, third = _resolved(settings, model, behind, h, a - state.a, third)
    phi, rate = start_values(model, state, left)
    deviation, more = _velocity_deviation(settings, model, state, h, third)
    return _with(behind, v=v + deviation, a_alg=state.memory["a_alg"] + ahead, h=h, phi=phi, rate=rate + more)


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
    s = h / 20  # the jump of q''' by a difference at one place, on the way of the motion before: what is the same on both sides cancels
    t, q, speeds = t + s, q + s * state.v + s * s / 2 * state.a, [side.v + s * side.a for side in (state, behind)]
    bias = model.phi_bias(t, q, speeds[1]) - model.phi_bias(t, q, speeds[0]) if model.m else np.zeros(0)
    third = (model.mass_system(t, q).solve(model.force_change(t, q, *speeds), bias)[0] - change) / s
    ahead, third = _resolved(settings, model, behind, h, change, third, system)
    deviation, more = _velocity_deviation(settings, model, state, h, third, inertia)
    phi, rate = start_values(model, state)
    return _with(behind, v=v + deviation, a_alg=state.memory["a_alg"] + ahead, phi=phi, rate=rate + more)


def _rescaled(settings, model, state, h, right):
    """The state at another step: a_alg - q'' scales with h, the deviation of v from the velocity constraint with h^2.

    right: the time behind a kink here. Behind a much shorter step (a pulse between two kinks) both shrink instead: scaled up so far, noise of
    mesh modes in a_alg would add momentum.
    """
    growth, memory, v = h / float(state.memory["h"]), state.memory, state.v
    scale = growth if growth <= MUCH_LONGER else 1.0 / growth
    phi, rate = start_values(model, state, right)
    if model.m and settings.form == "index3":
        v = v + (1 - scale**2) * model.mass_system(state.t, state.q).solve(np.zeros(model.n), rate)[0]
    return _with(state, v=v, a_alg=state.a + scale * (memory["a_alg"] - state.a), h=h, phi=phi, rate=scale**2 * rate)


def _resolved(settings, model, state, h, a, third, system=None):
    """(q'' at t + (alpha_m - alpha_f) h, q''') that a step resolves, of q'' = a and q''' = third, or of their jumps.

    system: a factored step matrix `c_m M + c_v C + K` of the method, which F may be computed from; q''' is then resolved in q'' alone, as F does
    not change phi_q q'''.
    """
    if system is None:  # a and q''' may be taped
        resolve = resolution(model, settings, state, h)
        near, third = resolve(a), resolve(resolve(third))
        return 2 * near - resolve(near) + settings.coefficients.offset * h * third, third
    # with beta (1 - alpha_f)/(1 - alpha_m) in place of beta; of both vectors at once
    c_m, mass, border = settings.coefficients.rates(h)[0], model.mass(state.q), model.phi_q(state.t, state.q)
    resolve = lambda x, rows: system.saddle(state.t, state.q, state.lam, -c_m * (mass @ x), -rows)[0]  # noqa: E731
    both, weights = np.stack([a, third], axis=1), (-1.0, settings.coefficients.offset * h)
    rows = border @ both
    near = resolve(both, rows)
    return 2 * near[:, 0] + resolve(near @ weights, rows @ weights), third


def _velocity_deviation(settings, model, state, h, third, inertia=None):
    """The deviation of v from the velocity constraint for q''' = third, and phi_q times it.

    inertia: the model's mass_system at the state, if it is known.
    """
    if not model.m or settings.form != "index3":
        return 0.0, np.zeros(model.m)
    c = settings.coefficients
    offset = (1 - 6 * c.beta - 3 * c.offset) / 6 * h * h * third
    border = rows_at(model, state.t, state.q) @ offset
    if model.velocity_rows.size:
        border = border * ~np.isin(np.arange(model.m), model.velocity_rows)  # v satisfies these rows at every step
    return (inertia or model.mass_system(state.t, state.q)).solve(np.zeros(model.n), -border)[0], border


def _with(state, v=None, a=None, lam=None, **memory):
    v, a, lam = (old if new is None else new for old, new in ((state.v, v), (state.a, a), (state.lam, lam)))
    return State(state.t, state.q, v, a, lam, state.memory | memory)


@singledispatch
def resolution(model, settings, state, h):
    """The function x -> F x, (n,), with phi_q F x = phi_q x. Raises StepFailure if F does not exist."""
    c, (t, q) = settings.coefficients, (state.t, state.q)
    c_m, system = 1 / (c.beta * h * h), ExactSaddle(model, 1 / (c.beta * h * h), c.gamma / (c.beta * h), Counts())
    system.at(t, q, state.v, state.a, state.lam)
    mass, border = system.M, system.B
    try:
        system.solve(np.zeros(model.n), np.zeros(model.m))  # it raises if F does not exist
    except SingularSystem as error:
        raise StepFailure("singular", f"the start's M + gamma h C + beta h^2 K: {error}", t) from None
    return lambda x: system.solve(c_m * (mass @ x), border @ x)[0]
