"""Ctrl-C between steps: the first is noted and heeded when the step is done, a second one breaks in at once."""

import signal
import threading
from contextlib import contextmanager

_heard = [0]


@contextmanager
def noted():
    """Context that gives a function which raises KeyboardInterrupt where Ctrl-C was pressed since.

    So a flush is not cut in two, nor the exception lost in a place where Python ignores it. Only in the main thread and
    where Python's own handler is in place; elsewhere Ctrl-C does what it does.
    """
    pressed = []

    def note(number, frame):
        if pressed:
            signal.default_int_handler(number, frame)
        pressed.append(number)
        _heard[0] += 1

    def heed():
        if pressed:
            raise KeyboardInterrupt

    main = threading.current_thread() is threading.main_thread()
    ours = main and signal.getsignal(signal.SIGINT) is signal.default_int_handler
    before = signal.signal(signal.SIGINT, note) if ours else None
    try:
        yield heed
    finally:
        if ours:
            signal.signal(signal.SIGINT, before)


def heard():
    """How often Ctrl-C was noted in this process: a run that it ended comes back as any other, and who goes on to the next must know."""
    return _heard[0]
