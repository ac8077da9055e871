"""What the stabilised form added to q in each step: the frames less Newmark's formula, with the algorithmic acceleration made again."""

import numpy as np

from polyida.integrate.alpha.start import started
from polyida.integrate.state import State


class Slips:
    """Of a course: `of(piece)` gives `q_1 - (q_0 + h v_0 + h^2 ((1/2 - beta) A_0 + beta A_1))` of its steps, (count, n)."""

    def __init__(self, model, settings, course):
        self.model, self.settings, self.course, self.begun, ahead = model, settings, course, {}, None
        for piece in course.pieces:
            q, v, a, ahead = self.begun[piece.first] = self._ready(piece, ahead)
            for _, ahead in self._steps(piece):
                pass

    def _ready(self, piece, ahead):
        """(q, v, a, A) that a piece's first step began with; ahead: A that the piece before it left."""
        t, q, v, a, lam = (x[0] for x in self.course.states(piece.first, piece.first + 1))
        memory = {"begin": {}, "cut": {"cut": 1.0, "h": 0.0}, "on": {"a_alg": ahead, "h": piece.before}}[piece.kind]
        ready = started(self.settings, self.model, State(float(t), q, v, a, lam, memory), piece.h)
        return ready.q, ready.v, ready.a, ready.memory["a_alg"]

    def _steps(self, piece):
        """(slip, A) at the end of each step of a piece."""
        (q, v, a, ahead), c, h = self.begun[piece.first], self.settings.coefficients, piece.h
        _, qs, vs, accelerations, _ = self.course.states(piece.first + 1, piece.first + piece.count + 1)
        for q1, v1, a1 in zip(qs, vs, accelerations):
            ahead_1 = ((1 - c.alpha_f) * a1 + c.alpha_f * a - c.alpha_m * ahead) / (1 - c.alpha_m)
            yield q1 - (q + h * v + h * h * ((0.5 - c.beta) * ahead + c.beta * ahead_1)), ahead_1
            q, v, a, ahead = q1, v1, a1, ahead_1

    def of(self, piece):
        """Slips of a piece's steps, (count, n)."""
        return np.array([slip for slip, _ in self._steps(piece)])
