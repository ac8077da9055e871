"""One run in progress: steps become frames, and whatever ends it, what there is comes back as a trajectory."""

import signal
import threading
import time
from contextlib import contextmanager, suppress
from itertools import islice

import numpy as np

from polyida.environment import machine_info
from polyida.errors import StepFailure
from polyida.integrate.moves import unseen
from polyida.integrate.singular import SingularPosition, Watch
from polyida.integrate.state import Counts, Restart, State, States, Stretch, constant_step, parted
from polyida.integrate.switches import unresolved
from polyida.io.save import behind_blocks, commit
from polyida.io.writer import NotWritten
from polyida.model.guarded import guard
from polyida.progress import over_time
from polyida.run.accepted import accepted
from polyida.run.sampling import Sampler, Until
from polyida.sensor import Sensors
from polyida.trajectory import Trajectory

FLUSH_SECONDS = 2.0
MANY = 2**62  # steps, more than a stretch has


class Run:
    """A run on its way.

    plan: what was asked for, as plain data. store: a FrameStore; where it has a file, that is flushed as the plan
    says. recorder: of sensors. clocks: wall and CPU time at the start. until, progress: the user's functions or None.
    """

    def __init__(self, model, integrator, plan, store, recorder, counts, clocks, until=None, progress=None):
        self.model, self.known, self.integrator, self.plan, self.store, self.counts = model, guard(model), integrator, plan, store, counts
        self.recorder, self.clocks, self.until, self.progress = recorder, clocks, until, progress
        self.streams, done = store.file is not None, store.count
        self.sampler = Sampler(store, counts, plan["every"], plan["output"], done)
        self.last = self.restart = self.flushed = self.watch = self.sensed = None
        self.flushed_steps, self.flushed_at = counts.steps, time.monotonic()

    def begin(self, state, overwrite):
        """Keep the first state; a file gets it and comes to its place. Raises InputError where that cannot be done."""
        if not self.streams:
            self._start(state)
            return
        with self.store.file.publishing(overwrite):
            self._start(state)
            self._flush()

    def _start(self, state):
        self.sampler.start(state)
        self.last, self.restart = state, Restart(state, self.store.count, vars(self.counts).copy())

    def go(self, state):
        """Run to the end; returns the Trajectory.

        A user's exception goes on, with the Trajectory as an attribute; so does Ctrl-C if it came after the last step.
        """
        run = None
        try:
            with noted() as presses:
                run = self._run(state, presses)
        except KeyboardInterrupt as error:
            if run is not None:
                self._attach(error, run)
            raise
        return run

    def _run(self, state, presses):
        try:
            with over_time(self.progress, state.t, self.plan["t_end"]) as self.progress:
                status, message = self._steps(state, presses.heed)
        except StepFailure as failure:
            beside = "" if isinstance(failure, SingularPosition) else self.watch.suspicion(failure.t)
            status, message = failure.status, f"{failure}{beside}"
        except KeyboardInterrupt:
            presses.heeded = True
            status, message = "interrupted", f"interrupted after t = {self._reached(state):.9g} s"
        except NotWritten as error:
            return self._result(*self._cut_off(error, f"after t = {self._reached(state):.9g} s"))
        except BaseException as error:
            with suppress(Exception):
                self._attach(error, self._end("error", f"{type(error).__name__}: {error}"))
            raise
        return self._end(status, "; ".join(filter(None, (message, unresolved(self.known, self.integrator, self.restart.state)))))

    def _steps(self, state, heed):
        self.last, until = state, Until(self.until, state) if self.until else None
        self.watch = Watch(self.known, state)
        for stretch in accepted(self.integrator, self.known, state, self.plan["t_end"], self.counts, self.sampler.rows):
            sound, failure = self.watch.look(stretch)
            self.counts.steps -= len(stretch) - sound
            whole = stretch.part(0, sound)
            self.taken, self.quiet = 0, self._quiet(whole, until)
            for part in parted(whole, self.counts, self._size):
                after, begin = part.last, self.taken
                self.taken += len(part)
                quiet = self.taken <= self.quiet
                at_zero = until.crossing(state, after) if until and not quiet else None
                if quiet:
                    self.recorder.take(begin, self.taken)
                else:
                    self.recorder.step(after if at_zero is None else at_zero)
                if at_zero is not None:
                    self.sampler.step(state, Stretch.of(at_zero))
                    self.last = at_zero
                    self.sampler.keep(at_zero)
                    return "stopped", f"until changed its sign at t = {at_zero.t:.9g} s"
                self.sampler.step(state, part)
                self.last = state = after
                self._keep(after)
                if self.progress is not None:
                    self.progress(after.t)
                heed()
            if failure:
                self.counts.steps += 1
                raise failure
        return "done", unseen(self.known, constant_step(self.integrator))

    def _quiet(self, stretch, until):
        """How many states of a stretch need not be looked at one by one."""
        if self.progress is not None:
            return 0
        quiet = self.recorder.quiet(stretch)
        return min(quiet, until.quiet(stretch)) if until and quiet else quiet

    def _size(self):
        return max(1, min(self._steps_to_flush(), self.quiet - self.taken))

    def _steps_to_flush(self):
        """How many steps it takes until a flush may be due."""
        left = self.plan["flush_every"] - (self.counts.steps - self.flushed_steps) if self.store.file else MANY
        return max(1, left)

    def _keep(self, state):
        """Note where the run can go on; a flush where it is due."""
        if state.restart:
            self.restart = Restart(state, self.store.count, vars(self.counts).copy())
        if self.store.file and self._due():
            self._flush()

    def _due(self):
        """Whether to flush: as the plan says, or up to half as many steps later where a block of frames is whole by then."""
        steps, wait = self.counts.steps - self.flushed_steps, self.store.file.rows * self.plan["every"]
        late = max(steps / self.plan["flush_every"], (time.monotonic() - self.flushed_at) / FLUSH_SECONDS)
        return late >= 1.0 and (late >= 1.5 or 2 * wait > self.plan["flush_every"] or self.store.count == self.store.file.count)

    def _flush(self):
        self._commit("running", "", self.restart)
        self.flushed_steps, self.flushed_at = self.counts.steps, time.monotonic()

    def _commit(self, status, message, restart, last=False):
        sensed = behind_blocks(self.store.file, self.recorder.rows)
        commit(self.store, status, message, self.counts, self._seconds(), restart, sensed, last)
        self.flushed, self.sensed = restart, self.recorder.count

    def _seconds(self):
        wall, cpu = self.clocks
        return time.process_time() - cpu, time.perf_counter() - wall

    def _reached(self, state):
        return (self.last or state).t

    def _attach(self, error, run):
        """Hand the Trajectory to an exception that goes on to the caller."""
        error.trajectory = run
        where = f" and in {self.store.file.shown}" if self.streams else ""
        error.add_note(f"The run so far, {len(run)} frames, is in this exception's attribute `trajectory`{where}.")

    def _end(self, status, message):
        """The Trajectory, and the file closed."""
        try:
            if status != "stopped":
                self._settle()
            self.sampler.end(self.last)
            self.store.put_away()
            if self.store.file:
                self._commit(status, message, self.restart, last=True)
        except NotWritten as error:
            status, message = self._cut_off(error, f"{status} {message}")
        return self._result(status, message)

    def _settle(self):
        """Have the run go on from its last accepted state, also where that is in the middle of a compiled stretch."""
        begin, last = self.restart, self.last
        if begin is None or last.restart or not begin.state.t < last.t:
            return
        counts = Counts(**begin.counts)
        with suppress(Exception, KeyboardInterrupt):
            found = _again(self, begin.state, counts)
            if found.restart and _same(found, last, begin.state):
                state = State(last.t, last.q, last.v, last.a, last.lam, found.memory)
                self.restart = Restart(state, self.store.count, vars(counts).copy())

    def _cut_off(self, error, detail):
        """(status, message) where the disk takes no more: the frames in the file are those that hold."""
        status, message = error.status, f"{error}; {detail}"
        with suppress(NotWritten):
            if self.store.file:
                self._commit(status, message, self.flushed, last=True)
        return status, message

    def _result(self, status, message):
        cpu, wall = self._seconds()
        if self.streams and not self.store.file.in_place():
            gone = f"{self.store.file.shown} was removed or replaced: these frames are in no file"
            message = f"{message}; {gone}" if message else gone
        frames, restart = self.store.arrays(), self.flushed if self.streams else self.restart
        return Trajectory(
            self.model,
            self.integrator,
            **frames,
            status=status,
            message=message,
            counts=self.counts,
            cpu_seconds=cpu,
            wall_seconds=wall,
            machine=machine_info(),
            restart=_own(restart) if restart and restart.frames <= len(frames["t"]) else None,
            plan=self.plan,
            sensors=Sensors(self.recorder.shapes, self.recorder.rows[: self.sensed].copy()),
        )


