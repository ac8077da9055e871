"""Runs in a process of their own, where a crash or a hang is an outcome, and one case of a sweep, with what it cost."""

import json
import multiprocessing
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from copy import deepcopy
from typing import Any

from polyida.errors import InputError
from polyida.run.run import interruptions

START = 60.0  # s that a process may take to start and import what its task needs
GRACE = 5.0  # s beyond its limit after which a task ends itself, should nobody be left to end it


class Worker:
    """A process that runs one call after the other, replaced after a crash or a hang; close it, or use it in a `with`.

    It ends when this process ends, however that ends: at once where it waits, at the limit where a task hangs.
    """

    def __init__(self):
        self.process = self.pipe = None

    def call(self, function, arguments, limit):
        """`function(**arguments)` there, at most `limit` seconds; returns its dictionary as plain values with "error" empty.

        Otherwise {"error": what happened}: an exception by its text, with its traceback; "outcome" "crash" with signal
        or exit code where the process died, "hang" where it did not end. What is no plain value becomes its text.
        """
        if self.process is None:
            self._start()
        try:
            self.pipe.send((function, arguments, limit))
            for patience in (START + limit, limit):  # until it begins, until it ends
                if not self.pipe.poll(patience):
                    self._end()
                    return {"error": f"hang: no end within {limit:g} s", "outcome": "hang"}
                answer = self.pipe.recv_bytes()
            return json.loads(answer)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self.process.join(GRACE)
            code = self.process.exitcode
            self._end()
            return {"error": f"crash: {_ending(code)}", "outcome": "crash"}
        except BaseException:
            self._end()
            raise

    def _start(self):
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()

    def _end(self):
        self.process.kill()
        self.process.join()
        self.pipe.close()
        self.process = self.pipe = None

    def close(self):
        """End the process."""
        if self.process is not None:
            self._end()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()


class Serial(Executor):
    """An executor of concurrent.futures that runs what it is given here and now."""

    def submit(self, function: Callable, /, *arguments: Any, **named: Any) -> Future:
        """The Future of `function(*arguments, **named)`, done already."""
        return _done(function, *arguments, **named)


class Isolated(Executor):
    """An executor of concurrent.futures that runs one call after the other in a process of its own, replaced after a crash or a hang.

    limit: seconds after which a call counts as hanging. fresh: a new process for each call. Crashes and hangs are rows; starting a process
    takes about a second. Use it in a `with`, or `shutdown` it. The functions must be of modules, as for processes always.
    """

    def __init__(self, limit: float = 600.0, fresh: bool = False) -> None:
        self._worker, self._limit, self._fresh = Worker(), limit, fresh

    def submit(self, function: Callable, /, **named: Any) -> Future:  # type: ignore[override]
        """The Future of what `Worker.call` gives for `function(**named)`, done already."""
        future = _done(self._worker.call, function, named, self._limit)
        if self._fresh:
            self._worker.close()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the process."""
        self._worker.close()


def _done(function, /, *arguments, **named):
    future = Future()
    try:
        future.set_result(function(*arguments, **named))
    except Exception as error:  # noqa: BLE001, the future has it
        future.set_exception(error)
    return future


def run_isolated(function, arguments, limit):
    """`Worker.call` in a process of its own."""
    with Worker() as worker:
        return worker.call(function, arguments, limit)


def attempt(function, arguments):
    """{"error": ""} and the dictionary that `function(**arguments)` gives, or the exception as {"error", "traceback"}.

    Raises KeyboardInterrupt where Ctrl-C ended a run within.
    """
    before = interruptions()
    try:
        row = {"error": ""} | function(**arguments)
    except (Exception, SystemExit, GeneratorExit) as error:  # noqa: BLE001, whatever it is, a task's failure is a row of the table
        row = {"error": told(error), "traceback": traceback.format_exc(limit=-4)}
    if interruptions() > before:
        raise KeyboardInterrupt
    return row


def told(error):
    """An exception as a row's text."""
    return f"{type(error).__name__}: {error}"


