"""A mark on a file that a living process writes it; the system takes it off when that process ends, however it ends."""

import os
import struct
from contextlib import suppress

from polyida.errors import InputError

try:
    import fcntl
except ImportError:  # not on this system
    fcntl = None  # type: ignore[assignment]

CAN_TELL = hasattr(fcntl, "F_OFD_GETLK")
LAYOUT = "hhqqi4x"  # struct flock


def lock(file, on=True):
    """Mark an open file until the process ends or closes it, or take the mark off; nothing where the system has no such locks."""
    if CAN_TELL:
        with suppress(OSError):
            fcntl.fcntl(file, fcntl.F_OFD_SETLK, _request(fcntl.F_WRLCK if on else fcntl.F_UNLCK))


def being_written(path):
    """Whether a process that lives is writing the file; False where there is none, or the system cannot tell."""
    if CAN_TELL:
        with suppress(OSError), open(path, "rb") as file:
            answer = fcntl.fcntl(file, fcntl.F_OFD_GETLK, _request(fcntl.F_RDLCK))
            return struct.unpack(LAYOUT, answer)[0] != fcntl.F_UNLCK
    return False


def require_unwritten(path):
    """Raise InputError where a living process writes the file."""
    if being_written(path):
        raise InputError(f"{path}: another process is still writing it; it is not replaced")


def _request(kind):
    return struct.pack(LAYOUT, kind, os.SEEK_SET, 0, 0, 0)
