"""Frames of a run that lie in an HDF5 file, read back whole or piece by piece as if they were arrays."""

import numpy as np

from polyida.errors import InputError
from polyida.io.layout import frames_at_once
from polyida.validation import is_number

MEMORY_LIMIT = 512 * 2**20  # bytes of frames that are held in memory


def require_bytes(part, memory_limit):
    """Raise InputError, in the name of `part`, unless it is a number of bytes."""
    if not (is_number(memory_limit) and memory_limit >= 0):
        raise InputError(f"{part}: memory_limit = {memory_limit!r} must be a number of bytes")


def blocks(frames):
    """Consecutive pieces (k, ...) of frames, in double precision, of bounded size."""
    step = frames_at_once(int(np.prod(frames.shape[1:])))
    return (np.asarray(frames[first : first + step], float) for first in range(0, max(1, len(frames)), step))


def each(frames):
    """One frame after the other, in double precision."""
    return (frame for block in blocks(frames) for frame in block)


class StoredFrames(np.lib.mixins.NDArrayOperatorsMixin):
    """Frames (count, width) that are read when asked for: the rows of an HDF5 dataset, and behind them those of `tail`.

    What is indexed is read, of single coordinates their chunks alone; arithmetic, `np.asarray` and all else that an array
    has read all of it. Raises InputError where what is read is not whole.
    """

    def __init__(self, dataset, tail, count, path):
        self._dataset, self._tail, self._path, self.dtype = dataset, tail, path, tail.dtype
        self._file = getattr(dataset, "file", None)  # stays open as long as its frames are known
        self.cut(count)

    def cut(self, count):
        """Have no more frames than `count`."""
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
        """The rows of that number, in their order, a bounded number at once; columns: a slice of them, or all."""
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
        """Frames first to end as they are there. Raises OSError where a checksum does not fit."""
        stored, rest = self._stored, (columns,) if columns else ()
        rows = np.asarray(self._dataset[(slice(min(first, stored), min(end, stored)), *rest)], self.dtype)
        return rows if end <= stored else np.concatenate([rows, self._tail[(slice(max(0, first - stored), end - stored), *rest)]])

    def __array__(self, dtype=None, copy=None):
        return self._read(0, len(self)).astype(dtype or self.dtype, copy=False)

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, StoredFrames) else x for x in inputs), **options)

    def __reduce__(self):
        return np.array, (np.asarray(self),)
