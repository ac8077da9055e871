"""Locks on files that a process writes: others do not replace such a file, and know that its frames are not the last ones.

The system removes a lock when the process ends, however it ends. Systems without open file description locks have none (HAS_LOCKS).
"""

import os
import struct
from contextlib import suppress

from polyida.errors import InputError

try:
    import fcntl
except ImportError:  # not on this system
    fcntl = None  # type: ignore[assignment]

HAS_LOCKS = hasattr(fcntl, "F_OFD_GETLK")
LOCK_FORMAT = "hhqqi4x"  # struct flock


def lock(file, on=True):
    """Lock an open file until the process ends or closes it, or unlock it (on=False). No effect if the system has no such locks or refuses."""
    if HAS_LOCKS:
        with suppress(OSError):
            fcntl.fcntl(file, fcntl.F_OFD_SETLK, _request(fcntl.F_WRLCK if on else fcntl.F_UNLCK))


def being_written(path):
    """True if a process is writing the file; False if the system has no such locks."""
    if HAS_LOCKS:
        with suppress(OSError), open(path, "rb") as file:
            answer = fcntl.fcntl(file, fcntl.F_OFD_GETLK, _request(fcntl.F_RDLCK))
            return struct.unpack(LOCK_FORMAT, answer)[0] != fcntl.F_UNLCK
    return False


def require_unwritten(path):
    """Raise InputError if a process is writing the file."""
    if being_written(path):
        raise InputError(f"{path}: another process is still writing it; it is not replaced")


def _request(kind):
    """The bytes of a C struct flock that asks for a lock of that kind on a whole file."""
    return struct.pack(LOCK_FORMAT, kind, os.SEEK_SET, 0, 0, 0)
