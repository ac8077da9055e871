"""A mark on a file that a living process writes it; the system takes it off when that process ends, however it ends."""

import os
import struct
from contextlib import suppress

try:
    import fcntl
except ImportError:  # not on this system
    fcntl = None  # type: ignore[assignment]

CAN_TELL = hasattr(fcntl, "F_OFD_GETLK")
LAYOUT = "hhqqi4x"  # struct flock


def lock(descriptor):
    """Mark an open file until the process ends, closes or unlocks it; nothing where the system has no such locks."""
    if CAN_TELL:
        with suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, _request(fcntl.F_WRLCK))


def unlock(descriptor):
    """Take the mark off."""
    if CAN_TELL:
        with suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, _request(fcntl.F_UNLCK))


def being_written(path):
    """Whether a process that lives is writing the file; False where there is none, or the system cannot tell."""
    if not CAN_TELL:
        return False
    try:
        with open(path, "rb") as file:
            answer = fcntl.fcntl(file, fcntl.F_OFD_GETLK, _request(fcntl.F_RDLCK))
    except OSError:
        return False
    return struct.unpack(LAYOUT, answer)[0] != fcntl.F_UNLCK


def _request(kind):
    return struct.pack(LAYOUT, kind, os.SEEK_SET, 0, 0, 0)
