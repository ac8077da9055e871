"""Runs in a process of their own: a crash or a hang of one is an outcome, not the end of the study."""

import json
import multiprocessing
import signal
import traceback
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import Any

from polyida.run.ctrl_c import heard

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
    before = heard()
    try:
        row = {"error": ""} | function(**arguments)
    except (Exception, SystemExit, GeneratorExit) as error:  # noqa: BLE001, whatever it is, a task's failure is a row of the table
        row = {"error": told(error), "traceback": traceback.format_exc(limit=-4)}
    if heard() > before:
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
