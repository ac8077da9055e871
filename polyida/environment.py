"""Versions and machine of a result, without host and user names, and the number of threads of a run."""

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
_threads = [1]  # of a run
_inside: list = []  # the limit in force, then one entry for each run within it
PACKAGES = ("numpy", "scipy", "numba", "scikit-sundae")


@cache
def versions():
    """{package: version} of Python, of polyida and of the installed packages that compute."""
    result = {"python": platform.python_version(), "polyida": __version__}
    for name in PACKAGES:
        try:
            result[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return result


def machine_info():
    """`versions()` with processor, number of cores, threads and platform, as plain data for a report."""
    threads = {"OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "not set")}
    return (
        versions()
        | {"processor": processor(), "cores": os.cpu_count()}
        | threads
        | {"platform": f"{platform.system()} {platform.machine()}"}
    )


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
