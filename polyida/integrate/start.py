"""Consistent start, the same for every integrator: positions and velocities on the constraints, accelerations and multipliers."""

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

EPS, STALLED = 2.0**-52, 1e-10  # of the scene's size: round-off, and what may be left where phi has more of it
VIOLATION = 1e-6  # of the coordinates' size: more than that is a mistake, less is round-off to project away


@named_keywords
def consistent_state(model: Model, t0: float = 0.0, q0: ArrayLike | None = None, v0: ArrayLike | None = None) -> State:
    """A State at t0 that satisfies phi = 0, `phi_q v + phi_t = 0` and the equations of motion.

    1. q0 (zeros where None) is freed of round-off in phi, v0 put on the velocity constraint, both in the metric of M. Where v0 is None
       it is that of the bodies' velocity and spin, which are first changed, as motions of rigid bodies, by as little kinetic energy as
       their joints ask for (a hinged bar keeps its moment of momentum about the hinge); a warning tells a change of more than a tenth. Bodies
       without a motion follow joints that move at t0 by the same rule.
    2. `[[M, B^T], [B, 0]] (a, lam) = (-g, -bias)`.
    Raises InputError for wrong shapes or values, of q0 and v0 or of what the model's functions return, for a start (or a given v0)
    that violates its constraint by more than 1e-6 of its size, that the model objects to, and for redundant or inconsistent constraints.
    """
    model = guard(model, "consistent_state")
    q, v = given(model, "q0", q0), given(model, "v0", v0)
    if not is_number(t0):
        raise InputError(f"t0 = {t0!r} must be a finite time in s")
    require_functions(model, float(t0), q, v)
    if model.m:
        state = State(float(t0), q, v, v, np.zeros(model.m))
        if not (model.is_scene and model.looks_apart == 1 and UnitRows(model, state).begin(state)):  # no proof, which takes linear time
            require_independent(model, rows_at(model, t0, q), q)
        drawn = q0 is None and model.is_scene
        remedy = "draw its bodies where they begin, or let scene.assemble() move them" if drawn else "give a consistent q0"
        require_near(model, "the drawing" if drawn else "q0", "phi", model.phi(t0, q), max(1.0, np.abs(q).max(initial=0)), remedy)
        q = _project_position(model, t0, q)
    if objection := model.rejection_reason(t0, q):
        raise InputError(f"the start cannot be accepted: {objection}")
    if v0 is None:
        v = given(model, "initial_velocity", model.initial_velocity(t0, q))
    if model.m:
        rate = model.phi_rate(t0, q, v)
        enough = max(1.0, np.abs(v).max(initial=0)) if v0 is not None else np.inf
        require_near(model, "v0", "phi_q v + phi_t", rate, enough, "give a consistent v0, or leave it out to have it made")
        v = on_velocity(model, t0, q, v, rate)
    a, lam = consistent_acceleration(model, t0, q, v)
    return State(float(t0), q, v, a, lam)


def restarted(model, state):
    """The State at the time of one that was interpolated, with its q and v put on the constraints, a and lam made anew."""
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
    """v moved in the metric of M onto the constraint `phi_q v + phi_t = 0` of time t; rate: of v, where it is known."""
    if rate is None:
        rate = model.phi_rate(t, q, v) if model.m else np.zeros(0)
    return v + model.mass_system(t, q).solve(np.zeros(model.n), rate)[0] if rate.any() else v


def far_side(model, state, t):
    """The state behind a kink, t being a time just there: v on a constraint that has jumped, a and lam of the new loads and rates."""
    v = on_velocity(model, t, state.q, state.v)
    a, lam = consistent_acceleration(model, t, state.q, v)
    return State(state.t, state.q, v, a, lam, state.memory)


def jerk(model, state, h, begin=None):
    """q''' at a state, (n,), by one-sided differences of consistent accelerations over h/20.

    h > 0 looks ahead only and h < 0 back only, so that a kink of a load or motor at the state does no harm. begin: the time taken
    for the state's own, to one side of a kink.
    """
    s, begin = h / 20, state.t if begin is None else begin

    def acceleration(s):
        q = state.q + s * state.v + s * s / 2 * state.a
        return consistent_acceleration(model, begin + s, q, state.v + s * state.a)[0]

    return (4 * acceleration(s) - acceleration(2 * s) - 3 * acceleration(0.0)) / (2 * s)


