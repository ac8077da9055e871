"""The end of a unique friction force in a motion with slip: past it, a step may end at another solution, or at none.

`Slips.uniqueness` is positive while friction that slips has a unique force. Modes without slip are always unique.
"""

from polyida.integrate.state import State, between
from polyida.model.row_laws import Slipping

UNIQUE = 1e-7  # of `Slips.uniqueness`: below it forces are errors of the state, 1e7 times as large
CLOSE = 1e-4  # of the same: a step from there that ends at another solution ends there


def uniqueness(mode, before, state):
    """What is positive while friction that slips has a unique force at a state; rows press in the directions that they had `before`."""
    return mode.uniqueness(state, before.lam) if isinstance(mode, Slipping) else 1.0


def singular_in_step(mode, before, after):
    """The State of a step, or shortly after it, at which the friction has no unique force, or None.

    A step that comes near it may end at another solution, whose forces are not the consistent ones: the motion is then that before it.
    """
    from scipy.optimize import brentq

    unique = uniqueness(mode, before, after)
    reached = not unique > UNIQUE
    agrees = mode.press_direction_is_consistent(after)
    ahead = singular_ahead(mode, before, after.t - before.t) if reached or not agrees else None
    if ahead is None and (reached or (not agrees and unique < CLOSE)):
        if unique > 0.0:
            return after
        return between(before, after, brentq(lambda t: uniqueness(mode, before, between(before, after, t)), before.t, after.t))
    return ahead


def singular_ahead(mode, state, h, most=2.0):
    """The State at which the friction has no unique force up to `most` steps of h ahead, by the accelerations of a state, or None.

    They grow as `|t - t_s|^(-1/3)`, so that the error is of order 5/3 in h.
    """
    from scipy.optimize import brentq

    def unique_at(t):
        """The measure of a unique friction force at time t, extrapolated from the state."""
        return uniqueness(mode, state, _extrapolated(state, t))

    ends = [state.t, state.t + h, state.t + 2.0 * h, state.t + most * h]
    for begin, end in zip(ends, ends[1:]):
        if unique_at(end) <= 0.0:
            return _extrapolated(state, brentq(unique_at, begin, end))
    return None


def _extrapolated(state, t):
    """The State at t, near a state, extrapolated with its constant acceleration."""
    s = t - state.t
    return State(t, state.q + s * state.v + 0.5 * s * s * state.a, state.v + s * state.a, state.a, state.lam, restart=False)
