"""One run in progress: steps become frames, and whatever ends it, what there is comes back as a trajectory."""

import time
from contextlib import suppress

from polyida.errors import InputError
from polyida.guarded_model import guard
from polyida.integrate import ctrl_c
from polyida.integrate.accepted import accepted
from polyida.integrate.moves import unseen
from polyida.integrate.sampling import Sampler, Until
from polyida.integrate.state import StepFailure
from polyida.machine import machine_info
from polyida.trajectory import Restart, Trajectory

FLUSH_SECONDS = 2.0


class Run:
    """A run on its way.

    plan: what was asked for, as plain data. store: a FrameStore; where it has a file, that is flushed as the plan
    says. clocks: wall and CPU time at the start. until, progress: the user's functions or None.
    """

    def __init__(self, model, integrator, plan, store, counts, clocks, until=None, progress=None):
        self.model, self.integrator, self.plan, self.store, self.counts = model, integrator, plan, store, counts
        self.clocks, self.until, self.progress = clocks, until, progress
        self.streams, done = store.file is not None, store.count
        self.sampler = Sampler(store, counts, plan["every"], plan["output"], done)
        self.last = self.restart = self.flushed = None
        self.flushed_steps, self.flushed_at = counts.steps, time.monotonic()

    def begin(self, state, overwrite):
        """Keep the first state; a file gets it and comes to its place. Raises InputError where that cannot be done."""
        from polyida.frame_file import NotWritten

        self.sampler.start(state)
        self._mark(state)
        if not self.streams:
            return
        try:
            self._flush()
            self.store.file.publish(overwrite)
        except NotWritten as error:
            raise InputError(str(error)) from None
        finally:
            if self.store.file.path != self.store.file.shown:
                self.store.file.discard()

    def go(self, state):
        """Run to the end; returns the Trajectory. A user's exception goes on, with the Trajectory as an attribute."""
        from polyida.frame_file import NotWritten

        try:
            with ctrl_c.noted() as heed:
                status, message = self._steps(state, heed)
        except StepFailure as failure:
            status, message = failure.status, str(failure)
        except KeyboardInterrupt:
            status, message = "interrupted", f"interrupted after t = {self._reached(state):.9g} s"
        except NotWritten as error:
            return self._result(*self._cut_off(error, f"after t = {self._reached(state):.9g} s"))
        except BaseException as error:
            self._attach(error)
            raise
        return self._end(status, message)

    def _steps(self, state, heed):
        self.last, watch = state, Until(self.until, state) if self.until else None
        for after in accepted(self.integrator, guard(self.model), state, self.plan["t_end"], self.counts):
            at_zero = watch.crossing(state, after) if watch else None
            if at_zero is not None:
                self.sampler.step(state, at_zero)
                self.last = at_zero
                self.sampler.keep(at_zero)
                return "stopped", f"until changed its sign at t = {at_zero.t:.9g} s"
            self.sampler.step(state, after)
            self.last = state = after
            if after.restart:
                self._mark(after)
            if self.progress is not None:
                self.progress(after.t)
            heed()
        return "done", "" if getattr(self.integrator, "adaptive", False) else unseen(self.model, getattr(self.integrator, "h", 0.0))

    def _mark(self, state):
        """The run can go on from here; a flush where it is due."""
        self.restart = Restart(state, self.store.count, vars(self.counts).copy())
        if self.streams and (
            self.counts.steps - self.flushed_steps >= self.plan["flush_every"]
            or time.monotonic() - self.flushed_at >= FLUSH_SECONDS
        ):
            self._flush()

    def _flush(self):
        self.store.put_away()
        self._commit("running", "", self.restart)
        self.flushed_steps, self.flushed_at = self.counts.steps, time.monotonic()

    def _commit(self, status, message, restart):
        from polyida.trajectory_file import commit

        commit(self.store.file, status, message, self.counts, self._seconds(), restart)
        self.flushed = restart

    def _seconds(self):
        wall, cpu = self.clocks
        return time.process_time() - cpu, time.perf_counter() - wall

    def _reached(self, state):
        return (self.last or state).t

    def _attach(self, error):
        """Finish, and hand the Trajectory to an exception that goes on to the caller."""
        with suppress(Exception):
            run = self._end("error", f"{type(error).__name__}: {error}")
            error.trajectory = run
            where = f" and in {self.store.file.shown}" if self.streams else ""
            error.add_note(f"The run so far, {len(run)} frames, is in this exception's attribute `trajectory`{where}.")

    def _end(self, status, message):
        """The Trajectory, and the file closed."""
        from polyida.frame_file import NotWritten

        try:
            self.sampler.end(self.last)
            if self.store.file:
                self.store.put_away()
            if self.streams:
                self._commit(status, message, self.restart)
        except NotWritten as error:
            status, message = self._cut_off(error, f"{status} {message}")
        return self._result(status, message)

    def _cut_off(self, error, detail):
        """(status, message) where the disk takes no more: the frames in the file are those that hold."""
        from polyida.frame_file import NotWritten

        status, message = error.status, f"{error}; {detail}"
        with suppress(NotWritten):
            if self.streams:
                self._commit(status, message, self.flushed)
        return status, message

    def _result(self, status, message):
        cpu, wall = self._seconds()
        frames = self._close() if self.streams else self.store.arrays()
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
            restart=self.flushed if self.streams else self.restart,
            plan=self.plan,
        )

    def _close(self):
        """The frames, read from the closed file."""
        from polyida.frame_file import NotWritten
        from polyida.trajectory_file import naming, read

        file = self.store.file
        with suppress(NotWritten):
            file.close()
        with naming(file.shown):
            return read(file.shown).frames(self.store.limit)
