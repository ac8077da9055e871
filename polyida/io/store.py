"""Frames of a run as they come: in memory while they are small, in a file beyond or from the start."""

from contextlib import suppress

import numpy as np

from polyida.io.frames import MEMORY_LIMIT
from polyida.io.layout import FRAMES, frames_at_once, shapes_of, width_of
from polyida.io.reader import read_open
from polyida.io.writer import NotWritten, Writer


class FrameStore:
    """Accepted states of one run.

    Without a `file` they stay in memory up to `limit` bytes and go to a temporary file beyond; with one, block after
    block, they go there. Not more than a block is held beside the file. Raises NotWritten where the disk does not take
    them.
    """

    def __init__(self, n, m, limit=MEMORY_LIMIT, file=None):
        self.shape, self.limit, self.file, self.count = (n, m), limit, file, 0
        self.drives = list(file.drives.values()) if file else []
        self._full, self._bytes, self._rows, self._block = [], 0, 0, self._room()

    def _room(self):
        shapes = shapes_of(*self.shape, range(len(self.drives)))
        length, width = frames_at_once(width_of(shapes)), width_of(shapes)
        if not self.file:
            length = min(length, max(1, int(min(self.limit, 1e15)) // (8 * width)))
        return [np.empty((length, *shape)) for shape in shapes.values()]

    def add(self, state):
        """Keep a state."""
        self._keep([getattr(state, name) for name in FRAMES])

    def extend(self, columns, count):
        """Keep the first `count` of frames, arrays or StoredFrames in the order of FRAMES."""
        for first in range(0, count, self.file.rows):
            for frame in zip(*(values[first : min(first + self.file.rows, count)] for values in columns)):
                self._keep(frame)

    def _keep(self, frame):
        row = self._rows
        for values, value in zip(self._block, frame):
            values[row] = value
        for values, profile in zip(self._block[len(FRAMES) :], self.drives):
            values[row] = profile.at(frame[0])
        self._rows, self.count = row + 1, self.count + 1
        if self._rows == len(self._block[0]):
            self.put_away()

    def waiting(self):
        """The frames that the file does not have yet, not more than a block of them."""
        rows = self.count - self.file.count
        return [values[:rows] for values in self._block]

    def put_away(self):
        """Move the block at hand to the file or to the full ones. Safe to be interrupted and called again."""
        if self.file:
            if self.count > self.file.count:
                self.file.append(self.waiting())
            self._rows = 0
            return
        block, room = [values[: self._rows] for values in self._block], self._room()
        full, size = [*self._full, block], self._bytes + sum(values.nbytes for values in block)
        self._full, self._bytes, self._block, self._rows = full, size, room, 0
        if size > self.limit:
            self._to_file()

    def _to_file(self):
        file = Writer.temporary(*self.shape)
        for block in self._full:
            file.append(block)
        self.file, self._full = file, []

    def arrays(self):
        """{name: frames} of all that was kept, or committed to a file, arrays or StoredFrames. The store is used up then."""
        if self.file:
            with suppress(NotWritten):
                self.file.close()
            return read_open(self.file.descriptor, self.file.shown).frames(self.limit)
        parts = [*self._full, [values[: self._rows] for values in self._block]]
        self._full = []
        return {name: np.concatenate([block.pop(0) for block in parts]) for name in FRAMES}
