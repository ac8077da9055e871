"""How large and how fast a motion is, told from its first state: what absolute tolerances are a share of."""

import numpy as np

MOVES = 1e-6  # of its length: a model whose first state takes it less far in the whole run stands still


def typical_sizes(model, state, span):
    """(length, speed): absolute tolerances of q and v are rtol times these; the state is consistent, `span` is the run's time, s.

    length: a scene's extent, m; of a model of one's own |q|, or, where q is zero, the way to where its stiffness turns it round.
    speed: the largest of |v|, `sqrt(|a| length)` and, in a scene, `sqrt(g length)`; length/span where nothing of these moves
    it at first. |x| is the root mean square. Multiplied alike by any change of the units of length or time.
    """
    v, a = _rms(state.v), _rms(state.a)
    length = model.extent or _rms(state.q) or _way(model, state, span, v, a)
    speed = max(v, np.sqrt(max(a, model.free_fall) * length))
    return np.array([length, speed if speed * span > MOVES * length else length / span])


def _way(model, state, span, v, a):
    """How far v and a lead from q = 0 within the run or 1/w, `w^2 = |d^T K d| / |d^T M d|` with d along v or a; 1 where nowhere."""
    d = state.v if v else state.a
    stiffness = model.tangent(state.t, state.q, state.v, state.a, state.lam, 0.0, 0.0, 1.0)
    mass, spring = (abs(d @ (matrix @ d)) for matrix in (model.mass(state.q), stiffness))
    time = min(span, np.sqrt(mass / spring)) if spring > 0 else span
    return v * time + a * time**2 or 1.0


def _rms(x):
    return float(np.sqrt(x @ x / max(1, x.size)))
