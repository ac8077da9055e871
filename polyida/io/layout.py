"""What a result file looks like: names, shapes and sizes that its writer and its reader agree upon.

`format` (attribute); `about`, JSON as bytes; `scene/...`, arrays that `about` refers to; frames `t` (frames,), `q`, `v`,
`a` (frames, n), `lam` (frames, m), these four in single precision where that was asked for, and `drive i` (frames, 3) of
profiles that have no formula; `sensors` (steps, 1 + numbers), the time and what sensors gave, whose names and shapes `about` holds. All of
them are chunked with HDF5's checksum (Fletcher32), and the file is in HDF5's mode for one writer and many readers (SWMR). Frames come in
blocks, a chunk or a row of chunks of each name, written once and never again, so that none is torn where the process
ends; the frames behind the last whole block are in the slots.

Two datasets `slot i`, written in turn, the other one whole meanwhile: HEAD, then a record (JSON: how many frames hold,
how the run stands), the state to go on from, the frames behind the last block, one name after the other, and the steps of sensors there.

While a living process writes a file it holds a lock on it; the system takes that off when the process ends, however it ends.
"""

import os
import struct
from contextlib import suppress

import numpy as np

from polyida.errors import InputError

FORMAT = "polyida trajectory 4"
HEAD = struct.Struct("<QII")  # of a slot: bytes behind it, their CRC-32, bytes of the record
FRAMES = ("t", "q", "v", "a", "lam")
SENSORS = "sensors"
BLOCK_BYTES = 1_000_000  # of frames that are read or written at once
FEW, BLOCK_FRAMES = 16, 1024  # frames of a block: single ones are slow to write, however long they are
COLUMNS = 1024  # numbers of a frame in a chunk: with FEW frames one coordinate's history, and one frame, are a small part of the file


def frames_at_once(width):
    """How many frames of `width` numbers make a block, a multiple of FEW."""
    return int(np.clip(BLOCK_BYTES // (8 * max(1, width)) // FEW * FEW, FEW, BLOCK_FRAMES))


def chunk_of(rows, shape):
    """Shape of a chunk of `rows` frames of that shape, () or (width,): equal parts of not more than COLUMNS numbers."""
    return (rows, *(-(-width // -(-width // COLUMNS)) for width in shape))


def shapes_of(n, m, drives=()):
    """{name: shape of a frame} of what a file holds; drives are names of profiles, each (value, d1, d2)."""
    return {"t": (), "q": (n,), "v": (n,), "a": (n,), "lam": (m,)} | {name: (3,) for name in drives}


def dtypes_of(shapes, single=False):
    """{name: dtype} of what a file holds: of q, v, a and lam in single precision where that is asked for."""
    return {name: np.dtype("f4" if single and name in FRAMES[1:] else "f8") for name in shapes}


def width_of(shapes):
    """How many numbers make a frame."""
    return sum(int(np.prod(shape)) for shape in shapes.values())


def sensed_width(sensors):
    """How many numbers make a step of sensors, {name: shape of what it gives}: the time and theirs; 0 where there are none."""
    return 1 + width_of(sensors) if sensors else 0


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
