"""The steps of a run and the start of each segment of equal steps, from its frames or by solving the run again.

If memory is short, checkpoints are stored, between which the run is solved a third time.
"""

from typing import Any, NamedTuple

import numpy as np

from polyida.errors import InputError
from polyida.integrate.discontinuities import number_of_steps, pieces
from polyida.integrate.state import Counts, State, States
from polyida.integrate.switches import steps_of
from polyida.io.layout import MEMORY_LIMIT

SAME = 1e-9  # relative difference below which steps are equal
NUMBERS = 10  # vectors of n numbers in a State, with its memory


class StepSegment(NamedTuple):
    """Equal steps of h from state number `first` on, `count` of them.

    kind: how they start: "begin", at the start of a run; "cut", within a failed step; "on", after steps of `before`, s.
    """

    kind: str
    before: float
    h: float
    first: int
    count: int  # type: ignore[assignment]  # a tuple has a method of this name, of no use here

    def memory(self, ahead):
        """Generalized-alpha's memory at the start of the segment; ahead: the algorithmic acceleration of the step before."""
        return {"begin": {}, "cut": {"cut": 1.0, "h": 0.0}, "on": {"a_alg": ahead, "h": self.before}}[self.kind]


class StepHistory(NamedTuple):
    """All accepted states of a run in order, with the initial one, and the segments between them.

    states: function (first, end) -> (t, q, v, a, lam) of these numbers. frames (states,): number of the frame of each state, or -1.
    """

    segments: list
    states: Any
    frames: np.ndarray


def stored_state(history, number, memory=None):
    """The State of a number, with the given memory."""
    t, *vectors = (x[0] for x in history.states(number, number + 1))
    return State(float(t), *vectors, memory or {})


class HistoryLimits(NamedTuple):
    """Limits of memory: `steps`, states if all are held; else states `between` two checkpoints, and `checkpoints`. limit: bytes."""

    steps: float
    between: float
    checkpoints: float
    limit: float

    @classmethod
    def of(cls, model, memory_limit, repeats):
        """Limits for a number of bytes, half of them for checkpoints if steps behind a checkpoint are reproducible (repeats)."""
        frame, half = 8 * (3 * model.n + model.m), memory_limit / 2
        if not repeats:
            return cls(memory_limit / frame, np.inf, np.inf, memory_limit)
        return cls(memory_limit / frame, half / frame / 2, half / (8 * NUMBERS * model.n), memory_limit)


class StepRecorder:
    """Records the segments and steps of a run; failed attempts are removed.

    states: {number: State} of all steps, or None if they exceed the memory. checkpoints: the states from which a run can continue. times:
    of the states from number `first` on.
    """

    def __init__(self, state, limits, first=0):
        """Begin with one State, of the number `first` among the run's states, and without segments; limits: the HistoryLimits of memory."""
        self.limits, self.first = limits, first
        self.times = [state.t]
        self.segments = []
        self.has_memory = "a_alg" in state.memory
        self.states = {first: state}
        self.checkpoints = {first: state}

    @property
    def last(self):
        """The number of the last state."""
        return self.first + len(self.times) - 1

    def begun(self, ready, h):
        """Start a segment of steps of h at a state."""
        self._forget(ready.t)
        last = self.segments[-1] if self.segments else None
        kind = "cut" if "cut" in ready.memory else "on" if last and self.has_memory else "begin"
        self.segments.append(StepSegment(kind, last.h if last else 0.0, h, self.last, 0))
        self.has_memory = True

    def stepped(self, state):
        """Record the end of a step."""
        self.times.append(state.t)
        if self.states is not None:
            self.states[self.last] = state
        self.segments[-1] = self.segments[-1]._replace(count=self.segments[-1].count + 1)

    def accepted(self, state):
        """Record an accepted state of the run, with its step if no engine reported one (a step at rest)."""
        if state.t > self.times[-1]:
            h, last = state.t - self.times[-1], self.segments[-1] if self.segments else None
            if self.has_memory or not last or abs(last.h - h) > SAME * h:
                self.segments.append(StepSegment("on" if self.has_memory else "begin", last.h if last else 0.0, h, self.last, 0))
            self.stepped(state)
            self.has_memory = False
        if state.restart and self.last - max(self.checkpoints) >= self.limits.between:
            self.checkpoints[self.last] = state
        if self.states is not None and len(self.states) > self.limits.steps:
            self.states = None
        if self.states is None and len(self.checkpoints) > self.limits.checkpoints:
            raise InputError(
                f"gradient: memory_limit = {self.limits.limit:.3g} bytes has no room for checkpoints of the {self.last} steps so far; allow more"
            )

    def _forget(self, t):
        """Remove all states after t, those of a failed attempt."""
        while self.segments and (self.times[-1] > t or not self.segments[-1].count):
            last = self.segments.pop()
            if last.count:
                if self.states is not None:
                    del self.states[self.last]
                self.times.pop()
                self.segments.append(last._replace(count=last.count - 1))


class CheckpointedStates:
    """The states of a recorded run: those in memory, else those behind a checkpoint, solved again and held until others are requested.

    again: function (StepRecorder) -> the accepted states behind its first one.
    """

    def __init__(self, again, recorder):
        """Take the checkpoints of a StepRecorder, and the states if all of them are in memory."""
        self.again = again
        self.checkpoints, self.end = recorder.checkpoints, recorder.last
        self.states = {} if recorder.states is None else recorder.states

    def vectors(self, first, end):
        """(q, v, a, lam) of the states from number `first` to before `end`, (count, .) each."""
        if first not in self.states or end - 1 not in self.states:
            start = max(k for k in self.checkpoints if k <= first)
            stop = min((k for k in self.checkpoints if k > max(first, end - 1)), default=self.end)
            self.states = {}
            recorder_behind = StepRecorder(self.checkpoints[start], HistoryLimits(*[np.inf] * 4), start)
            for _ in self.again(recorder_behind):
                if recorder_behind.last >= stop:
                    break
            self.states = recorder_behind.states
        part = [self.states[k] for k in range(first, end)]
        return tuple(np.array([getattr(state, name) for state in part]) for name in ("q", "v", "a", "lam"))


