"""Frames of a run: in memory while they are small, in an HDF5 file beyond, read back whole or piece by piece."""

import numpy as np

from polyida.errors import InputError

FRAMES = ("t", "q", "v", "a", "lam")
MEMORY_LIMIT = 512 * 2**20  # bytes of frames that are held in memory
BLOCK_BYTES = 4_000_000  # of frames that are read or written at once
BLOCK_FRAMES = 1024


def frames_at_once(width):
    """How many frames of `width` numbers make a block."""
    return int(np.clip(BLOCK_BYTES // (8 * max(1, width)), 1, BLOCK_FRAMES))


def blocks(frames):
    """Consecutive pieces (k, ...) of frames, of bounded size where they are in a file."""
    return frames.blocks() if isinstance(frames, StoredFrames) else (frames,)


class StoredFrames(np.lib.mixins.NDArrayOperatorsMixin):
    """The first `count` rows of an HDF5 dataset, (count, width): an array that is read when asked for.

    Arithmetic and `np.asarray` read all of it. Raises InputError where a value that is read is not finite.
    """

    ndim, dtype = 2, np.dtype(float)

    def __init__(self, dataset, count, file, path):
        self._dataset, self._file, self._path = (
            dataset,
            file,
            path,
        )  # the file stays open as long as its frames are known
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
        runs = np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1)
        for run in runs:
            for k in range(0, max(1, len(run)), step):
                part = run[k : k + step]
                yield self._read(part[0], part[-1] + 1) if len(part) else self._read(0, 0)

    def _read(self, first, end):
        values = np.asarray(self._dataset[first:end], float)
        if not np.isfinite(values).all():
            raise InputError(
                f"{self._path}: frames {first} to {end - 1} hold values that are not finite; the file is damaged"
            )
        return values

    def __array__(self, dtype=None, copy=None):
        return self._read(0, len(self)).astype(dtype or float, copy=False)

    def __array_ufunc__(self, ufunc, method, *inputs, **options):
        return getattr(ufunc, method)(*(np.asarray(x) if isinstance(x, StoredFrames) else x for x in inputs), **options)

    def __reduce__(self):
        return np.array, (np.asarray(self),)


class FrameStore:
    """Accepted states of one run as they come.

    Without a `file` they stay in memory up to `limit` bytes and go to a temporary file beyond; with one they go there
    from the start. Not more than a block is held beside the file. Raises NotWritten where the disk does not take
    them.
    """

    def __init__(self, n, m, limit=MEMORY_LIMIT, file=None):
        self.shape, self.limit, self.file = (n, m), limit, file
        self.count = file.count if file else 0
        self._full, self._bytes, self._rows, self._block = [], 0, 0, self._room()

    def _room(self):
        n, m = self.shape
        width = 3 * n + m + 1
        length = (
            frames_at_once(width)
            if self.file
            else min(frames_at_once(width), max(1, int(min(self.limit, 1e15)) // (8 * width)))
        )
        return [np.empty((length, *shape)) for shape in ((), (n,), (n,), (n,), (m,))]

    def add(self, state):
        """Keep a state."""
        row = self._rows
        for values, name in zip(self._block, FRAMES):
            values[row] = getattr(state, name)
        self._rows, self.count = row + 1, self.count + 1
        if self._rows == len(self._block[0]):
            self.put_away()

    def put_away(self):
        """Move the block at hand to the file or to the full ones. Safe to be interrupted and called again."""
        if self.file:
            waiting = self.count - self.file.count
            if waiting:
                self.file.append([values[:waiting] for values in self._block])
            self._rows = 0
            return
        block, room = [values[: self._rows] for values in self._block], self._room()
        full, size = [*self._full, block], self._bytes + sum(values.nbytes for values in block)
        self._full, self._bytes, self._block, self._rows = full, size, room, 0
        if size > self.limit:
            self._to_file()

    def _to_file(self):
        from polyida.frame_file import FrameFile

        file = FrameFile.temporary(*self.shape)
        for block in self._full:
            file.append(block)
        self.file, self._full = file, []

    def arrays(self):
        """{name: frames} of all that was kept, arrays or StoredFrames. The store is used up then."""
        if self.file:
            return self.file.frames(self.limit)
        parts = [*self._full, [values[: self._rows] for values in self._block]]
        self._full, result = [], {}
        for k, name in enumerate(FRAMES):
            result[name] = np.concatenate([block[k] for block in parts])
            for block in parts:
                block[k] = None
        return result
