"""Frames beyond the memory that they may take: files without a name in the folder for temporary files, mapped when the run is over."""

import mmap
import os
import tempfile
from pathlib import Path

import numpy as np

from polyida.io.file.writer import taken

BLOCK = 1 << 20  # bytes that are written at once
WINDOW = 1 << 24  # bytes after which the system is told that those before will not be read soon


class Spill:
    """A file for each of the arrays of a block, numbers as they are in memory; no other process can come at them.

    What is on the disk need not stay in memory: new memory would cost more than the writing. rows: frames of a block;
    count: frames in whole blocks. Methods raise NotWritten.
    """

    def __init__(self, frame_bytes):
        self.rows, self.count, self.shown = max(1, BLOCK // frame_bytes), 0, Path(tempfile.gettempdir()) / "frames"
        self._files, self._told = [], 0

    def append(self, block):
        """Append frames, a list of arrays. Safe to be interrupted and called again."""
        with taken(self.shown):
            self._files += [_nameless() for _ in block[len(self._files) :]]
            for file, values in zip(self._files, block):
                _write(file, values.reshape(-1).view(np.uint8), self.count * values[:1].nbytes)
        self.count += len(block[0])
        self._told += sum(values.nbytes for values in block)
        if self._told > WINDOW and hasattr(os, "posix_fadvise"):
            for file in self._files:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            self._told = 0

    def arrays(self, block):
        """The frames as arrays, of the shapes and dtypes of a block; what is written into them later is not in the file."""
        return [_mapped(file, values, self.count) for file, values in zip(self._files, block)]


def _nameless():
    return tempfile.TemporaryFile(buffering=0)


def _write(file, values, at):
    file.seek(at)
    done = 0
    while done < len(values):
        done += file.write(memoryview(values)[done:])


def _mapped(file, values, count):
    size = count * values[:1].nbytes
    if not size:
        return np.empty((count, *values.shape[1:]), values.dtype)
    mapping = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY)
    return np.frombuffer(mapping, values.dtype).reshape(count, *values.shape[1:])
