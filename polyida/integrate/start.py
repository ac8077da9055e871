"""Consistent states for every integrator: at the start of a run, at interpolated states, behind kinks and samples.

In a consistent state q and v satisfy the constraints, and accelerations and multipliers the equations of motion.

Functions with several forms (`singledispatch`) have another one for models on a tape (adjoint/taped.py).
"""

from functools import singledispatch

import numpy as np
from numpy.typing import ArrayLike

from polyida.assembly.independence import UnitRows
from polyida.errors import InputError, StepFailure
from polyida.integrate.left_out import LeftOut
from polyida.integrate.row_sizes import rate_sizes, row_sizes
from polyida.integrate.sizes import ROUND_OFF, extent
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import require_independent
from polyida.model import Model
from polyida.model.guarded import guard, require_functions
from polyida.validation import floats, is_number, named_keywords

EPS, STALLED = 2.0**-52, 1e-10  # of the scene's size: round-off, and the largest correction that is accepted if it no longer falls
VIOLATION = 1e-6  # of the model's size: a larger violation is a mistake, a smaller one is projected away


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
