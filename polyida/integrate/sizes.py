"""Characteristic length, speed and time of a motion, from which tolerances are chosen, and states at rest, which steps do not change.

A state is at rest if v and phi are zero and its forces move it by no more than round-off within the time T to come:
`(M / T^2 + K) dq + phi_q^T dlam = -r`, `phi_q dq = 0`, r = r(t, q, 0, 0, lam). It stays there, at the cost of one residual for each step, as
long as r, phi and phi_t are the same to the last bit, that is, until a load, motor or force changes; also if its equilibrium is unstable.
Memory "rest" of a State is that r: a run that goes on from it, or from `static`, does not test again. A motion that dies out comes near to
rest within round-off and is integrated on.
"""

import numpy as np

from polyida.integrate.discontinuities import inner_side
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem

TIMES = (np.arange(32) + 0.5) / 32  # of the run's time, at which the speeds of motors are evaluated
STANDS = 1e-6  # of its length: a model that its first state moves by less in the whole run stands still
# constants of compiled code
ROUND_OFF = 64 * 2.0**-52  # of the numbers in phi: a |phi| that is round-off
LEAST = 1e-10  # least relative tolerance that is chosen automatically
NOTHING = 1e-12  # m: a |q| below is the round-off of a start at zero that was moved onto its constraints
LEAST_TIME = 1.0  # s: a state at rest stays there for this time at least, however short the run
CLOSED = 1e-10  # of the model's extent: |phi| of a state whose constraints are satisfied
CALM = 1e-3  # of gravity: a state with a greater acceleration is not at rest


def typical_sizes(model, state, span):
    """[length, speed]: absolute tolerances of q and v are rtol times these; the state is consistent, `span` is the run's time, s.

    length: a scene's extent, m; for a user's model |q|, or if q = 0 the distance at which its stiffness reverses the motion. States of first
    order are left out.
    speed: the largest of |v|, `sqrt(|a| length)`, in a scene `sqrt(g length)`, and, for motors and paths, their largest rate (times the
    length for angles); length/span if all of these are zero. |x| is the root mean square. Both scale with the units of length and time.
    """
    q, v, a = (float(np.sqrt(x @ x / max(1, x.size - model.k))) for x in map(model.without_states, (state.q, state.v, state.a)))
    length = model.extent or (q if q > NOTHING else _distance(model, state, span, v, a))
    rates = [
        max(float(np.abs(model.drives(at)[profiles, 1]).max(initial=0.0)) for at in state.t + span * TIMES) if len(profiles) else 0.0
        for profiles in (model.motor_profiles, model.path_profiles)
    ]
    speed = max(v, np.sqrt(max(a, model.free_fall) * length), length * rates[0], rates[1])
    return np.array([length, speed if model.free_fall or speed > STANDS * length / span else length / span])


def _distance(model, state, span, v, a):
    """Distance that v and a cover from q = 0 in the run or in 1/w, `w^2 = |d^T K d| / |d^T M d|`, d along v or a; 1 if it is zero."""
    d = model.without_states(state.v if v else state.a)
    stiffness = model.tangent(state.t, state.q, state.v, state.a, state.lam, 0.0, 0.0, 1.0)
    mass, spring = (abs(d @ (matrix @ d)) for matrix in (model.mass(state.q), stiffness))
    time = min(span, np.sqrt(mass / spring)) if spring > 0 else span
    return v * time + a * time**2 or 1.0


def sizes_of_run(model, state, t_end):
    """[length, speed, time, lengths] of the run that a state belongs to, from its memory, or of a run that begins with it; m, m/s, s.

    lengths: how many lengths the motion covers in that time, a number without unit. If the run goes on for longer than it was planned,
    both are those of the time to come.
    """
    known, span = state.memory.get("sizes", ()), t_end - state.t
    if len(known) == 4:
        more = max(1.0, span / known[2])
        return np.array(known, float) * (1.0, 1.0, more, more)
    length, speed = known if len(known) else typical_sizes(model, state, span)
    frequency = speed / length
    if not model.extent:  # of a user's model: mass-weighted norms, independent of the units of its coordinates
        shares = weights(model, state.q)
        q, v, a = (float(np.sqrt(shares @ model.without_states(x) ** 2)) for x in (state.q, state.v, state.a))
        frequency = (max(v / q, np.sqrt(a / q)) if q > NOTHING else 0.0) or frequency
    return np.array([length, speed, span, span * frequency], float)


