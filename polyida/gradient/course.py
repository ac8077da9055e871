"""The steps that a run of generalized-alpha took, and what each stretch of equal ones began from: in its frames, or run again."""

from typing import NamedTuple

import numpy as np

from polyida.errors import InputError
from polyida.integrate.kinks import enough_steps, stretches
from polyida.integrate.state import Counts, State

SAME = 1e-9  # steps that differ by less of their size are equal


class Piece(NamedTuple):
    """Equal steps of h from state number `first` on, `count` of them.

    kind: how they began: "begin", as a run does, "cut", as within a step that failed, or "on", behind steps of `before`, s.
    """

    kind: str
    before: float
    h: float
    first: int
    count: int


class Course(NamedTuple):
    """All accepted states of a run in order, its beginning first, and the pieces between them.

    states: a function (first, end) -> (t, q, v, a, lam) of those numbers. frames (states,): which frame of the run each is, or -1.
    """

    pieces: list
    states: object
    frames: np.ndarray


def course_of(run, model, progress=None, memory_limit=None):
    """The Course of a run: read from its frames where these are all of its steps, run again otherwise."""
    return _of_frames(run, model) if _whole(run) else _again(run, model)


def _whole(run):
    """Whether the frames are the ends of all steps, of steps that nothing but h and kinks chose."""
    plan, settings = run.plan, run.integrator
    every = plan.get("every", 1) == 1 and not plan.get("output") and plan.get("precision", "double") == "double"
    return every and settings.h is not None and not settings.adaptive and not run.counts.rejected and run.status != "stopped"


def _of_frames(run, model):
    pieces, done, h = [], 0, 0.0
    for begin, end, most in stretches(model, float(run.t[0]), run.plan.get("t_end", float(run.t[-1])), run.integrator.h):
        state = State(begin, *(np.asarray(x[done], float) for x in (run.q, run.v, run.a, run.lam)))
        count = enough_steps(model, state, begin, end, min(run.integrator.h, most))
        size = (end - begin) / count
        pieces.append(Piece("on" if pieces else "begin", h, size, done, min(count, len(run) - 1 - done)))
        done, h = done + count, size
        if done >= len(run) - 1:
            break
    _require_steps(run, pieces)
    arrays = run.t, run.q, run.v, run.a, run.lam
    return Course(pieces, lambda first, end: tuple(np.asarray(x[first:end], float) for x in arrays), np.arange(len(run)))


def _require_steps(run, pieces):
    """Raise InputError where the frames are not at the ends of the pieces' steps: the run is of another model or integrator."""
    for piece in pieces:
        if abs(run.t[piece.first + piece.count] - run.t[piece.first] - piece.count * piece.h) > SAME * piece.h * piece.count:
            raise InputError(
                f"gradient: the run's frames from t = {run.t[piece.first]:.9g} s on are not steps of {piece.h:.6g} s of its model"
            )


def _again(run, model):
    begin = State(float(run.t[0]), *(np.array(x[0], float) for x in (run.q, run.v, run.a, run.lam)))
    seen = Recorded(begin)
    for state in run.integrator.in_pieces(model, begin, run.plan["t_end"], Counts(), watch=seen):
        seen.accepted(state)
        if state.t >= run.t[-1]:
            break
    return of_states(run, seen.states, seen.pieces)


def of_states(run, states, pieces):
    """The Course of a run that was run again. Raises InputError where a frame is no state of the steps."""
    t = np.array([state.t for state in states])
    frames = np.searchsorted(run.t, t)
    frames[~np.isin(t, run.t)] = -1
    _require_frames(run, frames)

    def read(first, end):
        part = states[first:end]
        return t[first:end], *(np.array([getattr(state, name) for state in part]) for name in ("q", "v", "a", "lam"))

    return Course(pieces, read, frames)


def _require_frames(run, frames):
    """Raise InputError where a frame is no state of the steps."""
    if len(np.unique(frames[frames >= 0])) < len(run):
        lost = np.setdiff1d(np.arange(len(run)), frames)[0]
        raise InputError(
            f"gradient: the frame at t = {run.t[lost]:.9g} s lies between two steps, or another run's; keep the ends of steps: "
            "solve without `output` and `until`"
        )


class Recorded:
    """What the engine of a run says of its beginnings and steps; attempts that failed are forgotten."""

    def __init__(self, state):
        self.states, self.pieces, self.moving = [state], [], False

    def begun(self, ready, h):
        """Steps of h begin at a state."""
        self._forget(ready.t)
        last = self.pieces[-1] if self.pieces else None
        kind = "cut" if "cut" in ready.memory else "on" if last and self.moving else "begin"
        self.pieces.append(Piece(kind, last.h if last else 0.0, h, len(self.states) - 1, 0))
        self.moving = True

    def stepped(self, state):
        """A step ended."""
        self.states.append(state)
        self.pieces[-1] = self.pieces[-1]._replace(count=self.pieces[-1].count + 1)

    def accepted(self, state):
        """A step of the run ended: one at rest, where nobody stepped."""
        if state.t > self.states[-1].t:
            h, last = state.t - self.states[-1].t, self.pieces[-1] if self.pieces else None
            if self.moving or not last or abs(last.h - h) > SAME * h:
                self.pieces.append(Piece("on" if self.moving else "begin", last.h if last else 0.0, h, len(self.states) - 1, 0))
            self.stepped(state)
            self.moving = False

    def _forget(self, t):
        """All that came after t, of an attempt that failed."""
        while self.states[-1].t > t:
            self.states.pop()
            self.pieces[-1] = self.pieces[-1]._replace(count=self.pieces[-1].count - 1)
            self._drop_empty()
        self._drop_empty()

    def _drop_empty(self):
        while self.pieces and not self.pieces[-1].count:
            self.pieces.pop()
