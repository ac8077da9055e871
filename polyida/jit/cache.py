"""The folder of compiled kernels, whose name is a hash of all sources of compiled code.

numba detects changes in the file of an entry only, not in the files of the functions that it calls. Therefore the name of the folder contains a
hash of each file that makes compiled code, and of numba's version: after any change a new, empty folder is used.
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
USER_FILES = 1000  # files of users' functions that are not removed
OLD_FOLDERS = 4  # folders of other versions that are not removed: switching between versions compiles nothing
UNUSED = 3600.0  # s: a younger folder may belong to a process that is just starting

# a file that compiles, or whose formulas are traced into compiled code, or whose tuples compiled code reads by position, or that
# declares constants of compiled code
_MAKES_KERNELS = re.compile(
    rb"^(?:from|import) (?:numba|polyida import jit|polyida\.jit)\b|^class \w+\(NamedTuple\)|^# constants of compiled code", re.MULTILINE
)
PLAIN = os.environ.get("POLYIDA_PLAIN_NUMBA", "0") not in ("", "0")  # True switches the faster compilers off
_lock = threading.RLock()


def sources(folder):
    """(path, content) of each file below the folder that makes compiled code, sorted."""
    for item in sorted(os.scandir(folder), key=lambda item: item.name):
        if item.is_dir() and item.name != "__pycache__":
            yield from sources(item.path)
        elif item.name.endswith(".py"):
            with open(item.path, "rb") as file:
                content = file.read()
            if _MAKES_KERNELS.search(content):
                yield item.path, content


@cache
def folder():
    """The folder of this version's kernels, created if it is missing; None if none can be written.

    It lies in the first writable one of NUMBA_CACHE_DIR, the package's `__pycache__` and the user's cache.
    """
    package = Path(__file__).parents[1]
    try:
        name = PREFIX + _digest(package)
    except OSError:
        return None
    user = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or os.path.expanduser("~/.cache")
    chosen = numba.config.CACHE_DIR
    for parent in [*([Path(chosen)] if chosen else []), package / "__pycache__", Path(user) / "polyida"]:
        if _writable(parent / name):
            _remove_old(parent, name)
            return parent / name
    return None


def _digest(package):
    """Hash of the kernels' sources, of the versions of the compilers and of the settings."""
    versions = numba.__version__, version("llvmlite"), np.__version__, sys.version
    digest = hashlib.sha256(f"{versions} {PLAIN} {numba.config.OPT} {numba.config.BOUNDSCHECK}".encode())
    for path, content in sources(package):
        digest.update(f"\n{os.path.relpath(path, package)} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:16]


def _writable(folder):
    """True if the folder exists, or can be created, and can be written. Its time becomes that of its last use."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _remove_old(parent, name):
    """Remove other folders except the OLD_FOLDERS last used ones and those used within UNUSED seconds."""
    used = []
    for other in parent.glob(PREFIX + "*"):
        try:
            used.append((other.stat().st_mtime, other))
        except OSError:
            continue  # another process removed it
    others = sorted((item for item in used if item[1].name != name), reverse=True)
    for last, other in others[OLD_FOLDERS:]:
        if time.time() - last > UNUSED:
            shutil.rmtree(other, ignore_errors=True)


@cache
def remove_old_own(module):
    """Remove files of users' functions, which a module compiles, except the USER_FILES last written; once in a process."""
    files = []
    for path in (folder() or Path(os.devnull)).rglob(f"{module}.*"):
        with suppress(OSError):  # another process removed it
            files.append((path.stat().st_mtime, path))
    for _, path in sorted(files, reverse=True)[USER_FILES:]:
        path.unlink(missing_ok=True)


@contextmanager
def cache_folder():
    """Within this context numba caches decorated functions in `folder()`; yields True if there is one."""
    with _lock:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(folder() or "")
        try:
            yield folder() is not None
        finally:
            numba.config.CACHE_DIR = before


class Files:
    """The files of an entry's kernels: one for each signature, named after it.

    numba numbers its files and stores the numbers in an index. Two processes that compile at the same time use the same number; then the code
    of one signature is loaded for another.
    """

    def __init__(self, folder, name):
        """Take the folder of the files and the beginning of their names."""
        self.folder, self.name = folder, name

    def save(self, key, data):
        """Write the code of a signature. If this fails, the next process compiles again."""
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
        """The code of a signature; None if there is none."""
        try:
            with open(self._path(key), "rb") as file:
                stored, data = pickle.load(file)
        except Exception:  # noqa: BLE001 a damaged file raises anything
            return None
        return data if stored == key else None

    def _path(self, key):
        """Path of the file of a signature's machine code; the name ends with a hash of the key."""
        return os.path.join(self.folder, f"{self.name}.{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}.nbc")
