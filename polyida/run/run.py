"""One run in progress: steps become frames, and however it ends, the states so far are returned as a trajectory.

The integrator gives step batches (Stretch), the EventHandler also Changes between them. A batch is checked, cut into parts, and each part goes
to the sampler (frames), the recorder (sensors) and, when a flush is due, to the file.
"""

import time
from contextlib import nullcontext, suppress
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
from polyida.run.accepted import accepted
from polyida.run.ctrl_c import noted
from polyida.run.event_search import Change
from polyida.run.jumps import JUMP_IN_V, Jumps
from polyida.run.recording import Sampler, Until
from polyida.sensor import Sensors
from polyida.trajectory import Trajectory

FLUSH_SECONDS = 2.0
MANY = 2**62  # steps, more than a stretch has


class Run:
    """A run in progress: `begin` stores its first state, `go` takes all steps and returns the Trajectory.

    plan: the arguments of `solve` as plain data. store: a FrameStore, whose file, if it has one, is flushed as the plan says. begun: clock() at
    the start. until, progress: the user's functions or None. handler: the EventHandler of a run with events, or None. events: those so far of
    a run that is resumed without one: impacts.
    """

    def __init__(self, model, integrator, plan, store, recorder, counts, begun, until=None, progress=None, handler=None, events=None):
        """Take the model, integrator, plan, storage and recorder of a run; begun: the `clock()` at its start. No step is taken."""
        self.model, self.known = model, guard(model)
        self.integrator, self.method = integrator, declared(integrator)
        self.plan, self.store = plan, store
        self.recorder = recorder  # of sensors
        self.counts, self.begun = counts, begun
        self.until, self.progress, self.handler = until, progress, handler
        self.streams = store.file is not None
        self.events = handler.happened if handler else Events() if events is None else events
        self.sampler = Sampler(store, counts, plan["every"], plan["output"], store.count, None if handler else self.known)
        self.last = None  # the last accepted State
        self.memory = {}  # of the last state that had one: behind events it is empty
        self.restart = None  # the last Restart, from which the run can be continued
        self.flushed = None  # the Restart in the file
        self.recorded = None  # number of sensor rows in the file
        self.watch = self.jumps = None  # Watch of singular positions, Jumps of the forces
        self.flushed_steps, self.flushed_at = counts.steps, time.monotonic()

    def begin(self, state, overwrite):
        """Store the first State as a frame and as the state to restart from; with a file flush it and put it at its path.

        overwrite: True if a file at that path may be replaced. Raises InputError if the file cannot be put there.
        """
        with self.store.file.publishing(overwrite) if self.streams else nullcontext():
            self.sampler.start(state)
            self.last = state
            self._set_restart(state)
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
        """Take all steps and end the run as it ended: at its end, by a failure, Ctrl-C, a full disk or an exception, which is raised again."""
        self.last = state
        try:
            bar = over_time(self.progress, state.t, self.plan["t_end"]) if self.progress else nullcontext()
            with bar as self.progress:
                status, message = self._steps(state, presses)
        except StepFailure as failure:
            status, message = failure.status, self._reason_of(failure)
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

    def _reason_of(self, failure):
        """Message of a StepFailure, with what was seen near it: a singular position, or forces that jump with the velocity."""
        reasons = [str(failure)]
        if self.jumps and failure.status != JUMP_IN_V:
            reasons.append(self.jumps.found(self.last))
        if self.watch and not isinstance(failure, SingularPosition):
            reasons[0] += self.watch.suspicion(failure.t)
        return "; ".join(filter(None, reasons))

    def _steps(self, state, presses):
        """Take all steps from a state to t_end; returns (status, message) of the run's end."""
        until = Until(self.known, self.until, state, self.sampler.model) if self.until else None
        left_out = LeftOut(self.handler.mode if self.handler else self.known)
        self.jumps = Jumps(self.known, self.counts, state.t, self.plan["t_end"])
        for batch in self._batches(state):
            if isinstance(batch, Change):
                self._keep_change(batch)
                if batch.stops:
                    return "stopped", batch.stops
                left_out = LeftOut(self.handler.mode)
                continue
            sound, failure = self.watch.look(batch) if self.watch else (len(batch), None)
            agreeing, contradiction = left_out.look(batch)
            if agreeing < sound:
                sound, failure = agreeing, contradiction
            self.counts.steps -= len(batch) - sound
            if stops := self._keep(batch.part(0, sound), until, presses):
                return "stopped", stops
            if failure:
                self.counts.steps += 1
                raise failure
            self.jumps.look(batch)
        return "done", unseen(self.known, self.method.fixed_step())

    def _batches(self, state):
        """An iterator over the step batches from a state to t_end, with Changes between them in runs with events."""
        if self.handler:
            return self.handler.stretches(state, self.plan["t_end"], self.counts)
        needs = self.known.needs
        batches = accepted(self.method, self.known, state, self.plan["t_end"], self.counts, self.sampler.rows)
        if self.known.m and not self.known.row_laws and (needs.phi_q_varies or needs.driven):
            self.watch = Watch(self.known, state)
        return batches

    def _keep(self, batch, until, presses):
        """Store frames and sensors of a step batch, in parts that end where a flush may be due. Returns why `until` stops the run, or "".

        The first `quiet` states need not be looked at one by one: `until` and the sensors are compiled, and `until` keeps its sign there.
        """
        done, quiet = 0, 0
        if self.progress is None:
            quiet = self.recorder.quiet(batch)
            quiet = min(quiet, until.quiet(batch)) if until and quiet else quiet

        def size():
            """Number of states of the next part: to the next flush or to the end of the quiet ones, at least 1."""
            before_flush = self.plan["flush_every"] - (self.counts.steps - self.flushed_steps) if self.store.file else MANY
            return max(1, min(before_flush, quiet - done))

        for part in parted(batch, self.counts, size):
            first, done = done, done + len(part)
            if done <= quiet:
                self.recorder.record(first, done)
            else:
                at_zero = until.crossing(self.last, part.last) if until else None
                if at_zero is not None:
                    self._stop_at(at_zero)
                    return f"until changed its sign at t = {at_zero.t:.9g} s"
                self.recorder.step(part.last)
            self._keep_part(part)
            if self.progress is not None:
                self.progress(part.last.t)
            if presses.count:
                raise KeyboardInterrupt
        return ""

    def _stop_at(self, state):
        """Store the state at which `until` is zero as the last frame of the run."""
        self.recorder.step(state)
        self.sampler.step(self.last, Stretch.of(state))
        self.last = state
        self.sampler.keep(state)

    def _keep_part(self, part):
        """Store the frames of a part of a step batch, and flush the file if that is due."""
        after = part.last
        self.sampler.step(self.last, part)
        if "impacts" in after.memory:
            self._record_impacts(after)
        self.last = after
        self.memory = after.memory or self.memory
        if after.restart:
            self._set_restart(after)
        self._flush_if_due()

    def _keep_change(self, change):
        """Store both sides of events that happen at one time; the run goes on behind them."""
        table, times = self.handler.happened.happened, self.plan["output"]
        if times is None and change.before:
            self.sampler.keep(change.before)
        table[-len(change.happened) :] = [replace(one, frame=self.store.count) for one in change.happened]
        if times is None:
            self.sampler.keep(change.after)
        self.recorder.model = self.handler.mode
        self.last = change.after
        self.recorder.step(change.after)
        self._set_restart(change.after)
        self._flush_if_due()

    def _set_restart(self, state):
        """Let the run be continued from a state: keep it with the counts and the number of frames so far."""
        self.restart = Restart(state, self.store.count, vars(self.counts).copy())

    def _flush_if_due(self):
        """Flush the file, if there is one and the plan asks for it now."""
        if self.store.file and self._due():
            self._flush()

    def _due(self):
        """True if a flush of the file is due, after the steps of the plan or FLUSH_SECONDS, or up to half as much later for a full block.

        It waits only if a block of frames is complete by then, and ends as soon as it is.
        """
        steps, wait = self.counts.steps - self.flushed_steps, self.store.file.rows * self.plan["every"]
        late = max(steps / self.plan["flush_every"], (time.monotonic() - self.flushed_at) / FLUSH_SECONDS)
        return late >= 1.0 and (late >= 1.5 or 2 * wait > self.plan["flush_every"] or self.store.count == self.store.file.count)

    def _flush(self):
        """Commit the frames so far to the file as those of a run that goes on."""
        self._commit("running", "", self.restart)
        self.flushed_steps, self.flushed_at = self.counts.steps, time.monotonic()

    def _commit(self, status, message, restart, last=False):
        """Commit frames, sensors and the state to continue from to the file, with the status of the run."""
        rows = behind_blocks(self.store.file, self.recorder.rows)
        commit(self.store, status, message, self.counts, self._seconds(), restart, rows, last, self.events, self._settings_used())
        self.flushed = restart
        self.recorded = self.recorder.count

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
        """(CPU, wall, compiling) seconds since the start of the run; the first two are without compiling."""
        return tuple(now - begun for now, begun in zip(clock(), self.begun))

    def _settings_used(self):
        """{setting: value} of the integrator as the run used them; from the memory of the state that it went on from, if no step was taken."""
        return self.method.settings_used(self.memory or (self.restart.state.memory if self.restart else {}))

    def _attach(self, error, run):
        """Store the Trajectory so far as attribute `trajectory` of an exception, and say so in a note."""
        error.trajectory = run
        where = f" and in {self.store.file.shown}" if self.streams else ""
        error.add_note(f"The run so far, {len(run)} frame{'s' * (len(run) != 1)}, is in this exception's attribute `trajectory`{where}.")

    def _end(self, status, message):
        """Make the Trajectory of the run with its status and message, and close the file."""
        try:
            if status != "stopped" and not self.handler:
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
        """The Trajectory of the frames so far, and where it can be continued from. The store cannot be used afterwards."""
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
