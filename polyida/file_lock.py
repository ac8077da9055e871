"""A mark on a file that a living process writes it; the system takes it off when that process ends, however it ends."""

import os
import struct
from contextlib import suppress

try:
    import fcntl
except ImportError:  # not on this system
    fcntl = None

LAYOUT = "hhqqi4x"  # struct flock


def lock(descriptor):
    """Mark an open file until the process ends or closes it; nothing where the system has no such locks."""
    if hasattr(fcntl, "F_OFD_SETLK"):
        with suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, _request(fcntl.F_WRLCK))


def being_written(path):
    """Whether a process that lives is writing the file; False where the system cannot tell."""
    if not hasattr(fcntl, "F_OFD_GETLK"):
        return False
    with open(path, "rb") as file:
        try:
            answer = fcntl.fcntl(file, fcntl.F_OFD_GETLK, _request(fcntl.F_RDLCK))
        except OSError:
            return False
    return struct.unpack(LAYOUT, answer)[0] != fcntl.F_UNLCK


def _request(kind):
    return struct.pack(LAYOUT, kind, os.SEEK_SET, 0, 0, 0)
