"""Files that are whole or not there: each is written aside, under a name of its own, and then moved to its place.

A process that is killed leaves the old file, and one beside it that `remove_left_over` finds later.
"""

import os
import shutil
import time
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from polyida.errors import InputError

PART = ".polyida-{}.part"  # name of an unfinished file, before its suffix
OLD = 3600.0  # s: an unfinished file that nobody has written to for so long is left over


@contextmanager
def replacing(path, sync=False):
    """Context that gives a path to write to; at its end that file is moved to `path`, after an error it is removed.

    The name differs in every call, in threads and on other machines, and has the suffix of `path`. Symbolic links are followed; a device or a
    pipe is written in place. sync: the file is on the disk before it is moved.
    """
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file() and not path.is_dir():
        yield path
        return
    part = path.with_name(PART.format(uuid4().hex) + path.suffix)
    try:
        yield part
        if sync:
            with open(part, "rb+") as file:
                os.fsync(file.fileno())
        if path.exists():
            shutil.copymode(path, part)
        os.replace(part, path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


def write_file(path, content, sync=False):
    """Write text (UTF-8) or bytes to a file that is replaced when they are whole."""
    with replacing(path, sync) as part:
        part.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)


def remove_left_over(folder):
    """Remove unfinished files of processes that were killed."""
    for part in Path(folder).glob(PART.format("*") + "*"):
        with suppress(OSError):
            if part.is_file() and time.time() - part.stat().st_mtime > OLD:
                part.unlink()


@contextmanager
def disk_errors(part):
    """Context that turns errors of the disk, such as a full one, into an InputError in the name of `part`."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{part} cannot be written: {error.strerror or error}; what was there is kept") from error
