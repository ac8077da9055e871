"""Where compiled kernels are kept: a folder named after all that they were made from.

numba looks for changes in the file of an entry alone; what the entry calls in other files it takes as it was. So the
folder's name carries a hash of every file that makes compiled code, and of numba's version: a change anywhere begins
an empty folder.
"""

import hashlib
import os
import pickle
import re
import shutil
import sys
import tempfile
import threading
import time
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path

import numba
import numpy as np

PREFIX = "kernels-"
KEPT_OWN = 1000  # files of users' functions that stay
KEPT = 4  # folders of other sources that stay: going back and forth between versions compiles nothing
UNUSED = 3600.0  # s: a younger folder may be that of a process that is just starting

# a file that compiles, or whose formulas are traced into compiled code, or whose tuples compiled code takes apart by place, or that
# says that compiled code has constants from it
_MAKES_KERNELS = re.compile(
    rb"^(?:from|import) (?:numba|polyida import jit|polyida\.jit)\b|^class \w+\(NamedTuple\)|^# constants of compiled code", re.MULTILINE
)
PLAIN = os.environ.get("POLYIDA_PLAIN_NUMBA", "0") not in ("", "0")  # whether the faster compilers are not wanted
_lock = threading.RLock()


def sources(folder):
    """(path, content) of every file below the folder that makes compiled code, sorted."""
    for place in sorted(os.scandir(folder), key=lambda place: place.name):
        if place.is_dir() and place.name != "__pycache__":
            yield from sources(place.path)
        elif place.name.endswith(".py"):
            with open(place.path, "rb") as file:
                content = file.read()
            if _MAKES_KERNELS.search(content):
                yield place.path, content


@cache
def folder():
    """The folder of this version's kernels, made where it is missing; None where there is none that can be written.

    It lies in the first of NUMBA_CACHE_DIR, the package's own `__pycache__` and the user's cache that takes files.
    """
    package = Path(__file__).parents[1]
    try:
        name = PREFIX + _digest(package)
    except OSError:
        return None
    user = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/.cache")
    given = numba.config.CACHE_DIR
    for parent in [*([Path(given)] if given else []), package / "__pycache__", Path(user) / "polyida"]:
        if _taken(parent / name):
            _remove_old(parent, name)
            return parent / name
    return None


def _digest(package):
    """Hash of the kernels' sources, of the versions of what compiles them and of which compilers are at work."""
    versions = numba.__version__, version("llvmlite"), np.__version__, sys.version
    digest = hashlib.sha256(f"{versions} {PLAIN} {numba.config.OPT} {numba.config.BOUNDSCHECK}".encode())
    for path, content in sources(package):
        digest.update(f"\n{os.path.relpath(path, package)} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]


def _taken(folder):
    """Whether the folder is there and can be written; its time is that of its last use."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _remove_old(parent, name):
    """Of the other folders the KEPT last used stay, and those that were used within UNUSED seconds."""
    used = []
    for other in parent.glob(PREFIX + "*"):
        try:
            used.append((other.stat().st_mtime, other))
        except OSError:
            continue  # another process removed it
    others = sorted((item for item in used if item[1].name != name), reverse=True)
    for last, other in others[KEPT:]:
        if time.time() - last > UNUSED:
            shutil.rmtree(other, ignore_errors=True)


@cache
def remove_old_own(module):
    """Of the files of users' functions, which a module compiles, the KEPT_OWN last written stay; looked at once in a process."""
    files = []
    for path in (folder() or Path(os.devnull)).rglob(f"{module}.*"):
        with suppress(OSError):  # another process removed it
            files.append((path.stat().st_mtime, path))
    for _, path in sorted(files, reverse=True)[KEPT_OWN:]:
        path.unlink(missing_ok=True)


@contextmanager
def kept():
    """Within this, numba keeps what is decorated in `folder()`; yields whether there is one."""
    with _lock:
        before = numba.config.CACHE_DIR
        place = folder()
        numba.config.CACHE_DIR = str(place or "")
        try:
            yield place is not None
        finally:
            numba.config.CACHE_DIR = before


class Files:
    """The files of an entry's kernels, one for each signature and named after it.

    numba numbers its files and keeps the numbers in an index. Two processes that compile at once take the same number, and the code of
    one signature is then loaded for another.
    """

    def __init__(self, folder, name):
        self.folder, self.name = folder, name

    def save(self, key, data):
        """Write the code of a signature; where that fails it is compiled again next time."""
        path = self._path(key)
        with suppress(OSError):
            descriptor, temporary = tempfile.mkstemp(dir=self.folder, prefix=self.name, suffix=".tmp")
            try:
                with open(descriptor, "wb") as file:
                    pickle.dump((key, data), file, protocol=-1)
                os.replace(temporary, path)
            except BaseException:
                os.unlink(temporary)
                raise

    def load(self, key):
        """The code of a signature, None where there is none."""
        try:
            with open(self._path(key), "rb") as file:
                kept, data = pickle.load(file)
        except Exception:  # noqa: BLE001 a damaged file raises anything
            return None
        return data if kept == key else None

    def _path(self, key):
        return os.path.join(self.folder, f"{self.name}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc")
