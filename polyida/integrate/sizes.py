"""How large and how fast a motion is, told from its first state: what absolute tolerances are a share of."""

import numpy as np

AT = (np.arange(32) + 0.5) / 32  # of the run's time: where motors are looked at
MOVES = 1e-6  # of its length: a model whose first state takes it less far in the whole run stands still
ROUND_OFF = 64 * 2.0**-52  # of the numbers that phi is made of: |phi| that is mere round-off
NOTHING = 1e-12  # m: a |q| of less is what is left of a start at zero that was moved onto its constraints


def typical_sizes(model, state, span):
    """(length, speed): absolute tolerances of q and v are rtol times these; the state is consistent, `span` is the run's time, s.

    length: a scene's extent, m; of a model of one's own |q|, or, where q is zero, the way to where its stiffness turns it round.
    speed: the largest of |v|, `sqrt(|a| length)` and, in a scene, `sqrt(g length)`; length/span where there is no weight and
    nothing of these moves it at first; where motors turn, the length times their largest rate too. |x| is the root mean square. Multiplied alike by any change of the units of length or time.
    """
    q, v, a = _rms(state.q), _rms(state.v), _rms(state.a)
    length = model.extent or (q if q > NOTHING else _way(model, state, span, v, a))
    speed = max(v, np.sqrt(max(a, model.free_fall) * length), length * _fastest_turn(model, state.t, span))
    return np.array([length, speed if model.free_fall or speed > MOVES * length / span else length / span])


def _fastest_turn(model, t, span):
    """The largest angular speed of a scene's motors in the run, at 32 times of it, rad/s."""
    motors = model.motor_profiles
    return max(float(np.abs(model.drives(at)[motors, 1]).max(initial=0.0)) for at in t + span * AT) if len(motors) else 0.0


def _way(model, state, span, v, a):
    """How far v and a lead from q = 0 within the run or 1/w, `w^2 = |d^T K d| / |d^T M d|` with d along v or a; 1 where nowhere."""
    d = state.v if v else state.a
    stiffness = model.tangent(state.t, state.q, state.v, state.a, state.lam, 0.0, 0.0, 1.0)
    mass, spring = (abs(d @ (matrix @ d)) for matrix in (model.mass(state.q), stiffness))
    time = min(span, np.sqrt(mass / spring)) if spring > 0 else span
    return v * time + a * time**2 or 1.0


def _rms(x):
    return float(np.sqrt(x @ x / max(1, x.size)))


def weights(model, q):
    """Shares (n,) of the coordinates in a mean square, `M_ii / sum M_ii`: whatever the unit that each is in.

    So the local errors of unlike coordinates, a length, an angle, another length in other units, add up to one number.
    """
    masses = np.abs(model.mass(q).diagonal())
    total = masses.sum()
    return masses / total if total > 0 else np.full(model.n, 1.0 / model.n)


def extent(model, q):
    """Size of the numbers that phi is made of, m: displacements, and distances within the model, wherever it lies."""
    return (model.extent or 1.0) + float(np.abs(q).max(initial=0.0))
