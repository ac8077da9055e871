"""HDF5's checksum of what it stores, faster than the library's own by a factor of several."""

import numpy as np

from polyida.jit import entry

LANE, SECOND, THIRD, FOURTH = np.uint64(0xFFFF), np.uint64(16), np.uint64(32), np.uint64(48)
TWO, THREE, FOUR = np.uint64(2), np.uint64(3), np.uint64(4)


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
