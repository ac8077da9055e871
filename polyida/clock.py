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
        self.spent, self.depth, self.lock = (0.0, 0.0), 0, threading.Lock()

    def __enter__(self):
        self.begin()

    def __exit__(self, *_):
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
        self.compiling, self.where, self.told = Loading(), where, os.environ.get("POLYIDA_QUIET", "0") not in ("", "0")

    def begin(self, module, name):
        """A function of a module begins to be compiled."""
        self.compiling.begin()
        if not self.told and self.compiling.seconds[1] > LONG:
            self.told = True
            if watched():
                kept = f"kept in {folder}" if (folder := self.where()) else "for this process alone, because no folder can be written"
                what = f"polyida compiles its kernels, now {name} of {module}, once for this version: {kept}"
                print(f"\r{what} (`polyida warm` compiles all; POLYIDA_QUIET=1 says nothing)", file=sys.stderr, flush=True)

    def end(self):
        """The function is compiled."""
        self.compiling.end()
