"""Versions and machine of a result, without host and user names; the number of threads of a run, and memory for its states.

The states of a run are in one mapping, whose pages the system provides when they are first written. Most of the cost of storing frames is that
the system clears the pages, one by one: pages of 2 MiB cost a seventh, and pages of an earlier run cost nothing. So a mapping without arrays is
stored for the next request of its size; the system may take its memory back at any time (MADV_FREE).
"""

import mmap
import os
import platform
import sys
import threading
import weakref
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from importlib import metadata
from math import prod

import numpy as np

from polyida import __version__
from polyida.clock import loading
from polyida.errors import InputError
from polyida.validation import is_whole, named_keywords

_lock = threading.Lock()
_threads = [1]  # of a run
_inside: list = []  # the limit in force, then one entry for each run within it
PACKAGES = ("numpy", "scipy", "numba", "scikit-sundae")


@cache
def versions():
    """{package: version} of Python, of polyida and of the installed packages that compute."""
    result = {"python": platform.python_version(), "polyida": __version__}
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            result[name] = metadata.version(name)
    return result


def machine_info():
    """`versions()` with processor, number of cores, threads and platform, as plain data for a report."""
    machine = {"processor": processor(), "cores": os.cpu_count(), "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "not set")}
    return versions() | machine | {"platform": f"{platform.system()} {platform.machine()}"}


@cache
def processor():
    """Name of the processor, or the architecture if the name is unknown."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()


def footer(data=None):
    """One line of `machine_info()`, or of the same data read from a file."""
    return ", ".join(f"{name} {value}" for name, value in (data or machine_info()).items())


def cores():
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@named_keywords
def threads(count: int | None = None) -> int:
    """Set the number of threads of all following runs.

    Generalized-alpha uses them on scenes with many coordinates (SHARED in system/scene.py). Results are the same bit by bit for any number.

    Parameters
    ----------
    count : int, optional
        From 1 to the number of cores that this process may use; all of them should be free. By default nothing changes.

    Returns
    -------
    int
        The number of threads; 1 if it was never set.
    """
    if count is not None:
        if not is_whole(count, 1, cores()):
            raise InputError(f"threads: {count!r} must be a whole number from 1 to {cores()}, the cores that this process may use")
        _threads[0] = int(count)
    return _threads[0]


@lru_cache(maxsize=1)
def _libraries(modules):
    """The libraries of this process with threads. The search takes longer than a short run; it is repeated after imports of modules."""
    with loading:
        from threadpoolctl import ThreadpoolController

        return ThreadpoolController()


@contextmanager
def one_blas_thread():
    """Limit the BLAS libraries of this process to one thread: on small matrices more threads are slower. The last of several concurrent runs
    restores the setting.
    """
    with _lock:
        if not _inside:
            _inside.append(_libraries(len(sys.modules)).limit(limits=1, user_api="blas"))
        _inside.append(None)
    try:
        yield
    finally:
        with _lock:
            _inside.pop()
            if len(_inside) == 1:
                _inside.pop().restore_original_limits()


HUGE = 1 << 21  # bytes of a large page
LEAST = 1 << 17  # bytes: less is an ordinary array
WIDE = 1 << 12  # bytes of a row from which on large pages pay
LINE = 64  # bytes, between which arrays begin
UNUSED = 4  # unused mappings, of any sizes: the system counts their pages as used until it needs them
MOST = 1 << 44  # bytes, of addresses alone
_PLAIN_LINUX = sys.platform == "linux" and platform.machine() in ("x86_64", "aarch64")
NO_RESERVE = 0x4000 if _PLAIN_LINUX else 0  # the system then counts written pages alone, so that a process with many runs can be forked
LAZY = hasattr(mmap, "MAP_PRIVATE") and hasattr(mmap, "MADV_FREE")  # True if untouched memory costs nothing

_unused: list[mmap.mmap] = []  # the last one given back at the end


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
    """A mapping of `size` bytes, an unused one if there is one; of half the size and so on, down to `least`, if refused."""
    for mapping in [one for one in _unused if len(one) == size]:
        with suppress(ValueError):  # another thread took it
            _unused.remove(mapping)
            return mapping
    try:
        return mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | NO_RESERVE)
    except (OSError, OverflowError):
        if size // 2 < least:
            raise MemoryError(f"no room for {least} bytes") from None
        return _mapping(size // 2, least)


def _give_back(mapping):
    """Keep a memory mapping that no array uses any more, for later arrays."""
    try:
        mapping.madvise(mmap.MADV_FREE)
    except OSError:  # the system does not support it
        return
    _unused.append(mapping)
    del _unused[:-UNUSED]
