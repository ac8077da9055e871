"""The clock of runs, which stands still while kernels are compiled and loaded, and libraries are loaded: what a process does once."""

import os
import sys
import threading
import time
from contextlib import ContextDecorator

LONG = 2.0  # s of compiling before someone who looks on is told


class Loading(ContextDecorator):
    """A context, or a decorator, of what a process does once. seconds (2,): CPU and wall time within it so far. A context within another one is part of it."""

    def __init__(self):
        """Make a clock that has counted no seconds."""
        self.spent = 0.0, 0.0  # CPU and wall seconds of the contexts that have ended
        self.depth = 0  # contexts within each other, 0 outside of all
        self.lock = threading.Lock()

    def __enter__(self):
        """Enter the context: the clock of runs stops."""
        self.begin()

    def __exit__(self, *_):
        """Leave the context: the clock of runs goes on behind the outermost one."""
        self.end()

    def begin(self):
        """Enter the context: the clock of runs stops with the outermost one."""
        with self.lock:
            self.depth += 1
            if self.depth == 1:
                self.begun = time.process_time(), time.perf_counter()

    def end(self):
        """Leave the context: the clock of runs goes on behind the outermost one."""
        with self.lock:
            if self.depth == 1:
                self.spent = self._seconds()
            self.depth -= 1

    @property
    def seconds(self):
        """(CPU, wall) seconds so far, with those of a context that has not ended."""
        with self.lock:
            return self._seconds()

    def _seconds(self):
        """(CPU, wall) seconds so far, read while the lock is held."""
        if self.depth == 0:
            return self.spent
        now = time.process_time(), time.perf_counter()
        return tuple(spent + end - begin for spent, begin, end in zip(self.spent, self.begun, now))


loading = Loading()


def clock():
    """(CPU, wall) seconds of this process without those of `loading`, and the CPU seconds of `loading`."""
    cpu, wall = loading.seconds
    return time.process_time() - cpu, time.perf_counter() - wall, cpu


def watched():
    """True at a terminal and in a notebook, where someone sees the error stream."""
    ipython = sys.modules.get("IPython")
    shell = ipython and ipython.get_ipython()
    return bool(sys.stderr and sys.stderr.isatty()) or type(shell).__name__ == "ZMQInteractiveShell"


class Teller:
    """Says once in a process, on the error stream, that kernels are compiled, if it takes longer than LONG and someone looks on.

    where(): the folder that keeps the kernels, or None.
    """

    def __init__(self, where):
        """Take the function that gives the folder of kernels; POLYIDA_QUIET=1 in the environment silences the message."""
        self.compiling = Loading()
        self.where = where
        self.told = os.environ.get("POLYIDA_QUIET", "0") not in ("", "0")

    def begin(self, module, name):
        """Note that a function of a module begins to be compiled; print the message if compiling takes long."""
        self.compiling.begin()
        if not self.told and self.compiling.seconds[1] > LONG:
            self.told = True
            if watched():
                kept = f"kept in {folder}" if (folder := self.where()) else "for this process alone, because no folder can be written"
                what = f"polyida compiles its kernels, now {name} of {module}, once for this version: {kept}"
                print(f"\r{what} (`polyida warm` compiles all; POLYIDA_QUIET=1 says nothing)", file=sys.stderr, flush=True)

    def end(self):
        """Note that the function is compiled, which stops the time of compiling."""
        self.compiling.end()