@singledispatch
def start_values(model, state, t=None):
    """(phi, rate) at the start of a run: as the state carries them, or evaluated, and zero for mere round-off.

    t: the time for rate, to one side of a kink.
    """
    if "phi" in state.memory and "rate" in state.memory:
        return np.array(state.memory["phi"], float), np.array(state.memory["rate"], float)
    phi = np.array(model.phi(state.t, state.q), float)
    phi = np.where(np.abs(phi) > ROUND_OFF * extent(model, state.q), phi, 0.0)
    return phi, velocity_rate(model, state.t if t is None else t, state.q, state.v)


@singledispatch
def velocity_rate(model, t, q, v):
    """phi_q v + phi_t, zero where it is nothing but round-off."""
    if not model.m:
        return np.zeros(0)
    phi_t, phi_q = model.phi_t(t, q), rows_at(model, t, q)
    rate = phi_q @ v + phi_t
    size = abs(phi_q.copy()) @ np.abs(v) + np.abs(phi_t)  # abs sorts a sparse matrix in place
    return np.where(np.abs(rate) > ROUND_OFF * size, rate, 0.0)


def rows_at(model, t, q):
    """phi_q, dense where the model is a small scene."""
    return (model.small_phi_q if model.is_scene and model.small else model.phi_q)(t, q)


def given(model, name, value):
    """The value as n floats, zeros where it is None; raises InputError naming it otherwise."""
    if value is None:
        return np.zeros(model.n)
    array = floats(value)
    if array is None or array.shape != (model.n,):
        shape = np.shape(value) if array is None and isinstance(value, np.ndarray) else getattr(array, "shape", "none")
        raise InputError(f"{name}: shape {shape}, it must be {model.n} finite numbers")
    return array.copy()


def _largest(x):
    return float(np.abs(x).max(initial=0.0))


def require_state(part, model, state):
    """The State, its arrays floats; raises InputError in the name of `part` where it is none, or of another model."""
    if not is_number(getattr(state, "t", None)):
        raise InputError(f"{part}: state = {state!r} must be a State, the `state` of an earlier run")
    arrays = {name: floats(getattr(state, name, None)) for name in ("q", "v", "a", "lam")}
    sizes = {name: None if array is None else array.shape for name, array in arrays.items()}
    n, m = model.n, model.m
    if sizes != {"q": (n,), "v": (n,), "a": (n,), "lam": (m,)}:
        raise InputError(f"{part}: the state is of another model: its shapes are {sizes}, this model has n = {n}, m = {m}")
    return State(float(state.t), **arrays, memory=dict(getattr(state, "memory", {})), restart=getattr(state, "restart", True))


def require_near(model, name, what, violation, size, remedy):
    """Raise InputError, in the name of a start, where its constraints are not finite, or violated by VIOLATION of its size."""
    worst = int(np.argmax(np.abs(violation)))
    if not np.isfinite(violation).all():
        raise InputError(f"{name}: {model.constraint_name(worst)} is not finite at the start")
    if abs(violation[worst]) > VIOLATION * size:
        told = f"{name} violates the constraint {model.constraint_name(worst)}: {what} = {violation[worst]:.3g} instead of 0"
        raise InputError(f"{told}; {remedy}")


def _project_position(model, t, q):
    """Newton on phi = 0 along M^-1 B^T; ends where it moves q by round-off of the scene's size, or no longer by half as much."""
    before, size = np.inf, _largest(q if model.reference is None else model.reference) or 1.0
    for _ in range(50):
        phi = model.phi(t, q)
        move = model.mass_system(t, q).solve(np.zeros(model.n), phi)[0] if phi.any() else phi
        moved = _largest(move)
        if moved <= EPS * size or 0.5 * before <= moved < STALLED * size:
            return q
        q, before = q + move, moved
    worst = int(np.argmax(np.abs(phi)))
    raise InputError(
        f"the constraints are inconsistent: {model.constraint_name(worst)} stays at phi = {phi[worst]:.3g}; "
        "no configuration near q0 satisfies all of them"
    )
