"""How often a command looks for garbage."""

import atexit
import gc

THRESHOLDS = (100_000, 20, 20)  # new objects before a look at the youngest, and looks before one at the next older


def collect_rarely():
    """Let Python look for unreachable cycles seldom, and not once more at its end.

    The compiler and matplotlib make some 500 000 objects that live as long as the process; looking through them again
    and again takes a second of `polyida compare`, and half a second more at the end.
    """
    gc.set_threshold(*THRESHOLDS)
    atexit.register(gc.freeze)