def _own(restart):
    """A Restart whose state is in arrays of its own, not in those of the frames."""
    s = restart.state
    return restart._replace(state=State(s.t, s.q.copy(), s.v.copy(), s.a.copy(), s.lam.copy(), s.memory, s.restart))


def _again(run, state, counts):
    """The State after the steps of a run from `state` to its last, taken anew, with what the integrator goes on from."""
    end = run.counts.steps
    state = State(state.t, state.q, state.v, state.a, state.lam, state.memory | {"pause": end})
    steps = States(accepted(run.integrator, run.known, state, run.plan["t_end"], counts), counts)
    return next(islice(steps, end - counts.steps - 1, None))


def _same(found, last, begin):
    """Whether two States are one, up to the round-off of steps that begin at another place of the grid."""
    near = abs(found.t - last.t) <= 1e-9 * (last.t - begin.t)
    return near and np.abs(found.q - last.q).max() <= 1e-6 * np.abs(last.q).max()


_heard = [0]


class Presses:
    """Handler of SIGINT for one run. count: how often Ctrl-C was pressed. heeded: whether it ended the run."""

    def __init__(self):
        self.count, self.heeded = 0, False

    def __call__(self, number, frame):
        self.count += 1
        if self.count > 1:
            signal.default_int_handler(number, frame)
        _heard[0] += 1

    def heed(self):
        """Raise KeyboardInterrupt if Ctrl-C was pressed."""
        if self.count:
            raise KeyboardInterrupt


@contextmanager
def noted():
    """Context of a run in which Ctrl-C is noted; gives its Presses.

    So a flush is not cut in two, and the exception is not lost in a place where Python ignores it. The context raises
    KeyboardInterrupt at its end if Ctrl-C was pressed and did not end the run, for example after its last step. A run within a run
    goes on after the first press, because the outer run may need its result; a second press ends both. Only in the main thread and
    where Python's own handler is in place; elsewhere Ctrl-C does what it does.
    """
    before = signal.getsignal(signal.SIGINT) if threading.current_thread() is threading.main_thread() else None
    outer, presses = isinstance(before, Presses), Presses()
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, presses)
    try:
        yield presses
    finally:
        if before is signal.default_int_handler:
            signal.signal(signal.SIGINT, before)
        if (presses.count and not presses.heeded) or (outer and before.count > 1):
            raise KeyboardInterrupt


def heard():
    """How often Ctrl-C was noted in this process: a run that it ended comes back as any other, and who goes on to the next must know."""
    return _heard[0]
