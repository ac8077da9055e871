"""How large, how fast and how long a motion is, told from its first state: what tolerances are chosen by."""

import numpy as np

AT = (np.arange(32) + 0.5) / 32  # of the run's time: where motors are looked at
MOVES = 1e-6  # of its length: a model whose first state takes it less far in the whole run stands still
# constants of compiled code
ROUND_OFF = 64 * 2.0**-52  # of the numbers that phi is made of: |phi| that is mere round-off
LEAST = 1e-10  # relative tolerance that is chosen by itself
NOTHING = 1e-12  # m: a |q| of less is what is left of a start at zero that was moved onto its constraints


def typical_sizes(model, state, span):
    """(length, speed): absolute tolerances of q and v are rtol times these; the state is consistent, `span` is the run's time, s.

    length: a scene's extent, m; of a model of one's own |q|, or, where q is zero, the way to where its stiffness turns it round.
    speed: the largest of |v|, `sqrt(|a| length)` and, in a scene, `sqrt(g length)`; length/span where there is no weight and
    nothing of these moves it at first; where motors turn, the length times their largest rate too, and that of paths. |x| is the root mean
    square. Multiplied alike by any change of the units of length or time.
    """
    q, v, a = _rms(state.q), _rms(state.v), _rms(state.a)
    length = model.extent or (q if q > NOTHING else _way(model, state, span, v, a))
    driven = max(length * _fastest(model, model.motor_profiles, state.t, span), _fastest(model, model.path_profiles, state.t, span))
    speed = max(v, np.sqrt(max(a, model.free_fall) * length), driven)
    return np.array([length, speed if model.free_fall or speed > MOVES * length / span else length / span])


def sizes_of_run(model, state, t_end):
    """(length, speed, time, ways) of the run that a state is of, as that took them, or of one that begins with it; m, m/s, s.

    ways: how often the motion goes its own length in that time, the same in whatever units the coordinates are. Where there is more to
    come than that run was long, time and ways are those of what is to come.
    """
    kept, span = state.memory.get("sizes", ()), t_end - state.t
    if len(kept) == 4:
        more = max(1.0, span / kept[2])
        return np.array(kept, float) * (1.0, 1.0, more, more)
    length, speed = kept if len(kept) else typical_sizes(model, state, span)
    pace = speed / length if model.extent else _own_pace(model, state) or speed / length
    return np.array([length, speed, span, span * pace], float)


def _own_pace(model, state):
    """How often a second the motion of a model of one's own goes its |q|, by norms that weigh coordinates by their mass; 0 from q = 0."""
    shares = weights(model, state.q)
    q, v, a = (float(np.sqrt(shares @ x**2)) for x in (state.q, state.v, state.a))
    return max(v / q, np.sqrt(a / q)) if q > NOTHING else 0.0


def relative_tolerance(aim, most, ways):
    """`aim`, or less where the motion goes its length more than `most` times: what is left of each step adds up over the run."""
    return max(LEAST, aim * min(1.0, most / ways))


def chosen(rtol, ways):
    """In words, a relative tolerance that a run took from its length."""
    enough = "" if rtol > LEAST else ", the least that is chosen by itself: the error may be larger"
    return f"rtol {rtol:.1e} for a way of {ways:.2g} times the model's length{enough}"


def _fastest(model, profiles, t, span):
    """The largest rate of profiles of a scene in the run, at 32 times of it, rad/s or m/s."""
    return max(float(np.abs(model.drives(at)[profiles, 1]).max(initial=0.0)) for at in t + span * AT) if len(profiles) else 0.0


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
