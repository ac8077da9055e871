"""What a run's steps began from: made again from its frames with what these do not hold, and its adjoint.

The adjoint is taken on a tape from the method's own code (integrate/alpha/start.py, integrate/start.py).
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from polyida.adjoint.alpha.plain import Sent
from polyida.adjoint.taped.model import TapedModel
from polyida.adjoint.taped.tape import Tape, add_to
from polyida.integrate.alpha.start import started
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import State

AT_ONCE = 64  # steps that are read at once
NEAR = 1e-9  # of |v|: a start's velocity that far from the bodies' own was given


class Ready(NamedTuple):
    """A piece's beginning: the state, with what it had of the method's memory, and q, v, a and A that the first step began with."""

    state: State
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ahead: np.ndarray


class Forward:
    """Of a course: `ready[piece.first]`, and `slips(piece)`, what the stabilised form added to q in each of its steps."""

    def __init__(self, model, settings, course):
        self.model, self.settings, self.course, self.ready, ahead = model, settings, course, {}, None
        for piece in course.pieces:
            self.ready[piece.first] = self._ready(piece, ahead)
            ahead = deque(self._steps(piece), maxlen=1).pop()[1]

    def _ready(self, piece, ahead):
        state = beginning(self.course, piece, ahead)
        ready = started(self.settings, self.model, state, piece.h)
        return Ready(state, ready.q, ready.v, ready.a, ready.memory["a_alg"])

    def _steps(self, piece):
        """(slip, A) at the end of each step of a piece: `slip = q_1 - (q_0 + h v_0 + h^2 ((1/2 - beta) A_0 + beta A_1))`."""
        (_, q, v, a, ahead), c, h = self.ready[piece.first], self.settings.coefficients, piece.h
        for q1, v1, a1 in self._ends(piece):
            ahead_1 = ((1 - c.alpha_f) * a1 + c.alpha_f * a - c.alpha_m * ahead) / (1 - c.alpha_m)
            yield q1 - (q + h * v + h * h * ((0.5 - c.beta) * ahead + c.beta * ahead_1)), ahead_1
            q, v, a, ahead = q1, v1, a1, ahead_1

    def _ends(self, piece):
        """(q, v, a) at the end of each step of a piece, of which few are read at once."""
        end = piece.first + piece.count + 1
        for first in range(piece.first + 1, end, AT_ONCE):
            _, *vectors, _ = self.course.states(first, min(first + AT_ONCE, end))
            yield from zip(*vectors)

    def slips(self, piece):
        """(count, n)."""
        return np.array([slip for slip, _ in self._steps(piece)])


def beginning(course, piece, ahead):
    """The State that a piece's steps begin from, with the memory that its kind has; ahead: A that the steps before left."""
    t, *vectors = (x[0] for x in course.states(piece.first, piece.first + 1))
    return State(float(t), *vectors, piece.memory(ahead))


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
