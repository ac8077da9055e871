"""Frames of a run that lie in an HDF5 file, read back whole or piece by piece as if they were arrays."""

import numpy as np

from polyida.errors import InputError
from polyida.given import is_number
from polyida.io.layout import frames_at_once

MEMORY_LIMIT = 512 * 2**20  # bytes of frames that are held in memory


def require_bytes(part, memory_limit):
    """Raise InputError, in the name of `part`, unless it is a number of bytes."""
    if not (is_number(memory_limit) and memory_limit >= 0):
        raise InputError(f"{part}: memory_limit = {memory_limit!r} must be a number of bytes")


def blocks(frames):
    """Consecutive pieces (k, ...) of frames, of bounded size."""
    step = frames_at_once(int(np.prod(frames.shape[1:])))
    return (frames[first : first + step] for first in range(0, max(1, len(frames)), step))


class StoredFrames(np.lib.mixins.NDArrayOperatorsMixin):
    """Frames (count, width) that are read when asked for: the rows of an HDF5 dataset, and behind them those of `tail`.

    Arithmetic and `np.asarray` read all of it. Raises InputError where what is read is not whole.
    """

    dtype = np.dtype(float)

    def __init__(self, dataset, tail, count, path):
        self._dataset, self._tail, self._path = dataset, tail, path
        self._file = getattr(dataset, "file", None)  # stays open as long as its frames are known
        self.cut(count)

    def cut(self, count):
        """Have no more frames than `count`."""
        stored = min(getattr(self, "_stored", count - len(self._tail)), count)
        self._stored, self._tail = stored, self._tail[: count - stored]
        self.shape = (int(count), *self._tail.shape[1:])
        self.ndim, self.size = len(self.shape), int(np.prod(self.shape))
        self.nbytes = 8 * self.size

    def __len__(self):
        return self.shape[0]

    def __repr__(self):
        return f"StoredFrames({self.shape[0]} frames of {self.shape[1]}, in a file)"

    def blocks(self):
        """Consecutive frames, a bounded number at once."""
        return self._pieces(np.arange(len(self)))

    def __iter__(self):
        for block in self.blocks():
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
            return np.concatenate([np.array(piece[(slice(None), *rest)]) for piece in self._pieces(rows)])
        return np.concatenate(list(self._pieces(rows)))[(np.arange(len(rows)), *rest)]

    def _pieces(self, rows):
        """The rows of that number, in their order, a bounded number at once."""
        step = frames_at_once(int(np.prod(self.shape[1:])))
        for run in np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1):
            for part in np.split(run, range(step, len(run), step)):
                yield self._read(part[0], part[-1] + 1) if len(part) else self._read(0, 0)

    def _read(self, first, end):
        try:
            values = self.rows(first, end)
        except OSError:
            values = np.full(1, np.nan)
        if not np.isfinite(values).all():
            raise InputError(f"{self._path}: frames {first} to {end - 1} are damaged")
        return values

    def rows(self, first, end):
        """Frames first to end as they are there. Raises OSError where a checksum does not fit."""
        stored = self._stored
        rows = np.asarray(self._dataset[min(first, stored) : min(end, stored)], float)
        return rows if end <= stored else np.concatenate([rows, self._tail[max(0, first - stored) : end - stored]])

    def __array__(self, dtype=None, copy=None):
        return self._read(0, len(self)).astype(dtype or float, copy=False)

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, StoredFrames) else x for x in inputs), **options)

    def __reduce__(self):
        return np.array, (np.asarray(self),)
