"""Rest: where nothing moves a state, steps leave it where it is, at one residual each, without a factor.

A state is at rest where v and phi are zero and what is left of its forces leads nowhere within the time T to come: `|dq|` of
`(M / T^2 + K) dq + phi_q^T dlam = -r`, `phi_q dq = 0`, r = r(t, q, 0, 0, lam), is no more than round-off of the coordinates. There it stays
while r and phi, and phi_t, are the same to the last bit, which says that no load, motor or force has begun to move; also where the
equilibrium is one that a touch would upset. Memory "rest" of a State: that r, by which a run goes on, and one from `static` begins,
without another look. A motion that dies out comes as near to rest as round-off, and goes on there step by step.
"""

import numpy as np

from polyida.integrate.kinks import inner_side
from polyida.integrate.sizes import ROUND_OFF, extent
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem

LEAST = 1.0  # s: as long it is to stay at least, however short the run
CLOSED = 1e-10  # of the model's extent: |phi| of a state that is where its constraints want it
CALM = 1e-3  # of a fall, where there is gravity: a greater acceleration is no rest, which needs no closer look


def held(model, state, grid, counts):
    """Yield the states at the ends of the grid's steps as long as nothing moves `state`, none where it is not at rest.

    A step is a residual and is counted by the caller; so is the look at a state without memory of its rest: two residuals and, where r
    is not zero, a factor.
    """
    r = _at_rest(model, state, grid, counts)
    closed = None if r is None else _closed(model, state.t, state.q)
    for done in range(grid.done, grid.count if r is not None else 0):
        t = grid.time(done + 1)
        inner = t if done + 1 < grid.count else inner_side(model, t, grid.h)
        if not np.array_equal(closed, _closed(model, inner, state.q)):
            return
        if not np.array_equal(r, _forces(model, inner, state, counts)):
            return
        yield State(float(t), state.q, state.v, state.a, state.lam, {"rest": r})


def equilibrium(model, t, q, lam, r, solve):
    """Memory of the rest of a state in equilibrium: empty where `solve(r, phi)`, Newton's next correction of q, is more than round-off."""
    left = np.abs(solve(r, model.phi(t, q))[0]).max()
    return {"rest": r} if left <= ROUND_OFF * extent(model, q) else {}


def _at_rest(model, state, grid, counts):
    """r of a state at rest, or None."""
    if state.v.any() or np.abs(model.phi(state.t, state.q)).max(initial=0.0) > CLOSED * extent(model, state.q):
        return None
    if "rest" in state.memory:
        return state.memory["rest"]
    if grid.done:  # the run was not at rest where the grid begins, and goes on as if it had not been stopped
        return None
    small = ROUND_OFF * extent(model, state.q)
    if np.abs(state.a).max() > (CALM * model.free_fall or small / grid.h**2):
        return None
    next_t = inner_side(model, grid.time(grid.done + 1), grid.h)
    if not np.array_equal(_closed(model, state.t, state.q), _closed(model, next_t, state.q)):
        return None
    r = _forces(model, state.t, state, counts)
    if not np.array_equal(r, _forces(model, next_t, state, counts)):
        return None
    return r if not r.any() or _way(model, state, r, max(grid.end - state.t, LEAST), counts) <= small else None


def _forces(model, t, state, counts):
    """r(t, q, 0, 0, lam) of a state."""
    counts.residuals += 1
    still = np.zeros(model.n)
    return model.residual(t, state.q, still, still, state.lam)


def _closed(model, t, q):
    """What constraints that are driven ask of a state: phi and phi_t, or nothing."""
    return np.concatenate([model.phi(t, q), model.phi_t(t, q)]) if model.m and model.needs.driven else np.zeros(0)


def _way(model, state, r, span, counts):
    """How far r moves the state within the time `span`, s: the largest of |dq|, infinite where that cannot be told."""
    system, still = model.step_matrix(), np.zeros(model.n)
    counts.tangents += 1
    counts.factorizations += 1
    try:
        system.factor(state.t, state.q, still, still, state.lam, 1.0 / span**2, 0.0)
        dq, _ = system.saddle(state.t, state.q, state.lam, r, np.zeros(model.m))
    except SingularSystem:
        return np.inf
    counts.solves += system.solves + 1
    counts.backend = system.backend
    return np.abs(dq).max()