def plain(value):
    """A value as JSON holds it: numbers and lists of numpy's, text of anything else."""
    if hasattr(value, "item") and getattr(value, "size", 1) == 1:
        return value.item()
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _serve(pipe):
    """Run what comes until nobody is there. Ctrl-C is for the process that asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            function, arguments, limit = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send_bytes(b"begun")
        _alarm(limit + GRACE)
        row = json.dumps(attempt(function, arguments), default=plain)
        _alarm(0.0)
        pipe.send_bytes(row.encode())


def _alarm(seconds):
    """End this process in so many seconds, even out of compiled code; 0 calls it off. Nothing where there are no alarms."""
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, min(seconds, 1e8))


def _ending(code):
    if code is not None and code < 0:
        with_name = {item.value: item.name for item in signal.Signals}
        return f"signal {with_name.get(-code, -code)}"
    return f"exit code {code}"


COSTS = ("cpu_s", "wall_s", "memory_mb")
RESERVED = ("error", *COSTS)
KIB, MIB = 2.0**10, 2.0**20


def measured(function, arguments, sweep_id):
    """The row of `function(**arguments)`: what it gave, "error", cpu_s of this process, wall_s and memory_mb, see `sweep`.

    sweep_id: another one in every sweep: a scheduler that has seen a call before (Dask) would give its old row.
    """
    fresh = _forget_peak()
    wall, cpu = time.perf_counter(), time.process_time()
    row = attempt(_checked, {"function": function, "arguments": deepcopy(arguments)})  # what it does to its case is its own
    costs = {"cpu_s": time.process_time() - cpu, "wall_s": time.perf_counter() - wall, "memory_mb": _peak(fresh)}
    return {name: value for name, value in row.items() if name != "error"} | {"error": row["error"]} | costs


def _checked(function, arguments):
    """What a case gave, as plain values under names of their own."""
    found = function(**arguments)
    if not isinstance(found, dict):
        raise InputError(f"the function gave {_short(found)}; it must give a dictionary {{name: number, text or list of them}}")
    found = plain_value("what the function gave", found)
    for name, value in found.items():
        if name in RESERVED:
            raise InputError(f"the function gave {name!r}, which is the row's own; call it otherwise")
        if name in arguments and value != plain_value(name, arguments[name]):
            raise InputError(f"the function gave {name!r}, which is the case's own, with another value; call it otherwise")
    return found


def plain_value(what, value):
    """A value as JSON holds it: numpy's numbers and arrays as numbers and lists, paths as texts. Raises InputError for anything else."""
    if value is None or isinstance(value, (bool, str)) or type(value) in (int, float):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "dtype") and hasattr(value, "tolist"):
        return plain_value(what, value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain_value(f"{what}[{k}]", entry) for k, entry in enumerate(value)]
    if isinstance(value, dict) and all(isinstance(name, str) for name in value):
        return {name: plain_value(f"{what}[{name!r}]", entry) for name, entry in value.items()}
    raise InputError(
        f"{what} = {_short(value)} is no plain value; those are numbers, texts, True, False, None, and lists and dictionaries of them"
    )


def _short(value):
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:60]}... (a {type(value).__name__})"


def _forget_peak():
    """Let the system measure this process's largest memory from now on; whether it does (Linux alone)."""
    with suppress(OSError), open("/proc/self/clear_refs", "w") as file:
        file.write("5")
        return True
    return False


def _peak(fresh):
    """Largest resident memory of this process since it was forgotten, MB, or since the process began where it was not; None if unknown."""
    if fresh:
        with suppress(OSError, ValueError, StopIteration), open("/proc/self/status") as lines:
            return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) * KIB / MIB
    with suppress(ImportError):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (MIB if sys.platform == "darwin" else KIB)
    return None
