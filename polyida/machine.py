"""What a result was made with: versions of the packages that compute, and the processor. No host or user names."""

import os
import platform
from functools import cache
from importlib import metadata

PACKAGES = ("polyida", "numpy", "scipy", "numba", "scikit-sundae")


@cache
def versions():
    """{package: version} of Python and of the packages that compute; a package that is not installed is left out."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def machine_info():
    """`versions()` with processor, number of cores, threads asked for and platform, as plain data for a report."""
    threads = os.environ.get("OMP_NUM_THREADS", "not set")
    return versions() | {"processor": processor(), "cores": os.cpu_count(), "OMP_NUM_THREADS": threads,
                         "platform": f"{platform.system()} {platform.machine()}"}


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
