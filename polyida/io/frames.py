"""Frames of a file that are read when needed, like arrays; blocks of frames of bounded size.

A StoredFrames stands for an array (frames, width) whose first rows are in an HDF5 dataset. It reads what is indexed, and no more.
"""

import numpy as np

from polyida.errors import InputError
from polyida.io.layout import frames_at_once


def blocks(frames):
    """Consecutive blocks (k, ...) of frames, in double precision, of bounded size."""
    step = frames_at_once(int(np.prod(frames.shape[1:])))
    return (np.asarray(frames[first : first + step], float) for first in range(0, max(1, len(frames)), step))


def each(frames):
    """Iterate over frames one after the other, each (...) in double precision."""
    return (frame for block in blocks(frames) for frame in block)


class StoredFrames(np.lib.mixins.NDArrayOperatorsMixin):
    """Frames (count, width) that are read when needed: the rows of an HDF5 dataset, then those of the array `tail`.

    Indexing reads the indexed frames, of single coordinates only their chunks; arithmetic, `np.asarray` and other attributes of arrays read
    all frames. Raises InputError if damaged data are read.
    """

    def __init__(self, dataset, tail, count, path):
        """Take a dataset of at least count - len(tail) rows, the last frames, the number of all, and the path for messages."""
        self._dataset, self._tail = dataset, tail
        self._path, self.dtype = path, tail.dtype
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
        """The number of frames, those of the tail included."""
        return self.shape[0]

    def __repr__(self):
        """One line with the numbers of frames and of entries of each."""
        return f"StoredFrames({self.shape[0]} frames of {self.shape[1]}, in a file)"

    def __getattr__(self, name):
        """The attribute of numpy arrays of that name, such as `max`, after reading all frames. Raises AttributeError for others."""
        if name.startswith("_") or not hasattr(np.ndarray, name):
            raise AttributeError(f"StoredFrames has no attribute {name!r}")
        return getattr(np.asarray(self), name)

    def __iter__(self):
        """Iterate over the frames, (width,) each, which are read in pieces."""
        for block in self._pieces(np.arange(len(self))):
            yield from block

    def __getitem__(self, key):
        """Read the frames of an index, slice, list or mask, as an array would give them, in pieces of bounded size."""
        first, *rest = key if isinstance(key, tuple) else (key,)
        rows = np.arange(len(self))[first]
        if first is Ellipsis or rows.ndim > 1:
            return np.asarray(self)[key]
        if rows.ndim == 0:
            row = self._read(rows, rows + 1)[0]
            return row[tuple(rest)] if rest else row
        if not isinstance(first, slice):
            return np.concatenate(list(self._pieces(rows)))[(np.arange(len(rows)), *rest)]
        columns = np.arange(self.shape[1])[rest[0]] if len(rest) == 1 and self.ndim == 2 else None
        if columns is None or columns.ndim > 1:
            return np.concatenate([np.array(piece[(slice(None), *rest)]) for piece in self._pieces(rows)])
        # columns between the outermost ones are read
        low, end = (int(columns.min()), int(columns.max()) + 1) if columns.size else (0, 0)
        return np.concatenate([np.array(piece[:, columns - low]) for piece in self._pieces(rows, slice(low, end))])

    def _pieces(self, rows, columns=None):
        """The rows of these numbers, in their order, a bounded number at once; columns: a slice, or all."""
        step = frames_at_once(columns.stop - columns.start if columns else int(np.prod(self.shape[1:])))
        for run in np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1):
            for part in np.split(run, range(step, len(run), step)):
                yield self._read(part[0], part[-1] + 1, columns) if len(part) else self._read(0, 0, columns)

    def _read(self, first, end, columns=None):
        """Frames first to end, of the columns of a slice or of all. Raises InputError if they are damaged."""
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
        """All frames as an array (frames, width), for `np.asarray`."""
        return self._read(0, len(self)).astype(dtype or self.dtype, copy=False)

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        """Apply a ufunc of numpy to all frames, read as arrays."""
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, StoredFrames) else x for x in inputs), **options)

    def __reduce__(self):
        """Pickle the frames as an array in memory."""
        return np.array, (np.asarray(self),)
