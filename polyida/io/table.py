"""Columns of a result file that grow together, block by block; a block is written once and never again."""

import numpy as np

from polyida.io.layout import chunk_of, frames_at_once, width_of
from polyida.jit import entry

LANE, SECOND, THIRD, FOURTH = np.uint64(0xFFFF), np.uint64(16), np.uint64(32), np.uint64(48)
TWO, THREE, FOUR = np.uint64(2), np.uint64(3), np.uint64(4)
CHECK = 4  # bytes of a chunk's checksum


def fletcher32(values):
    """Fletcher's checksum of contiguous numbers, a multiple of 8 bytes, as HDF5's filter appends it.

    Of the N words w_i of 16 bits, `s1 = sum w_i` and `s2 = sum (N - i) w_i`, both modulo 65535, where 0 stands for nothing
    but zeros: `65536 s2 + s1`. HDF5 takes the first byte of a word for the higher one; to change that multiplies both sums by
    256. Source: HDF5 File Format Specification 3.0, filter 3; J. Fletcher, IEEE Trans. Commun. 30, 1982.
    """
    s1, s2 = ((int(s) * 256 - 1) % 65535 + 1 if s else 0 for s in _sums(values.reshape(-1).view(np.uint64)))
    return s2 << 16 | s1


@entry
def _sums(quads):
    """s1 and s2, not reduced, of words that come in fours: each of the four places has sums of its own."""
    a0 = a1 = a2 = a3 = p0 = p1 = p2 = p3 = np.uint64(0)
    for k in range(quads.shape[0]):
        x = quads[k]
        a0 += x & LANE
        a1 += (x >> SECOND) & LANE
        a2 += (x >> THIRD) & LANE
        a3 += x >> FOURTH
        p0 += a0
        p1 += a1
        p2 += a2
        p3 += a3
    return a0 + a1 + a2 + a3, FOUR * (p0 + p1 + p2 + p3) - a1 - TWO * a2 - THREE * a3


class Table:
    """Datasets of the same length: shapes, dtypes {name: shape of a row, or its dtype}; those of no width are not in the file.

    rows: of a block; count: rows in whole blocks.
    """

    def __init__(self, shapes, dtypes):
        self.shapes, self.count, self.rows = shapes, 0, frames_at_once(width_of(shapes))
        self._packs = {name: _pack(chunk_of(self.rows, shape), dtypes[name]) for name, shape in shapes.items() if shape != (0,)}
        self.block_bytes = sum(len(stored) * -(-self._size(name) // numbers.size) for name, (stored, numbers) in self._packs.items())
        self._datasets = {}

    def make(self, file):
        """Create the datasets in an open file."""
        for name, (_, numbers) in self._packs.items():
            shape = self.shapes[name]
            options = {"maxshape": (None, *shape), "chunks": numbers.shape, "fletcher32": True}
            self._datasets[name] = file.create_dataset(name, (0, *shape), numbers.dtype, **options)

    def bytes(self, more=0):
        """Bytes of all chunks with `more` rows."""
        return -(-(self.count + more) // self.rows) * self.block_bytes

    def append(self, block):
        """Append rows, a list of arrays in the order of `shapes`: as many as a chunk holds, or the last ones."""
        for name, values in zip(self.shapes, block):
            if name in self._datasets:
                self._put(self._datasets[name].id, *self._packs[name], values)
        self.count += len(block[0])

    def _size(self, name):
        """Numbers of a block."""
        return self.rows * int(np.prod(self.shapes[name]))

    def _put(self, dataset, stored, numbers, values):
        """Write chunks as they are stored, past the library: with our own checksum, and copied once."""
        rows, flat, place = len(values), values.reshape(len(values), -1), numbers.reshape(len(numbers), -1)
        dataset.set_extent((self.count + rows, *values.shape[1:]))
        place[rows:] = 0.0
        for first in range(0, flat.shape[1], place.shape[1]):
            part = flat[:, first : first + place.shape[1]]
            place[:rows, : part.shape[1]], place[:, part.shape[1] :] = part, 0.0
            stored[-CHECK:] = np.frombuffer(fletcher32(stored[:-CHECK]).to_bytes(CHECK, "little"), np.uint8)
            dataset.write_direct_chunk((self.count, first)[: values.ndim], stored)


def _pack(chunk, dtype):
    """(the bytes of a chunk as it is stored, its numbers in them)."""
    stored = np.empty(dtype.itemsize * int(np.prod(chunk)) + CHECK, np.uint8)
    return stored, stored[:-CHECK].view(dtype).reshape(chunk)
