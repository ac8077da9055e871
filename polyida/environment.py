"""The machine: what a result was made with, with no host or user names, and how many of its threads a run takes."""

import os
import platform
import sys
import threading
from contextlib import contextmanager
from functools import cache, lru_cache
from importlib import metadata

from polyida import __version__
from polyida.errors import InputError
from polyida.validation import is_whole, named_keywords

_lock = threading.Lock()
_threads = [1]  # that a run takes
_inside: list = []  # the limit in force, and one entry for each run within it
PACKAGES = ("numpy", "scipy", "numba", "scikit-sundae")


@cache
def versions():
    """{package: version} of Python, of this package, installed or not, and of the installed packages that compute."""
    found = {"python": platform.python_version(), "polyida": __version__}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def machine_info():
    """`versions()` with processor, number of cores, threads asked for and platform, as plain data for a report."""
    threads = {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "not set")}
    return (
        versions()
        | {"processor": processor(), "cores": os.cpu_count()}
        | threads
        | {"platform": f"{platform.system()} {platform.machine()}"}
    )


@cache
def processor():
    """Name of the processor, or the architecture where the system does not tell."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()


def footer(data=None):
    """One line that says on what a result was made, from `machine_info()` or the same data read from a file."""
    return ", ".join(f"{name} {value}" for name, value in (data or machine_info()).items())


def cores():
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@named_keywords
def threads(count: int | None = None) -> int:
    """Let runs take so many threads from now on, and as many cores, all free; without a number, how many they take: one, where nothing was
    said.

    What takes them are the steps of generalized-alpha on scenes of SHARED coordinates and more (system/scene.py). The
    results are the same bit by bit for any number. Raises InputError for what is no whole number from 1 to that of the cores it may use.
    """
    if count is not None:
        if not is_whole(count, 1, cores()):
            raise InputError(f"threads: {count!r} must be a whole number from 1 to {cores()}, the cores that this process may use")
        _threads[0] = int(count)
    return _threads[0]


@lru_cache(maxsize=1)
def _libraries(modules):
    """The libraries of this process that have threads, looked for when modules have been imported: that takes longer than a short run."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@contextmanager
def one_blas_thread():
    """Limit the BLAS libraries of this process to one thread: on small matrices more cost more than they bring. The last of several runs
    at once gives back what was set.
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
