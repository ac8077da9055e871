"""What frames do not hold of a run's steps: what each piece began with, and the algorithmic acceleration, made again from the frames."""

from collections import deque
from typing import NamedTuple

import numpy as np

from polyida.integrate.alpha.start import started
from polyida.integrate.state import State

AT_ONCE = 64  # steps that are read at once


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
