"""Frames of a run that lie in an HDF5 file, read back whole or piece by piece as if they were arrays."""

import numpy as np

from polyida.errors import InputError
from polyida.given import is_number
from polyida.io.layout import frames_at_once, width_of

MEMORY_LIMIT = 512 * 2**20  # bytes of frames that are held in memory


def require_bytes(part, memory_limit):
    """Raise InputError, in the name of `part`, unless it is a number of bytes."""
    if not (is_number(memory_limit) and memory_limit >= 0):
        raise InputError(f"{part}: memory_limit = {memory_limit!r} must be a number of bytes")


def blocks(frames):
    """Consecutive pieces (k, ...) of frames, of bounded size where they are in a file."""
    return frames.blocks() if isinstance(frames, StoredFrames) else (frames,)


class StoredFrames(np.lib.mixins.NDArrayOperatorsMixin):
    """Frames (count, width) that are read when asked for: the rows of an HDF5 dataset, and behind them those of `tail`.

    Arithmetic and `np.asarray` read all of it. Raises InputError where what is read is not whole.
    """

    ndim, dtype = 2, np.dtype(float)

    def __init__(self, dataset, count, tail, file, path):
        self._dataset, self._tail, self._path = dataset, tail, path
        self._file = file  # stays open as long as its frames are known
        self.shape = (int(count), dataset.shape[1])
        self.size = self.shape[0] * self.shape[1]
        self.nbytes = 8 * self.size

    def __len__(self):
        return self.shape[0]

    def __repr__(self):
        return f"StoredFrames({self.shape[0]} frames of {self.shape[1]}, in a file)"

    def blocks(self):
        """Consecutive frames, a bounded number at once."""
        step = frames_at_once(self.shape[1])
        for first in range(0, max(1, len(self)), step):
            yield self._read(first, min(first + step, len(self)))

    def __iter__(self):
        for block in self.blocks():
            yield from block

    def __getitem__(self, key):
        first, *rest = key if isinstance(key, tuple) else (key,)
        if first is Ellipsis or first is None or (isinstance(first, np.ndarray) and first.ndim > 1):
            return np.asarray(self)[key]
        rows = np.arange(len(self))[first]
        if rows.ndim == 0:
            row = self._read(rows, rows + 1)[0]
            return row[tuple(rest)] if rest else row
        if isinstance(first, slice):
            return np.concatenate([np.array(piece[(slice(None), *rest)]) for piece in self._pieces(rows)])
        return np.concatenate(list(self._pieces(rows)))[(np.arange(len(rows)), *rest)]

    def _pieces(self, rows):
        """The rows of that number, in their order, a bounded number at once."""
        step = frames_at_once(self.shape[1])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1):
            for k in range(0, max(1, len(run)), step):
                part = run[k : k + step]
                yield self._read(part[0], part[-1] + 1) if len(part) else self._read(0, 0)

    def _read(self, first, end):
        try:
            values = rows_of(self._dataset, self._tail, len(self), first, end)
        except OSError:
            values = np.full(1, np.nan)
        if not np.isfinite(values).all():
            raise InputError(f"{self._path}: frames {first} to {end - 1} are damaged")
        return values

    def __array__(self, dtype=None, copy=None):
        return self._read(0, len(self)).astype(dtype or float, copy=False)

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, StoredFrames) else x for x in inputs), **options)

    def __reduce__(self):
        return np.array, (np.asarray(self),)


def rows_of(dataset, tail, count, first, end):
    """Rows first to end of `count`, the last ones of which are the tail. Raises OSError where a checksum does not fit."""
    stored = count - len(tail)
    rows = np.asarray(dataset[min(first, stored) : min(end, stored)], float)
    return rows if end <= stored else np.concatenate([rows, tail[max(0, first - stored) : end - stored]])


def held(file, shapes, count, tail, limit, path):
    """{name: frames} of the first `count` frames of an open file: arrays, or StoredFrames where they exceed `limit` bytes.

    tail: {name: frames behind the last block}. One of them that is small beside the limit is read all the same.
    """
    frames, whole = {}, 8 * count * width_of(shapes) <= limit
    stored = count - min(len(tail["t"]), count)
    for name, (width,) in list(shapes.items())[1:]:
        if width == 0:
            frames[name] = np.zeros((count, 0))
            continue
        found = StoredFrames(file[name], count, tail[name][: count - stored], file, path)
        frames[name] = np.asarray(found) if whole or 32 * found.nbytes <= limit else found
    return {"t": rows_of(file["t"], tail["t"][: count - stored], count, 0, count)} | frames
