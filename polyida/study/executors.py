"""Executors for the cases of a study: in this process, or in a separate process that survives crashes and hangs."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import traceback
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from copy import deepcopy
from typing import Any

from polyida.clock import clock
from polyida.errors import InputError, text_of
from polyida.reprs import short
from polyida.run.ctrl_c import interruptions

START_LIMIT = 60.0  # s for the start of a process and the imports of its first task
GRACE = 5.0  # s beyond its limit after which a task ends its own process if the parent process has died
COSTS = ("cpu_s", "wall_s", "memory_mb")
RESERVED = ("error", *COSTS)
KIB, MIB = 2.0**10, 2.0**20


class Worker:
    """A process that runs one call after the other and is replaced after a crash or a hang. Use it in a `with`, or close it.

    The process ends with its parent: at once if it waits, at the limit if a task hangs.
    """

    def __init__(self):
        """Make a Worker without a process; the process starts with the first call."""
        self.process = self.pipe = None

    def start(self):
        """Start the process unless it runs. Raises RuntimeError in a process that still imports the main module."""
        if self.process is None:
            context = multiprocessing.get_context("spawn")
            pipe, pipe_of_process = context.Pipe()
            process = context.Process(target=_serve, args=(pipe_of_process,), daemon=True)
            process.start()
            pipe_of_process.close()
            self.process, self.pipe = process, pipe

    def call(self, function, arguments, limit):
        """Return the dictionary of `function(**arguments)` as plain values with "error" empty.

        Otherwise {"error": text}: with the traceback of an exception, or with "outcome" "crash" or "hang" (longer than `limit` seconds).
        """
        self.start()
        answer = None
        try:
            self.pipe.send((function, arguments, limit))
            for patience in (START_LIMIT + limit, limit):  # for the beginning and for the end of the task
                if not self.pipe.poll(patience):
                    self.close()
                    return {"error": f"hang: no end within {limit:g} s", "outcome": "hang"}
                answer = self.pipe.recv_bytes()
            return json.loads(answer)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self.process.join(GRACE)
            code = self.process.exitcode
            self.close()
            names = {item.value: item.name for item in signal.Signals}
            ending = f"signal {names.get(-code, -code)}" if code is not None and code < 0 else f"exit code {code}"
            early = "" if answer else ', before the case began (is what starts processes in the script under `if __name__ == "__main__":`?)'
            return {"error": f"crash: {ending}{early}", "outcome": "crash"}
        except BaseException:
            self.close()
            raise

    def close(self):
        """End the process at once, also within compiled code."""
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.pipe.close()
            self.process = self.pipe = None

    def __enter__(self):
        """Return the Worker; its process starts with the first call."""
        return self

    def __exit__(self, *exception):
        """Close the Worker when the `with` ends."""
        self.close()


def _serve(pipe):
    """Run the calls that arrive until the other end closes. Ctrl-C is handled by the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            function, arguments, limit = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send_bytes(b"begun")
        _set_alarm(limit + GRACE)
        row = json.dumps(run_as_row(function, arguments), default=to_json)
        _set_alarm(0.0)
        pipe.send_bytes(row.encode())


def _set_alarm(seconds):
    """End this process after so many seconds, even within compiled code; 0 cancels. Systems without alarms do nothing."""
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, min(seconds, 1e8))


class SerialExecutor(Executor):
    """An executor of concurrent.futures that runs each call at once in this process."""

    def submit(self, function: Callable, /, *arguments: Any, **named: Any) -> Future:
        """Call `function(*arguments, **named)` at once; return a finished Future with its result or exception."""
        future: Future = Future()
        try:
            future.set_result(function(*arguments, **named))
        except Exception as error:  # noqa: BLE001, the future holds it
            future.set_exception(error)
        return future


