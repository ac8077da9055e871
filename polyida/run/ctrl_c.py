"""Ctrl-C during a run: the first press waits until the step is done, a second one interrupts at once.

`noted` is the context of a run; it gives the Presses, which the run asks after each step. `interruptions` tells loops over runs that one was ended.
"""

import signal
import threading
from contextlib import contextmanager

_interruptions = [0]


class Presses:
    """Handler of SIGINT for one run."""

    def __init__(self):
        """Make a handler that has counted no press of Ctrl-C."""
        self.count = 0  # how often Ctrl-C was pressed
        self.heeded = False  # True if it ended the run

    def __call__(self, number, frame):
        """Count a press; the second one in a run raises KeyboardInterrupt at once."""
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