def step_history(run, model, memory_limit=MEMORY_LIMIT):
    """The StepHistory of a run: its frames if these are all of its steps, else by solving it again."""
    repeats = run.integrator.h is not None and not run.integrator.adaptive  # steps behind a checkpoint are those of the run, bit by bit
    if every_step(run) and repeats and not run.counts.rejected:
        return _of_frames(run, model)
    return replayed_history(run, model, memory_limit, _replayed_states, repeats)


def every_step(run):
    """True if the frames are the ends of all steps that did not fail."""
    return run.plan.get("every", 1) == 1 and not run.plan.get("output") and _stored_in_double(run) and run.status != "stopped"


def _stored_in_double(run):
    """True if frames are stored in double precision."""
    return run.plan.get("precision", "double") == "double"


def _of_frames(run, model):
    """The StepHistory of a run with fixed steps, whose ends depend on h and on kinks of the model only; every step is a frame.

    Raises InputError if the frames are not such steps of the model.
    """
    segments, done, has_memory = [], 0, False
    for begin, end, most in pieces(model, float(run.t[0]), run.plan.get("t_end", float(run.t[-1])), run.integrator.h):
        state = State(begin, *(np.asarray(x[done], float) for x in (run.q, run.v, run.a, run.lam)))
        count = number_of_steps(model, state, begin, end, min(run.integrator.h, most))
        h, count = (end - begin) / count, min(count, len(run) - 1 - done)
        vectors, resting = (run.q, run.v, run.a, run.lam), 0  # steps that leave the run at rest; behind these it begins anew
        while resting < count and not run.v[done + resting].any():
            if not all(np.array_equal(x[done + resting], x[done + resting + 1]) for x in vectors):
                break
            resting += 1
        for still, number in ((True, resting), (False, count - resting)):
            if number:
                segments.append(StepSegment("on" if has_memory else "begin", segments[-1].h if segments else 0.0, h, done, number))
                done, has_memory = done + number, not still
        if done >= len(run) - 1:
            break
    for _, _, h, first, count in segments:
        if abs(run.t[first + count] - run.t[first] - count * h) > SAME * h * count:
            raise InputError(f"gradient: the run's frames from t = {run.t[first]:.9g} s on are not steps of {h:.6g} s of its model")
    return StepHistory(segments, frame_reader(run), np.arange(len(run)))


def frame_reader(run):
    """A function (first, end) that returns the run's own frames."""
    arrays = run.t, run.q, run.v, run.a, run.lam
    return lambda first, end: tuple(np.asarray(x[first:end], float) for x in arrays)


def replayed_history(run, model, memory_limit, accepted, repeats):
    """The StepHistory of a run that is solved again.

    accepted: function (run, model, StepRecorder) that yields the states behind the first one of the recorder, and records all steps.
    repeats: True if the states behind a checkpoint are the same bit by bit. Raises InputError if forces jump at a switch, if frames are no
    states of the steps, and if memory is short.
    """
    begin = State(float(run.t[0]), *(np.array(x[0], float) for x in (run.q, run.v, run.a, run.lam)))
    recorder = StepRecorder(begin, HistoryLimits.of(model, memory_limit, repeats))
    for state in accepted(run, model, recorder):
        if state.memory.get("jumped"):
            raise InputError(
                f"gradient: the forces jump at t = {state.t:.6g} s, where a gap changes sign or the shortest step is too long for a contact; "
                "slopes are taken with the times of switches held, "
                "which is right for continuous forces only; use a force that grows from zero at its gap, or differences of runs"
            )
        if state.t >= run.t[-1]:
            break
    t = np.array(recorder.times)
    frames = np.searchsorted(run.t, t)
    frames[~np.isin(t, run.t)] = -1
    if len(np.unique(frames[frames >= 0])) < len(run):
        lost = np.setdiff1d(np.arange(len(run)), frames)[0]
        raise InputError(
            f"gradient: the frame at t = {run.t[lost]:.9g} s lies between two steps, or another run's; keep the ends of steps: "
            "solve without `output` and `until`"
        )
    if recorder.states is None and not repeats:
        if not ((frames >= 0).all() and _stored_in_double(run)):
            raise InputError(
                f"gradient: memory_limit = {memory_limit:.3g} bytes has no room for the {len(frames) - 1} steps of the run, and adaptive steps "
                "cannot be taken again from checkpoints; allow more, or keep every step as a frame"
            )
        return StepHistory(recorder.segments, frame_reader(run), frames)
    stored = CheckpointedStates(lambda again: accepted(run, model, again), recorder)
    return StepHistory(recorder.segments, lambda first, end: (t[first:end], *stored.vectors(first, end)), frames)


def _replayed_states(run, model, recorder):
    """Yield the accepted states of the run behind the first one of the recorder, and record all steps."""
    counts = Counts()
    own = lambda settings, state, t_end: States(settings.in_pieces(model, state, t_end, counts, recorder=recorder), counts)  # noqa: E731
    for state in steps_of(own, run.integrator, model, recorder.states[recorder.first], run.plan["t_end"], counts):
        recorder.accepted(state)
        yield state
