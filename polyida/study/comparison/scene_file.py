"""What a user's file makes, given as `my_scene.py:build`. The file is code and is executed: give what you trust."""

import importlib.util
import sys
import traceback
from contextlib import contextmanager, suppress
from pathlib import Path

from polyida import registry
from polyida.errors import InputError


class SceneFileError(InputError):
    """An exception of the user's own code.

    trace: its traceback, shortened to the lines of that file; empty for an input error.
    """

    def __init__(self, message, trace):
        super().__init__(message)
        self.trace = trace


def named(spec, book, is_one, what):
    """What `file.py:name` names: one of the file's, or one that it has added to `book`, a dictionary of the registry.

    is_one: tells of a value whether it can be what is meant; what: the word for these. Raises InputError where file or name is missing or
    the file fails.
    """
    path, _, name = spec.rpartition(":")
    if not path.endswith(".py"):
        raise InputError(f"{spec}: say which of its {what} is meant, as in {spec}:NAME")
    module = executed(Path(path))
    found = getattr(module, name, None) or registry.find(book, name)
    if not is_one(found):
        own = [
            key
            for key, value in vars(module).items()
            if is_one(value) and (not hasattr(value, "__qualname__") or value.__module__ == module.__name__)
        ]
        raise InputError(f"{path}: it has no {name!r}; {what} there: {', '.join(own) or 'none'}")
    return found


def executed(path):
    """The module that a user's file makes; what it adds to the registry is there then. Raises InputError as `named` does."""
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    with users_code(path):
        return _execute(path)


@contextmanager
def users_code(path):
    """Turn exceptions that pass through the user's file into SceneFileError; input errors gain the line number."""
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        lines = _lines_of(error, path)
        if not lines:
            raise
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        message = f"{path}, line {lines[-1].lineno}: {kind}{error.msg if isinstance(error, SyntaxError) else error}"
        raise SceneFileError(message, "" if isinstance(error, InputError) else _shortened(error, lines)) from error


def _execute(path):
    """Import the file as a module, with its folder first on the path, as Python does for a script.

    It has the name that `import` gives it, so that other processes find its functions and result files its classes,
    where that is free.
    """
    place, known = path.resolve(), None
    sys.path.insert(0, str(place.parent))
    importlib.invalidate_caches()
    with suppress(ImportError, ValueError):
        known = importlib.util.find_spec(path.stem)
    name = path.stem if known and known.origin == str(place) else f"scene_file_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _lines_of(error, path):
    """Frames of the traceback that lie in the user's file; for a syntax error in it, the place of the error."""
    if isinstance(error, SyntaxError) and error.filename and Path(error.filename).resolve() == path.resolve():
        return [traceback.FrameSummary(str(path), error.lineno or 0, path.stem, line=(error.text or "").strip())]
    frames = traceback.extract_tb(error.__traceback__)
    return [frame for frame in frames if Path(frame.filename).resolve() == path.resolve()]


def _shortened(error, lines):
    parts = traceback.format_list(lines)
    if not isinstance(error, SyntaxError):
        parts += traceback.format_exception_only(error)
    return "".join(parts).rstrip()
