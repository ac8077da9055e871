"""Layout of the file of a run: names, shapes and sizes for writer and reader; frames that are read from a file like arrays.

`format` (attribute); `about`, JSON as bytes; `scene/...`, arrays of the scene; frames `t` (frames,), `q`, `v`, `a` (frames, n), `lam` (frames,
m), the last four optionally in single precision, and `drive i` (frames, 3) of profiles without a formula; `sensors` (steps, 1 + numbers),
time and values of sensors, whose names and shapes are in `about`. All datasets are chunked with HDF5's checksum (Fletcher32), and the file is
in HDF5's mode for one writer and many readers (SWMR). Frames are written in blocks, one chunk or a row of chunks of each name. A block is
written once, so that none is damaged if the process ends; the frames after the last complete block are in the slots.

Two datasets `slot i` are written in turn, so that one of them is always complete: HEAD, then a record (JSON: number of committed frames,
status of the run), the state to continue from, the frames after the last block, one name after the other, and the values of sensors there.

A process that writes a file holds a lock on it, which the system removes when the process ends.
"""

import os
import struct
from contextlib import suppress

import numpy as np

from polyida.errors import InputError

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
    """Numbers of a frame."""
    return sum(int(np.prod(shape)) for shape in shapes.values())


def sensed_width(sensors):
    """Numbers of a step of sensors, {name: shape of a value}, with the time; 0 without sensors."""
    return 1 + width_of(sensors) if sensors else 0


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
    return struct.pack(LOCK_FORMAT, kind, os.SEEK_SET, 0, 0, 0)


def blocks(frames):
    """Consecutive blocks (k, ...) of frames, in double precision, of bounded size."""
    step = frames_at_once(int(np.prod(frames.shape[1:])))
    return (np.asarray(frames[first : first + step], float) for first in range(0, max(1, len(frames)), step))


def each(frames):
    """One frame after the other, in double precision."""
    return (frame for block in blocks(frames) for frame in block)


class StoredFrames(np.lib.mixins.NDArrayOperatorsMixin):
    """Frames (count, width) that are read when needed: the rows of an HDF5 dataset, then those of the array `tail`.

    Indexing reads the indexed frames, of single coordinates only their chunks; arithmetic, `np.asarray` and other attributes of arrays read
    all frames. Raises InputError if damaged data are read.
    """

    def __init__(self, dataset, tail, count, path):
        self._dataset, self._tail, self._path, self.dtype = dataset, tail, path, tail.dtype
        self._file = getattr(dataset, "file", None)  # keeps the file open
        self.cut(count)

    def cut(self, count):
        """Keep the first `count` frames."""
        stored = min(vars(self).get("_stored", count - len(self._tail)), count)
        self._stored, self._tail = stored, self._tail[: count - stored]
        self.shape = (int(count), *self._tail.shape[1:])
        self.ndim, self.size = len(self.shape), int(np.prod(self.shape))
        self.nbytes = self.dtype.itemsize * self.size

    def __len__(self):
        return self.shape[0]

    def __repr__(self):
        return f"StoredFrames({self.shape[0]} frames of {self.shape[1]}, in a file)"

    def __getattr__(self, name):
        if name.startswith("_") or not hasattr(np.ndarray, name):
            raise AttributeError(f"StoredFrames has no attribute {name!r}")
        return getattr(np.asarray(self), name)

    def __iter__(self):
        for block in self._pieces(np.arange(len(self))):
            yield from block

    def __getitem__(self, key):
        first, *rest = key if isinstance(key, tuple) else (key,)
        rows = np.arange(len(self))[first]
        if first is Ellipsis or rows.ndim > 1:
            return np.asarray(self)[key]
        if rows.ndim == 0:
            row = self._read(rows, rows + 1)[0]
            return row[tuple(rest)] if rest else row
        if isinstance(first, slice):
            columns = np.arange(self.shape[1])[rest[0]] if len(rest) == 1 and self.ndim == 2 else None
            if columns is None or columns.ndim > 1:
                return np.concatenate([np.array(piece[(slice(None), *rest)]) for piece in self._pieces(rows)])
            # columns between the outermost ones are read
            low, end = (int(columns.min()), int(columns.max()) + 1) if columns.size else (0, 0)
            return np.concatenate([np.array(piece[:, columns - low]) for piece in self._pieces(rows, slice(low, end))])
        return np.concatenate(list(self._pieces(rows)))[(np.arange(len(rows)), *rest)]

    def _pieces(self, rows, columns=None):
        """The rows of these numbers, in their order, a bounded number at once; columns: a slice, or all."""
        step = frames_at_once(columns.stop - columns.start if columns else int(np.prod(self.shape[1:])))
        for run in np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1):
            for part in np.split(run, range(step, len(run), step)):
                yield self._read(part[0], part[-1] + 1, columns) if len(part) else self._read(0, 0, columns)

    def _read(self, first, end, columns=None):
        try:
            values = self.rows(first, end, columns)
        except OSError:
            values = np.full(1, np.nan)
        if not np.isfinite(values).all():
            raise InputError(f"{self._path}: frames {first} to {end - 1} are damaged")
        return values

    def rows(self, first, end, columns=None):
        """Frames first to end without checks. Raises OSError if a checksum is wrong."""
        stored, rest = self._stored, (columns,) if columns else ()
        rows = np.asarray(self._dataset[(slice(min(first, stored), min(end, stored)), *rest)], self.dtype)
        return rows if end <= stored else np.concatenate([rows, self._tail[(slice(max(0, first - stored), end - stored), *rest)]])

    def __array__(self, dtype=None, copy=None):
        return self._read(0, len(self)).astype(dtype or self.dtype, copy=False)

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, StoredFrames) else x for x in inputs), **options)

    def __reduce__(self):
        return np.array, (np.asarray(self),)
