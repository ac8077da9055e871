"""Consistent initial conditions for every integrator: q and v on the constraints, accelerations and multipliers from the equations."""

from functools import singledispatch

import numpy as np
from numpy.typing import ArrayLike

from polyida.assembly.independence import UnitRows
from polyida.errors import InputError
from polyida.integrate.sizes import ROUND_OFF, extent
from polyida.integrate.state import State
from polyida.linear.saddle import require_independent
from polyida.model import Model
from polyida.model.guarded import guard, require_functions
from polyida.validation import floats, is_number, named_keywords

EPS, STALLED = 2.0**-52, 1e-10  # of the scene's size: round-off, and the largest correction that is accepted if it no longer falls
VIOLATION = 1e-6  # of the coordinates' size: a larger violation is a mistake, a smaller one is projected away


@named_keywords
def consistent_state(model: Model, t0: float = 0.0, q0: ArrayLike | None = None, v0: ArrayLike | None = None) -> State:
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
    q, v = vector_of("q0", q0, model), vector_of("v0", v0, model)
    if not is_number(t0):
        raise InputError(f"t0 = {t0!r} must be a finite time in s")
    require_functions(model, float(t0), q, v)
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
        require_near(model, "the drawing" if drawn else "q0", "phi", model.phi(t0, q), max(1.0, np.abs(q).max(initial=0)), remedy)
        q = _project_position(model, t0, q)
    if objection := model.rejection_reason(t0, q):
        raise InputError(f"the start cannot be accepted: {objection}")
    if v0 is None:
        v = vector_of("initial_velocity", model.initial_velocity(t0, q), model)
    if model.m:
        rate = model.phi_rate(t0, q, v)
        size = max(1.0, np.abs(v).max(initial=0)) if v0 is not None else np.inf
        require_near(model, "v0", "phi_q v + phi_t", rate, size, "give a consistent v0, or leave it out to have it made")
        v = on_velocity(model, t0, q, v, rate)
    return State(float(t0), q, v, *consistent_acceleration(model, t0, q, v))


def restarted(model, state):
    """The State at an interpolated state's time, with its q and v projected onto the constraints, and consistent a and lam."""
    q, v = np.array(state.q, float), np.array(state.v, float)
    if model.m:
        q = _project_position(model, state.t, q)
        v = on_velocity(model, state.t, q, v)
    return State(float(state.t), q, v, *consistent_acceleration(model, state.t, q, v))


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
    v = on_velocity(model, t, state.q, state.v)
    return State(state.t, state.q, v, *consistent_acceleration(model, t, state.q, v), state.memory)


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
    """A copy of the value as n floats, zeros for None. Raises InputError for anything else."""
    if value is None:
        return np.zeros(model.n)
    array = floats(value)
    if array is None or array.shape != (model.n,):
        shape = np.shape(value) if array is None and isinstance(value, np.ndarray) else getattr(array, "shape", "none")
        raise InputError(f"{name}: shape {shape}, it must be {model.n} finite numbers")
    return array.copy()


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


def require_near(model, name, what, violation, size, remedy):
    """Raise InputError, in the name of a start, if its constraints are not finite or violated by VIOLATION of its size."""
    worst = int(np.argmax(np.abs(violation)))
    if not np.isfinite(violation).all():
        raise InputError(f"{name}: {model.constraint_name(worst)} is not finite at the start")
    if abs(violation[worst]) > VIOLATION * size:
        constraint = f"the constraint {model.constraint_name(worst)}: {what} = {violation[worst]:.3g} instead of 0"
        raise InputError(f"{name} violates {constraint}; {remedy}")


def _project_position(model, t, q):
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
    raise InputError(
        f"the constraints are inconsistent: {model.constraint_name(worst)} stays at phi = {phi[worst]:.3g}; "
        "no configuration near q0 satisfies all of them"
    )
