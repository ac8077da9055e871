"""Memory that states are written into: in one piece, taken from the system as it is touched, used again.

What frames cost beside their numbers are pages that the system clears for them, one by one: in pages of 2 MiB they cost a
seventh, and those that an earlier run was done with cost nothing. So a piece that no array shows any more is kept for the
next that asks for its size; the system is told that it may have the memory back any time (MADV_FREE).
"""

import mmap
import weakref
from collections import defaultdict
from contextlib import suppress
from math import prod

import numpy as np

HUGE = 1 << 21  # bytes of a large page
LEAST = 1 << 17  # bytes that are worth a piece
WIDE = 1 << 12  # bytes of a row from which on large pages pay
LINE = 64  # bytes, between which arrays begin
KEPT = 2  # pieces of a size
MOST = 1 << 44  # bytes, of addresses alone
LAZY = hasattr(mmap, "MAP_PRIVATE") and hasattr(mmap, "MADV_FREE")  # whether what is not touched costs nothing

_unused: defaultdict[int, list[mmap.mmap]] = defaultdict(list)


def room(shapes, dtypes, limit):
    """Arrays (rows, *shape) of each dtype, not set, as many rows as `limit` bytes hold, at least one.

    They lie in one piece of addresses, of half the size and so on where the system does not grant that much.
    """
    sizes = [prod(shape) * dtype.itemsize for shape, dtype in zip(shapes, dtypes)]
    width, spare = sum(sizes), LINE * len(sizes)
    rows = max(1, int(min(limit, MOST)) // width)
    piece, at, arrays = _piece(rows * width + spare, width + spare), 0, []
    rows = min(rows, (piece.nbytes - spare) // width)
    for shape, dtype, size in zip(shapes, dtypes, sizes):
        arrays.append(piece[at : at + rows * size].view(dtype).reshape(rows, *shape))
        at += -(-rows * size // LINE) * LINE
    return arrays


def _piece(size, least):
    """`size` bytes or more, or as many as there are but `least`."""
    if not LAZY or size < LEAST:
        return np.empty(size, np.uint8)
    grain = max(HUGE, 1 << (size.bit_length() - 4))
    mapping = _mapping(-(-size // grain) * grain, least)
    if least >= WIDE and hasattr(mmap, "MADV_HUGEPAGE"):
        with suppress(OSError):  # a system that has none
            mapping.madvise(mmap.MADV_HUGEPAGE)
    piece = np.frombuffer(mapping, np.uint8)
    weakref.finalize(piece, _give_back, mapping).atexit = False
    return piece


def _mapping(size, least):
    with suppress(IndexError):
        return _unused[size].pop()
    try:
        return mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except (OSError, OverflowError):
        if size // 2 < least:
            raise MemoryError(f"no room for {least} bytes") from None
        return _mapping(size // 2, least)


def _give_back(mapping):
    """Keep a piece that no array shows any more."""
    try:
        mapping.madvise(mmap.MADV_FREE)
    except OSError:  # a system that would not have it back
        return
    kept = _unused[len(mapping)]
    kept.append(mapping)
    del kept[:-KEPT]
