"""Where the commands write: files and folders that are free, or may be replaced."""

from contextlib import contextmanager

from polyida.errors import InputError


def free(given, default, overwrite, tell):
    """Where to write: a given path must be free unless `overwrite`; the default gets a number where it is taken.

    tell: called with a line that says so. A symlink is followed. Raises InputError where the path is taken.
    """
    path, number = given or default, 2
    path = _resolved(path) if path.is_symlink() else path
    if overwrite or not _taken(path):
        return path
    if given:
        raise InputError(f"{given} exists: choose another name, or say --overwrite to replace it")
    while _taken(path):
        path = default.with_name(f"{default.stem}-{number}{default.suffix}")
        number += 1
    tell(f"{default} exists and is kept; writing {path}")
    return path


def _resolved(link):
    try:
        return link.resolve()
    except (OSError, RuntimeError):
        raise InputError(f"{link} is a symlink that leads nowhere but to itself") from None


def _taken(path):
    return path.exists() and not (path.is_dir() and not any(path.iterdir()))


def make(folder):
    """Make a folder with those above it. Raises InputError where that cannot be done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: the folder cannot be made ({error.strerror})") from error


@contextmanager
def made(folder):
    """A folder made before the run, so that it is known at once if it cannot be; removed if nothing came into it."""
    make(folder)
    try:
        yield
    finally:
        if not any(folder.iterdir()):
            folder.rmdir()