def relative_tolerance(aim, most, lengths):
    """`aim`, or less if the motion covers more than `most` lengths, because the errors of steps add up."""
    return max(LEAST, aim * min(1.0, most / lengths))


def rtol_message(rtol, lengths):
    """Text of a summary on a relative tolerance that was chosen automatically."""
    enough = "" if rtol > LEAST else ", the least that is chosen by itself: the error may be larger"
    return f"rtol {rtol:.1e} for a motion over {lengths:.2g} times the model's length{enough}"


def weights(model, q):
    """Weights (n,) of the coordinates in a mean square, `M_ii / sum M_ii`, which make it independent of the coordinates' units."""
    masses = np.abs(model.mass(q).diagonal())
    total = masses.sum()
    return masses / total if total > 0 else np.full(model.n, 1.0 / model.n)


def extent(model, q):
    """Size of the numbers in phi, m: displacements, and distances within the model, wherever it lies."""
    return (model.extent or 1.0) + float(np.abs(q).max(initial=0.0))


def states_at_rest(model, state, grid, counts):
    """Yield the states at the ends of the grid's steps as long as `state` stays at rest; none if it is not.

    The caller counts the steps. A state without memory of its rest costs two residuals more, and a factor if r is not zero.
    """
    r = _residual_at_rest(model, state, grid, counts)
    if r is None:
        return
    driven = _driven_constraints(model, state.t, state.q)
    for done in range(grid.done, grid.count):
        t = grid.time(done + 1)
        inner = t if done + 1 < grid.count else inner_side(model, t, grid.h)
        if not np.array_equal(driven, _driven_constraints(model, inner, state.q)):
            return
        if not np.array_equal(r, _residual(model, inner, state, counts)):
            return
        yield State(float(t), state.q, state.v, state.a, state.lam, {"rest": r})


def memory_of_rest(model, t, q, r, solve):
    """Memory of a state in equilibrium: empty if Newton's next correction of q, by `solve(r, phi)`, is more than round-off."""
    correction = np.abs(solve(r, model.phi(t, q))[0]).max()
    return {"rest": r} if correction <= ROUND_OFF * extent(model, q) else {}


def _residual_at_rest(model, state, grid, counts):
    """r of a state that stays at rest in the next step of the grid, (n,); else None."""
    if state.v.any() or np.abs(model.phi(state.t, state.q)).max(initial=0.0) > CLOSED * extent(model, state.q):
        return None
    if model.sampled(state.t, state.q, state.v) is not state.v:  # outputs of controllers may set it in motion
        return None
    if "rest" in state.memory:
        return state.memory["rest"]
    if grid.done:  # the run was not at rest at the grid's beginning, and goes on as if it had not been stopped
        return None
    small = ROUND_OFF * extent(model, state.q)
    if np.abs(state.a).max() > (CALM * model.free_fall or small / grid.h**2):
        return None
    next_t = inner_side(model, grid.time(grid.done + 1), grid.h)
    if not np.array_equal(*(_driven_constraints(model, t, state.q) for t in (state.t, next_t))):
        return None
    r = _residual(model, state.t, state, counts)
    if not np.array_equal(r, _residual(model, next_t, state, counts)):
        return None
    if not r.any():
        return r
    system, zero, time = model.step_matrix(), np.zeros(model.n), max(grid.end - state.t, LEAST_TIME)
    counts.add(factors=1)
    try:
        system.factor(state.t, state.q, zero, zero, state.lam, 1.0 / time**2, 0.0)
        dq, _ = system.saddle(state.t, state.q, state.lam, r, np.zeros(model.m))
    except SingularSystem:
        return None
    counts.add(system=system)
    counts.solves += 1
    return r if np.abs(dq).max() <= small else None


def _residual(model, t, state, counts):
    """r(t, q, 0, 0, lam) of a state."""
    counts.residuals += 1
    zero = np.zeros(model.n)
    return model.residual(t, state.q, zero, zero, state.lam)


def _driven_constraints(model, t, q):
    """phi and phi_t; empty if nothing drives the constraints."""
    return np.concatenate([model.phi(t, q), model.phi_t(t, q)]) if model.m and model.needs.driven else np.zeros(0)
