"""A run that is taken again: all of its steps, or, where memory is short, checkpoints between which it is taken a third time."""

from typing import NamedTuple

import numpy as np

from polyida.errors import InputError

SAME = 1e-9  # steps that differ by less of their size are equal
NUMBERS = 10  # of a State's vectors of n numbers, its memory with them


class Piece(NamedTuple):
    """Equal steps of h from state number `first` on, `count` of them.

    kind: how they began: "begin", as a run does, "cut", as within a step that failed, or "on", behind steps of `before`, s.
    """

    kind: str
    before: float
    h: float
    first: int
    count: int  # type: ignore[assignment]  # a tuple has a method of this name, of no use here

    def memory(self, ahead):
        """What generalized-alpha's memory holds of the steps before; ahead: the algorithmic acceleration that they left."""
        return {"begin": {}, "cut": {"cut": 1.0, "h": 0.0}, "on": {"a_alg": ahead, "h": self.before}}[self.kind]


class Room(NamedTuple):
    """What may be held: `steps`, where it is all of a run's; else `between` two checkpoints, and `checkpoints` of these. limit: in bytes."""

    steps: float
    between: float
    checkpoints: float
    limit: float

    @classmethod
    def of(cls, model, memory_limit, repeats):
        """Of a number of bytes, half of them for checkpoints where these are of use, since steps behind them repeat."""
        frame, half = 8 * (3 * model.n + model.m), memory_limit / 2
        if not repeats:
            return cls(memory_limit / frame, np.inf, np.inf, memory_limit)
        return cls(memory_limit / frame, half / frame / 2, half / (8 * NUMBERS * model.n), memory_limit)


class Recorded:
    """What the engine of a run says of its beginnings and steps; attempts that failed are forgotten.

    states: {number: State}, of all steps, or None where these have no room. checkpoints: those of them that a run can go on from. times: of
    the states from number `first` on.
    """

    def __init__(self, state, room, first=0):
        self.room, self.first, self.times, self.pieces, self.moving = room, first, [state.t], [], "a_alg" in state.memory
        self.states, self.checkpoints = {first: state}, {first: state}

    @property
    def last(self):
        """The number of the last state."""
        return self.first + len(self.times) - 1

    def begun(self, ready, h):
        """Steps of h begin at a state."""
        self._forget(ready.t)
        last = self.pieces[-1] if self.pieces else None
        kind = "cut" if "cut" in ready.memory else "on" if last and self.moving else "begin"
        self.pieces.append(Piece(kind, last.h if last else 0.0, h, self.last, 0))
        self.moving = True

    def stepped(self, state):
        """A step ended."""
        self.times.append(state.t)
        if self.states is not None:
            self.states[self.last] = state
        self.pieces[-1] = self.pieces[-1]._replace(count=self.pieces[-1].count + 1)

    def accepted(self, state):
        """A step of the run ended: one at rest, where nobody stepped."""
        if state.t > self.times[-1]:
            h, last = state.t - self.times[-1], self.pieces[-1] if self.pieces else None
            if self.moving or not last or abs(last.h - h) > SAME * h:
                self.pieces.append(Piece("on" if self.moving else "begin", last.h if last else 0.0, h, self.last, 0))
            self.stepped(state)
            self.moving = False
        if state.restart and self.last - max(self.checkpoints) >= self.room.between:
            self.checkpoints[self.last] = state
        if self.states is not None and len(self.states) > self.room.steps:
            self.states = None
        if self.states is None and len(self.checkpoints) > self.room.checkpoints:
            raise InputError(
                f"gradient: memory_limit = {self.room.limit:.3g} bytes has no room for checkpoints of the {self.last} steps so far; allow more"
            )

    def _forget(self, t):
        """All that came after t, of an attempt that failed."""
        while self.times[-1] > t:
            if self.states is not None:
                del self.states[self.last]
            self.times.pop()
            self.pieces[-1] = self.pieces[-1]._replace(count=self.pieces[-1].count - 1)
            self._drop_empty()
        self._drop_empty()

    def _drop_empty(self):
        while self.pieces and not self.pieces[-1].count:
            self.pieces.pop()


class Segments:
    """The states of a recorded run: those it holds, or a segment behind a checkpoint, taken again and held till another is asked for.

    again: a function (Recorded) that gives the accepted states behind its first one.
    """

    def __init__(self, again, seen):
        self.again, self.checkpoints, self.end = again, seen.checkpoints, seen.last
        self.states = {} if seen.states is None else seen.states

    def vectors(self, first, end):
        """(q, v, a, lam) of the states from number `first` to before `end`, (count, .) each."""
        if first not in self.states or end - 1 not in self.states:
            self._take(first, end)
        part = [self.states[k] for k in range(first, end)]
        return tuple(np.array([getattr(state, name) for state in part]) for name in ("q", "v", "a", "lam"))

    def _take(self, first, end):
        start = max(k for k in self.checkpoints if k <= first)
        stop = min((k for k in self.checkpoints if k > max(first, end - 1)), default=self.end)
        self.states = {}
        kept = Recorded(self.checkpoints[start], Room(*[np.inf] * 4), start)
        for _ in self.again(kept):
            if kept.last >= stop:
                break
        self.states = kept.states
