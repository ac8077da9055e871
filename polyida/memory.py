"""Memory for the states of a run: one mapping, whose pages the system provides when they are first written, and which is reused.

Most of the cost of storing frames is that the system clears their pages, one by one: pages of 2 MiB cost a seventh, and pages of an earlier
run cost nothing. So a mapping without arrays is stored for the next request of its size; the system may take its memory back at any time
(MADV_FREE).
"""

import mmap
import weakref
from collections import defaultdict
from contextlib import suppress
from math import prod

import numpy as np

HUGE = 1 << 21  # bytes of a large page
LEAST = 1 << 17  # bytes: less is an ordinary array
WIDE = 1 << 12  # bytes of a row from which on large pages pay
LINE = 64  # bytes, between which arrays begin
UNUSED = 2  # unused mappings of a size
MOST = 1 << 44  # bytes, of addresses alone
LAZY = hasattr(mmap, "MAP_PRIVATE") and hasattr(mmap, "MADV_FREE")  # True if untouched memory costs nothing

_unused: defaultdict[int, list[mmap.mmap]] = defaultdict(list)


def allocate(shapes, dtypes, limit):
    """Uninitialised arrays (rows, *shape) of each dtype, with as many rows as `limit` bytes hold, at least one.

    They are in one range of addresses; of half the size and so on if the system refuses it.
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
    """`size` bytes or more; if the system refuses them fewer, but at least `least`."""
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
    """Store a mapping that has no array any more."""
    try:
        mapping.madvise(mmap.MADV_FREE)
    except OSError:  # the system does not support it
        return
    unused = _unused[len(mapping)]
    unused.append(mapping)
    del unused[:-UNUSED]
