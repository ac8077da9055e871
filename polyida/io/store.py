"""Frames of a run as they come: in memory while they are small, in a file beyond or from the start."""

from contextlib import suppress

import numpy as np

from polyida.io.frames import MEMORY_LIMIT
from polyida.io.layout import FRAMES, dtypes_of, frames_at_once, shapes_of
from polyida.io.memory import LAZY, room
from polyida.io.reader import read_open
from polyida.io.spill import Spill
from polyida.io.writer import NotWritten

SMALL = 1 << 20  # bytes of a run's frames that are not worth a piece of memory of their own


class FrameStore:
    """Accepted states of one run.

    Without a `file` they are written into their final place in memory, up to `limit` bytes, and go to a temporary file
    beyond; with one, block after block, they go there. Not more than a block is held beside a file. single: q, v, a and
    lam are kept in single precision. Raises NotWritten where the disk does not take them.
    """

    def __init__(self, n, m, limit=MEMORY_LIMIT, file=None, single=False):
        self.file, self.limit, self.count, self._spill, self._rows, self._single = file, limit, 0, None, 0, single
        self.drives = list(file.drives.values()) if file else []
        shapes = shapes_of(n, m, range(len(self.drives)))
        self._shapes, self._dtypes = list(shapes.values()), list(dtypes_of(shapes, single).values())
        self._block = self._few(file.rows) if file else room(self._shapes, self._dtypes, limit)

    def _few(self, rows):
        """A block of some frames, to be written into again and again."""
        return [np.empty((rows, *shape), dtype) for shape, dtype in zip(self._shapes, self._dtypes)]

    def rows(self, count):
        """The places of the next `count` frames, [q, v, a, lam], to be written into before they are kept; None where they do not stay there."""
        first, end = self._rows, self._rows + count
        if self.file or self._spill or self._single or end > len(self._block[0]):
            return None
        return [values[first:end] for values in self._block[1 : len(FRAMES)]]

    def add(self, state):
        """Keep a state; nothing is copied where it is in its place already."""
        self._keep(state.t, state.q, state.v, state.a, state.lam)

    def extend(self, columns, count):
        """Keep the first `count` of frames, arrays or StoredFrames in the order of FRAMES."""
        for first in range(0, count, self.file.rows):
            for frame in zip(*(values[first : min(first + self.file.rows, count)] for values in columns)):
                self._keep(*frame)

    def _keep(self, t, q, v, a, lam):
        row, (ts, qs, vs, accelerations, lams, *samples) = self._rows, self._block
        ts[row], qs[row], vs[row], accelerations[row], lams[row] = t, q, v, a, lam
        for values, profile in zip(samples, self.drives):
            values[row] = profile.at(t)
        self._rows, self.count = row + 1, self.count + 1
        if self._rows == len(ts):
            self.put_away()

    def waiting(self):
        """The frames that the file does not have yet, not more than a block of them."""
        rows = self.count - (self.file or self._spill).count
        return [values[:rows] for values in self._block]

    def put_away(self):
        """Move the block at hand to the file, or what memory holds when it is full. Safe to be interrupted and called again."""
        if away := self.file or self._spill:
            if self.count > away.count:
                away.append(self.waiting())
            self._rows = 0
        elif self._rows == len(self._block[0]):
            spill = Spill()
            spill.append(self._block)
            width = sum(values[:1].nbytes for values in self._block)
            self._spill, self._block, self._rows = spill, self._few(frames_at_once(width // 8)), 0

    def arrays(self):
        """{name: frames} of all that was kept, or committed to a file, arrays or StoredFrames. The store is used up then."""
        if self.file:
            with suppress(NotWritten):
                self.file.close()
            return read_open(self.file.descriptor, self.file.shown).frames(self.limit)
        block, self._block = self._block, []
        if self._spill:
            found = self._spill.arrays(block)
        else:
            found = [values[: self.count] for values in block]
            found = found if LAZY and sum(values.nbytes for values in found) > SMALL else [values.copy() for values in found]
        return dict(zip(FRAMES, found))