class Isolated(SerialExecutor):
    """An executor of concurrent.futures that runs one call after the other in a separate process.

    A call that crashes its process or hangs becomes a row with an error, and the process is replaced. Use it in a `with`, or call
    `shutdown`. Functions must be defined in modules, as for every executor with processes.

    Parameters
    ----------
    limit : float, s
        A call that takes longer counts as hanging.
    fresh : bool
        Start a new process for each call, which takes about a second.
    """

    def __init__(self, limit: float = 600.0, fresh: bool = False) -> None:
        """Make an executor of one process. limit: seconds that a call may take. fresh: True for a new process for each call."""
        self._worker = Worker()
        self._limit = limit
        self._fresh = fresh

    def submit(self, function: Callable, /, **named: Any) -> Future:  # type: ignore[override]
        """Run `function(**named)` in the separate process; return a finished Future.

        Returns
        -------
        future : Future
            Finished; its result is the row of the call.
        """
        self._worker.start()
        future = super().submit(self._worker.call, function, named, self._limit)
        if self._fresh:
            self._worker.close()
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the separate process; the arguments have no effect."""
        self._worker.close()


def run_isolated(function, arguments, limit):
    """Make one `Worker.call` in a process of its own, which ends afterwards."""
    with Worker() as worker:
        return worker.call(function, arguments, limit)


def run_as_row(function, arguments):
    """{"error": ""} with the dictionary of `function(**arguments)`, or {"error", "traceback"} of its exception.

    Raises KeyboardInterrupt if Ctrl-C ended a run within the function.
    """
    before = interruptions()
    try:
        row = {"error": ""} | function(**arguments)
    except (Exception, SystemExit, GeneratorExit) as error:  # noqa: BLE001, every failure of a task is a row of the table
        row = {"error": error_text(error), "traceback": traceback.format_exc(limit=-4)}
    if interruptions() > before:
        raise KeyboardInterrupt
    return row


def error_text(error):
    """The text "Class: message" of an exception, for the column "error" of a row."""
    return f"{type(error).__name__}: {text_of(error)}"


def run_measured_case(function, arguments, sweep_id):
    """The row of a sweep's case: the result of the function, "error", and the costs that `sweep` describes.

    sweep_id: unique for each sweep; a scheduler such as Dask would otherwise return the row of an earlier equal call.
    """
    peak_was_reset = _reset_peak_memory()
    begun = clock()
    row = run_as_row(_checked_call, {"function": function, "arguments": deepcopy(arguments)})  # the function may change its case
    cpu, wall, _ = (now - start for now, start in zip(clock(), begun))
    costs = {"cpu_s": cpu, "wall_s": wall, "memory_mb": _peak_memory(peak_was_reset)}
    return {name: value for name, value in row.items() if name != "error"} | {"error": row["error"]} | costs


def _checked_call(function, arguments):
    """The result of a function of a case, a dictionary of plain values. Raises InputError for anything else and for reserved names."""
    result = function(**arguments)
    if not isinstance(result, dict):
        raise InputError(f"the function returned {short(result, 80)}; it must return a dictionary {{name: number, text or list of them}}")
    result = to_plain_value("the result of the function", result)
    for name, value in result.items():
        if name in RESERVED:
            raise InputError(f"the function returned {name!r}, which is a reserved column; use another name")
        if name in arguments and value != to_plain_value(name, arguments[name]):
            raise InputError(f"the function returned {name!r}, an argument of the case, with another value; use another name")
    return result


def to_json(value):
    """`default` of json.dumps: numpy's numbers and arrays of one entry as numbers, other arrays as lists, anything else as text."""
    if hasattr(value, "item") and getattr(value, "size", 1) == 1:
        return value.item()
    return value.tolist() if hasattr(value, "tolist") else str(value)


def to_plain_value(name, value):
    """A value that JSON can hold: numpy's numbers and arrays as numbers and lists, paths as text. Raises InputError for others."""
    if value is None or isinstance(value, (bool, str)) or type(value) in (int, float):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "dtype") and hasattr(value, "tolist"):
        return to_plain_value(name, value.tolist())
    if isinstance(value, (list, tuple)):
        return [to_plain_value(f"{name}[{k}]", entry) for k, entry in enumerate(value)]
    if isinstance(value, dict) and all(isinstance(key, str) for key in value):
        return {key: to_plain_value(f"{name}[{key!r}]", entry) for key, entry in value.items()}
    raise InputError(
        f"{name} = {short(value, 80)} is no plain value; those are numbers, texts, True, False, None, and lists and dictionaries of them"
    )


def _reset_peak_memory():
    """Start a new measurement of this process's peak memory; False if the system cannot (only Linux can)."""
    with suppress(OSError), open("/proc/self/clear_refs", "w") as file:
        file.write("5")
        return True
    return False


def _peak_memory(was_reset):
    """Peak resident memory of this process, MB, since the reset or else since its start; None if unknown."""
    if was_reset:
        with suppress(OSError, ValueError, StopIteration), open("/proc/self/status") as lines:
            return float(next(line for line in lines if line.startswith("VmHWM")).split()[1]) * KIB / MIB
    with suppress(ImportError):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (MIB if sys.platform == "darwin" else KIB)
    return None
