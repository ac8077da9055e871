"""The frames of a run in progress: in memory up to a limit, beyond it in the file of the run or in temporary files.

In: the states of step batches. Out: arrays, or StoredFrames of the file, when the run has ended.
"""

import mmap
import os
import tempfile
from contextlib import suppress
from math import prod
from pathlib import Path

import numpy as np

from polyida.environment import LAZY, allocate
from polyida.io.layout import FRAMES, MEMORY_LIMIT, dtypes_of, shapes_of
from polyida.io.reader import read_open
from polyida.io.writer import NotWritten, writing

BLOCK = 1 << 20  # bytes that are written at once
WINDOW = 1 << 24  # bytes after which the system may drop those before from its cache
SMALL = 1 << 20  # bytes of a run's frames: fewer are copied to arrays of their own
PART = 8  # an array smaller than 1 / PART of the memory is copied: otherwise it would keep all of it


class Spill:
    """Temporary files, one for each array of a block, with numbers as in memory.

    rows: frames of a block; count: frames in complete blocks. Methods raise NotWritten.
    """

    def __init__(self, frame_bytes):
        """Take the bytes of a frame; the files are made when frames come."""
        self.rows, self.count = max(1, BLOCK // frame_bytes), 0
        self.shown = Path(tempfile.gettempdir()) / "frames"  # the name in messages
        self._files = []
        self._cached = 0  # bytes that the system may still hold

    def append(self, block):
        """Append frames, a list of arrays. Safe to be interrupted and called again."""
        with writing(self.shown):
            self._files += [tempfile.TemporaryFile(buffering=0) for _ in block[len(self._files) :]]  # noqa: SIM115, they stay open
            for file, values in zip(self._files, block):
                _write(file, values.reshape(-1).view(np.uint8), self.count * values[:1].nbytes)
        self.count += len(block[0])
        self._cached += sum(values.nbytes for values in block)
        if self._cached > WINDOW and hasattr(os, "posix_fadvise"):
            for file in self._files:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            self._cached = 0

    def arrays(self, block):
        """The frames as arrays, of the shapes and dtypes of a block; later changes of the arrays do not change the file."""
        return [_mapped(file, values, self.count) for file, values in zip(self._files, block)]


def _write(file, values, at):
    """Write bytes to a file without buffer, from position `at` on."""
    file.seek(at)
    done = 0
    while done < len(values):
        done += file.write(memoryview(values)[done:])


def _mapped(file, values, count):
    """`count` frames of a file as an array that is read when needed, with shape and dtype of `values`."""
    size = count * values[:1].nbytes
    if not size:
        return np.empty((count, *values.shape[1:]), values.dtype)
    mapping = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY)
    return np.frombuffer(mapping, values.dtype).reshape(count, *values.shape[1:])


class FrameStore:
    """Accepted states of one run.

    They are written to their final place in memory, up to `limit` bytes, and block after block from there to the `file`, if there is one.
    Beyond the limit, or from the start if more frames are `expected`, they go to the file or to temporary files, and memory has one block.
    single: q, v, a and lam in single precision. Raises NotWritten.
    """

    def __init__(self, n, m, limit=MEMORY_LIMIT, file=None, single=False, expected=0):
        """Take the sizes of a model, the bytes of memory that frames may have, and the file, if there is one."""
        self.file, self.limit, self._single = file, limit, single
        self.count = 0  # frames so far
        self.drives = list(file.drives.values()) if file else []
        shapes = shapes_of(n, m, range(len(self.drives)))
        self._shapes, self._dtypes = list(shapes.values()), list(dtypes_of(shapes, single).values())
        self._away = file  # the file, or Spill, of the frames before the block
        self._first = 0  # number of these frames
        self._rows = 0  # frames in the block
        many = self._many() if limit >= self._bytes(max(expected, file.rows if file else 1)) else [()]
        self._whole = len(many[0]) > 0  # True while all frames are in the block
        self._block = many if self._whole else self._few()  # arrays in the order of FRAMES, then those of the drives

    def _bytes(self, frames):
        """Bytes of so many frames."""
        return frames * sum(prod(shape) * dtype.itemsize for shape, dtype in zip(self._shapes, self._dtypes))

    def _many(self):
        """Arrays for as many frames as memory may hold, in whole blocks of the file."""
        arrays = allocate(self._shapes, self._dtypes, self.limit)
        rows = len(arrays[0]) - (len(arrays[0]) % self.file.rows if self.file else 0)
        return [values[:rows] for values in arrays]

    def _few(self):
        """Arrays for one block of frames that are written to the file, or to temporary files without one."""
        self._away = self._away or Spill(self._bytes(1))
        return [np.empty((self._away.rows, *shape), dtype) for shape, dtype in zip(self._shapes, self._dtypes)]

    def rows(self, count):
        """The arrays of the next `count` frames, [q, v, a, lam], to write into; None if they are not the final ones."""
        first, end = self._rows, self._rows + count
        if self._single or not self._whole or end > len(self._block[0]):
            return None
        return [values[first:end] for values in self._block[1 : len(FRAMES)]]

    def extend(self, stretch):
        """Store the states of a Stretch; those that are in `rows` already are not copied."""
        self._extend([getattr(stretch, name) for name in FRAMES])

    def copy(self, columns, count):
        """Store the first `count` frames of arrays or StoredFrames, in the order of FRAMES."""
        for first in range(0, count, self.file.rows):
            self._extend([values[first : min(first + self.file.rows, count)] for values in columns])

    def _extend(self, columns):
        """Store frames, arrays in the order of FRAMES, behind those so far; full blocks are put away."""
        done, whole = 0, len(columns[0])
        while done < whole:
            first, free = self._rows, len(self._block[0]) - self._rows
            if self._away:
                free = min(free, self._away.count + self._away.rows - self.count)
            count = min(free, whole - done)
            for values, column in zip(self._block, columns):
                values[first : first + count] = column[done : done + count]
            for values, profile in zip(self._block[len(FRAMES) :], self.drives):
                values[first : first + count] = [profile.at(t) for t in columns[0][done : done + count]]
            self._rows, self.count, done = first + count, self.count + count, done + count
            if count == free:
                self.put_away()

    def waiting(self):
        """Arrays of the frames that the file does not have yet, at most one block."""
        first = self._away.count - self._first
        return [values[first : self._rows] for values in self._block]

    def put_away(self):
        """Write waiting frames to the file; after a full block memory has one block. It may be interrupted and called again."""
        full = self._rows == len(self._block[0])
        if full and self._away is None:
            self._away = Spill(self._bytes(1))
        while self._away and self.count > self._away.count:
            self._away.append([values[: self._away.rows] for values in self.waiting()])
        if full:
            self._block = self._few() if self._whole else self._block
            self._whole = False
            self._first, self._rows = self.count, 0

    def arrays(self):
        """{name: frames} of all stored, or committed, frames, arrays or StoredFrames. The store cannot be used afterwards."""
        block, self._block = self._block, []
        if self.file:
            with suppress(NotWritten):
                self.file.close()
            if not self._whole:
                return read_open(self.file.descriptor, self.file.shown).frames(self.limit)
            os.close(self.file.descriptor)
        if not self._whole:
            return dict(zip(FRAMES, self._away.arrays(block)))
        columns = [values[: self.file.committed if self.file else self.count] for values in block]
        whole = sum(values.nbytes for values in columns)
        stays = LAZY and whole > SMALL
        return {name: values if stays and PART * values.nbytes > whole else values.copy() for name, values in zip(FRAMES, columns)}
