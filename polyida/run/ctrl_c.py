"""Ctrl-C in a run: the first press waits until the step is done, a second one interrupts at once."""

import signal
import threading
from contextlib import contextmanager

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
