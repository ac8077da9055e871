"""One run in progress: steps become frames, and however it ends, the states so far are returned as a trajectory."""

import signal
import threading
import time
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from itertools import islice

import numpy as np

from polyida.clock import clock
from polyida.environment import machine_info
from polyida.errors import StepFailure
from polyida.event import Events, Happened
from polyida.integrate.discontinuities import unseen
from polyida.integrate.left_out import LeftOut
from polyida.integrate.singular import SingularPosition, Watch
from polyida.integrate.state import Counts, Restart, State, States, Stretch, declared, parted
from polyida.integrate.switches import unresolved
from polyida.io.save import behind_blocks, commit
from polyida.io.writer import NotWritten
from polyida.model.guarded import guard
from polyida.progress import over_time
from polyida.run.accepted import Sampler, Until, accepted
from polyida.run.events import Change
from polyida.run.jumps import JUMP_IN_V, Jumps
from polyida.sensor import Sensors
from polyida.trajectory import Trajectory

FLUSH_SECONDS = 2.0
MANY = 2**62  # steps, more than a stretch has


class Run:
    """A run in progress.

    plan: the arguments of `solve` as plain data. store: a FrameStore, whose file, if it has one, is flushed as the plan says. recorder: of
    sensors. begun: clock() at the start. until, progress: the user's functions or None. happenings: of events, or None. events: those so far of a run
    without happenings: impacts. restart: the last state from which the
    run can be continued; flushed: that in the file.
    """

    def __init__(self, model, integrator, plan, store, recorder, counts, begun, until=None, progress=None, happenings=None, events=None):
        self.model, self.known, self.integrator, self.method = model, guard(model), integrator, declared(integrator)
        self.plan, self.store, self.counts, self.recorder, self.begun = plan, store, counts, recorder, begun
        self.until, self.progress, self.streams, self.happenings = until, progress, store.file is not None, happenings
        self.events = happenings.happened if happenings else Events() if events is None else events
        self.sampler = Sampler(store, counts, plan["every"], plan["output"], store.count, None if happenings else self.known)
        self.last = self.restart = self.flushed = self.watch = self.recorded = self.jumps = None
        self.flushed_steps, self.flushed_at = counts.steps, time.monotonic()
        self.memory = {}  # of the last state that had one: behind events it is empty

    def begin(self, state, overwrite):
        """Store the first state, and put the file in its place if there is one. Raises InputError if that is not possible."""
        with self.store.file.publishing(overwrite) if self.streams else nullcontext():
            self.sampler.start(state)
            self.last, self.restart = state, Restart(state, self.store.count, vars(self.counts).copy())
            if self.streams:
                self._flush()

    def go(self, state):
        """Run to the end and return the Trajectory.

        An exception of a user's function is raised with the Trajectory as an attribute; so is Ctrl-C after the last step.
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
        self.last = state
        try:
            bar = over_time(self.progress, state.t, self.plan["t_end"]) if self.progress else nullcontext()
            with bar as self.progress:
                status, message = self._steps(state, presses)
        except StepFailure as failure:
            looks = self.watch and not isinstance(failure, SingularPosition)
            suspicion = self.watch.suspicion(failure.t) if looks else ""
            jump = self.jumps.found(self.last) if self.jumps and failure.status != JUMP_IN_V else ""
            status, message = failure.status, f"{failure}{suspicion}{'; ' * bool(jump)}{jump}"
        except KeyboardInterrupt:
            presses.heeded = True
            status, message = "interrupted", f"interrupted after t = {self.last.t:.9g} s"
        except NotWritten as error:
            return self._result(*self._cut_off(error, f"after t = {self.last.t:.9g} s"))
        except BaseException as error:
            with suppress(Exception):
                self._attach(error, self._end("error", f"{type(error).__name__}: {error}"))
            raise
        notes = unresolved(self.known, self.method, self.restart.state) if self.known.switching else ""
        return self._end(status, "; ".join(filter(None, (message, notes))))

    def _steps(self, state, presses):
        """Take all steps; returns (status, message). A stretch is processed in parts that end where a flush may be due.

        States of a part are looked at one by one only if `until` or a sensor must be.
        """
        until = Until(self.known, self.until, state, self.sampler.model) if self.until else None
        needs = self.known.needs
        if self.happenings:
            stretches = self.happenings.stretches(state, self.plan["t_end"], self.counts)
        else:
            stretches = accepted(self.method, self.known, state, self.plan["t_end"], self.counts, self.sampler.rows)
            if self.known.m and not self.known.row_laws and (needs.phi_q_varies or needs.driven):
                self.watch = Watch(self.known, state)
        left_out = LeftOut(self.happenings.mode if self.happenings else self.known)
        self.jumps = Jumps(self.known, self.counts, state.t, self.plan["t_end"])
        for stretch in stretches:
            if isinstance(stretch, Change):
                state = self._change(stretch)
                if stretch.stops:
                    return "stopped", stretch.stops
                left_out = LeftOut(self.happenings.mode)
                continue
            sound, failure = self.watch.look(stretch) if self.watch else (len(stretch), None)
            agreeing, contradiction = left_out.look(stretch)
            if agreeing < sound:
                sound, failure = agreeing, contradiction
            self.counts.steps -= len(stretch) - sound
            whole, done, quiet = stretch.part(0, sound), 0, 0  # quiet: states in front that need not be looked at one by one
            if self.progress is None:
                quiet = self.recorder.quiet(whole)
                quiet = min(quiet, until.quiet(whole)) if until and quiet else quiet

            def size():
                before_flush = self.plan["flush_every"] - (self.counts.steps - self.flushed_steps) if self.store.file else MANY
                return max(1, min(before_flush, quiet - done))  # noqa: B023, called within the loop

            for part in parted(whole, self.counts, size):
                after, begin = part.last, done
                done += len(part)
                at_zero = until.crossing(state, after) if until and done > quiet else None
                if done <= quiet:
                    self.recorder.record(begin, done)
                else:
                    self.recorder.step(after if at_zero is None else at_zero)
                if at_zero is not None:
                    self.sampler.step(state, Stretch.of(at_zero))
                    self.last = at_zero
                    self.sampler.keep(at_zero)
                    return "stopped", f"until changed its sign at t = {at_zero.t:.9g} s"
                self.sampler.step(state, part)
                if "impacts" in after.memory:
                    self._record_impacts(after)
                self.last = state = after
                self.memory = state.memory or self.memory
                if state.restart:
                    self.restart = Restart(state, self.store.count, vars(self.counts).copy())
                if self.store.file and self._due():
                    self._flush()
                if self.progress is not None:
                    self.progress(after.t)
                if presses.count:
                    raise KeyboardInterrupt
            if failure:
                self.counts.steps += 1
                raise failure
            self.jumps.look(stretch)
        return "done", unseen(self.known, self.method.fixed_step())

    def _change(self, change):
        """Store both sides of events. Returns the state behind them."""
        table, times = self.happenings.happened.happened, self.plan["output"]
        if times is None and change.before:
            self.sampler.keep(change.before)
        table[-len(change.happened) :] = [replace(one, frame=self.store.count) for one in change.happened]
        if times is None:
            self.sampler.keep(change.after)
        self.recorder.model, self.last = self.happenings.mode, change.after
        self.recorder.step(change.after)
        self.restart = Restart(change.after, self.store.count, vars(self.counts).copy())
        if self.store.file and self._due():
            self._flush()
        return change.after

    def _due(self):
        """True if a flush is due: as the plan says, or up to half as many steps later if a block of frames is complete by then."""
        steps, wait = self.counts.steps - self.flushed_steps, self.store.file.rows * self.plan["every"]
        late = max(steps / self.plan["flush_every"], (time.monotonic() - self.flushed_at) / FLUSH_SECONDS)
        return late >= 1.0 and (late >= 1.5 or 2 * wait > self.plan["flush_every"] or self.store.count == self.store.file.count)

    def _flush(self):
        self._commit("running", "", self.restart)
        self.flushed_steps, self.flushed_at = self.counts.steps, time.monotonic()

    def _commit(self, status, message, restart, last=False):
        rows = behind_blocks(self.store.file, self.recorder.rows)
        commit(self.store, status, message, self.counts, self._seconds(), restart, rows, last, self.events, self._settings_used())
        self.flushed, self.recorded = restart, self.recorder.count

    def _record_impacts(self, state):
        """Add the impacts of a step of time stepping to the events; several of one part are one."""
        past = self.events.happened
        base = past[-1] if past else Happened(state.t, "", 0.0, 0.0, 0, absent=tuple(self.events.first))
        of_parts = {}
        for number, impulse, lost in state.memory["impacts"]:
            of_parts.setdefault(self.known.row_laws[int(number)].name, []).append((impulse, lost))
        for name, values in of_parts.items():
            impulse, lost = float(max(value[0] for value in values)), float(sum(value[1] for value in values))
            past.append(replace(base, t=state.t, name=name, impulse=impulse, energy_lost=lost, frame=self.store.count - 1, impulses={}))

    def _seconds(self):
        """(CPU, wall, compiling) seconds since the start, see `clock`."""
        return tuple(now - begun for now, begun in zip(clock(), self.begun))

    def _settings_used(self):
        """{setting: value} of the integrator as the run used them; from the memory of the state that it went on from, if no step was taken."""
        return self.method.settings_used(self.memory or (self.restart.state.memory if self.restart else {}))

    def _attach(self, error, run):
        """Give the Trajectory to an exception that is raised to the caller."""
        error.trajectory = run
        where = f" and in {self.store.file.shown}" if self.streams else ""
        error.add_note(f"The run so far, {len(run)} frame{'s' * (len(run) != 1)}, is in this exception's attribute `trajectory`{where}.")

    def _end(self, status, message):
        """The Trajectory, and the file closed."""
        try:
            if status != "stopped" and not self.happenings:
                self._settle()
            if self.plan["output"] is None:
                self.sampler.keep(self.last)
            self.store.put_away()
            if self.store.file:
                self._commit(status, message, self.restart, last=True)
        except NotWritten as error:
            status, message = self._cut_off(error, f"{status} {message}")
        return self._result(status, message)

    def _settle(self):
        """Let the run be continued from its last state, also if that is within a compiled stretch: repeat the steps up to it."""
        begin, last = self.restart, self.last
        if begin is None or last.restart or not begin.state.t < last.t:
            return
        counts, end, s = Counts(**begin.counts), self.counts.steps, begin.state
        with suppress(Exception, KeyboardInterrupt):
            state = State(s.t, s.q, s.v, s.a, s.lam, s.memory | {"pause": end})
            steps = States(accepted(self.method, self.known, state, self.plan["t_end"], counts), counts)
            repeated = next(islice(steps, end - counts.steps - 1, None))
            # the same up to the round-off of steps that begin at another place of the grid
            same = abs(repeated.t - last.t) <= 1e-9 * (last.t - s.t) and np.abs(repeated.q - last.q).max() <= 1e-6 * np.abs(last.q).max()
            if repeated.restart and same:
                state = State(last.t, last.q, last.v, last.a, last.lam, repeated.memory)
                self.restart = Restart(state, self.store.count, vars(counts).copy())

    def _cut_off(self, error, detail):
        """(status, message) if the disk takes no more: the file has the frames that were committed."""
        status, message = error.status, f"{error}; {detail}"
        with suppress(NotWritten):
            if self.store.file:
                self._commit(status, message, self.flushed, last=True)
        return status, message

    def _result(self, status, message):
        cpu, wall, compiling = self._seconds()
        if self.streams and not self.store.file.in_place():
            gone = f"{self.store.file.shown} was removed or replaced: these frames are in no file"
            message = f"{message}; {gone}" if message else gone
        frames, restart = self.store.arrays(), self.flushed if self.streams else self.restart
        if restart and restart.frames > len(frames["t"]):
            restart = None
        if restart:  # in arrays of its own, not in those of the frames
            s = restart.state
            restart = restart._replace(state=State(s.t, s.q.copy(), s.v.copy(), s.a.copy(), s.lam.copy(), s.memory, s.restart))
        return Trajectory(
            self.model,
            self.integrator,
            **frames,
            status=status,
            message=message,
            counts=self.counts,
            cpu_seconds=cpu,
            wall_seconds=wall,
            compile_seconds=compiling,
            machine=machine_info(),
            restart=restart,
            plan=self.plan,
            sensors=Sensors(self.recorder.shapes, self.recorder.rows[: self.recorded].copy()),
            events=self.events,
            settings_used=self._settings_used(),
        )


_interruptions = [0]


class Presses:
    """Handler of SIGINT for one run. count: how often Ctrl-C was pressed. heeded: True if it ended the run."""

    def __init__(self):
        self.count, self.heeded = 0, False

    def __call__(self, number, frame):
        self.count += 1
        if self.count > 1:
            signal.default_int_handler(number, frame)
        _interruptions[0] += 1


@contextmanager
def noted():
    """Context of a run in which the first Ctrl-C waits until the step is done and a second one interrupts at once; gives its Presses.

    So a flush is not cut in two, and the exception is not lost in a place where Python ignores it. The context raises
    KeyboardInterrupt at its end if Ctrl-C was pressed and did not end the run, for example after its last step. A run within a run
    goes on after the first press, because the outer run may need its result; a second press ends both. It acts only in the main thread and
    if Python's own handler is in place.
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


def interruptions():
    """How often Ctrl-C was noted in this process: a run that it ended returns as any other, and a loop over runs must stop."""
    return _interruptions[0]
