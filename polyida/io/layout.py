"""Layout of the file of a run: names, shapes and sizes for writer and reader.

`format` (attribute); `about`, JSON as bytes; `scene/...`, arrays of the scene; frames `t` (frames,), `q`, `v`, `a` (frames, n), `lam` (frames,
m), the last four optionally in single precision, and `drive i` (frames, 3) of profiles without a formula; `sensors` (steps, 1 + numbers),
time and values of sensors, whose names and shapes are in `about`. All datasets are chunked with HDF5's checksum (Fletcher32), and the file is
in HDF5's mode for one writer and many readers (SWMR). Frames are written in blocks, one chunk or a row of chunks of each name. A block is
written once, so that none is damaged if the process ends; the frames after the last complete block are in the slots.

Two datasets `slot i` are written in turn, so that one of them is always complete: HEAD, then a record (JSON: number of committed frames,
status of the run), the state to continue from, the frames after the last block, one name after the other, and the values of sensors there.
"""

import struct

import numpy as np

FORMAT = "polyida trajectory 4"
HEAD = struct.Struct("<QII")  # of a slot: number of bytes that follow, their CRC-32, bytes of the record
FRAMES = ("t", "q", "v", "a", "lam")
SENSORS = "sensors"
BLOCK_BYTES = 1_000_000  # of a block of frames
FEW, BLOCK_FRAMES = 16, 1024  # least and most frames of a block: single ones are slow to write, however long they are
MEMORY_LIMIT = 512 * 2**20  # bytes of frames in memory
COLUMNS = 1024  # numbers of a frame in a chunk: reading one coordinate, or one frame, then reads a small part of the file


def frames_at_once(width):
    """The number of frames of a block, a multiple of FEW, for frames of `width` numbers."""
    return int(np.clip(BLOCK_BYTES // (8 * max(1, width)) // FEW * FEW, FEW, BLOCK_FRAMES))


def chunk_of(rows, shape):
    """Shape of a chunk of `rows` frames of that shape, () or (width,): equal parts of not more than COLUMNS numbers."""
    return (rows, *(-(-width // -(-width // COLUMNS)) for width in shape))


def shapes_of(n, m, drives=()):
    """{name: shape of a frame} of a file; drives are names of profiles, each (value, d1, d2)."""
    return {"t": (), "q": (n,), "v": (n,), "a": (n,), "lam": (m,)} | {name: (3,) for name in drives}


def dtypes_of(shapes, single=False):
    """{name: dtype} of a file; single: q, v, a and lam in single precision."""
    return {name: np.dtype("f4" if single and name in FRAMES[1:] else "f8") for name in shapes}


def width_of(shapes):
    """Number of floats of a frame with these shapes, {name: shape}."""
    return sum(int(np.prod(shape)) for shape in shapes.values())


def sensed_width(sensors):
    """Numbers of a step of sensors, {name: shape of a value}, with the time; 0 without sensors."""
    return 1 + width_of(sensors) if sensors else 0
