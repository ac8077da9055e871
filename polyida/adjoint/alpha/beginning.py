"""The adjoint of what steps begin from: of a run's consistent start, of the state behind a kink, at another step, after a cut one.

All of it is taken on a tape from the method's own code (integrate/alpha/start.py, integrate/start.py).
"""

from typing import NamedTuple

import numpy as np

from polyida.adjoint.alpha.plain import Sent
from polyida.adjoint.taped.model import TapedModel
from polyida.adjoint.taped.tape import Tape, add_to
from polyida.integrate.alpha.start import started
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import State

NEAR = 1e-9  # of |v|: a start's velocity that far from the bodies' own was given


class Begun(NamedTuple):
    """Bars of a state before its steps begin: `sent` of q, v, a and the algorithmic acceleration, lam; entries for parameters' slopes."""

    sent: Sent
    lam: np.ndarray
    entries: list


def begun(settings, model, state, piece, sent):
    """The Begun of the state that a piece began with; sent: to what its first step began with."""
    tape = Tape()
    taped = TapedModel(model, tape)
    vectors = [tape.var(x) for x in (state.q, state.v, state.a, state.lam, state.a)]
    q, v, a, lam, ahead = vectors
    ready = started(settings, taped, State(state.t, q, v, a, lam, piece.memory(ahead)), piece.h)
    for var, bar in zip((ready.q, ready.v, ready.a, ready.memory["a_alg"]), sent):
        add_to(var, bar)
    tape.back()
    return Begun(Sent(q.bar, v.bar, a.bar, ahead.bar), lam.bar, taped.entries)


class First(NamedTuple):
    """Slopes in what a run was given: v0 (n,), before it was put on the constraints; entries for parameters' slopes."""

    v0: np.ndarray
    entries: list


def first(model, state, bars, lam):
    """The First of a run's consistent start (integrate/start.py); bars: a Sent, of its state, and lam (m,)."""
    tape = Tape()
    taped = TapedModel(model, tape)
    q, v0 = tape.var(state.q), tape.var(given_velocity(model, state)[0])
    v = on_velocity(taped, state.t, q, v0)
    a, multipliers = consistent_acceleration(taped, state.t, q, v)
    for var, bar in ((q, bars.q), (v, bars.v), (a, bars.a), (multipliers, lam)):
        add_to(var, bar)
    tape.back()
    if model.m and q.bar.any():
        _, nu = model.mass_system(state.t, state.q).solve(q.bar, np.zeros(model.m))
        taped.note(state.t, state.q, mu=nu)
    return First(v0.bar, taped.entries)


def given_velocity(model, state):
    """(velocities that a run which began with a state was given, whether they are the bodies' own)."""
    given = model.initial_velocity(state.t, state.q)
    consistent = on_velocity(model, state.t, state.q, given)
    own = np.abs(consistent - state.v).max() <= NEAR * max(np.abs(state.v).max(), 1e-300)
    return (given if own else state.v), own
