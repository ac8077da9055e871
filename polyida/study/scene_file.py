"""A function of a user's file, given as `my_scene.py:build`. The file is code and is executed: give what you trust."""

import importlib.util
import sys
import traceback
from contextlib import contextmanager
from pathlib import Path

from polyida.errors import InputError


class SceneFileError(InputError):
    """An exception of the user's own code.

    trace: its traceback, shortened to the lines of that file; empty for an input error.
    """

    def __init__(self, message, trace):
        super().__init__(message)
        self.trace = trace


def function(spec):
    """The function that `file.py:name` names. Raises InputError where file or function is missing or the file fails."""
    path, _, name = spec.rpartition(":")
    if not path.endswith(".py"):
        raise InputError(f"{spec}: say which function builds the scene, as in my_scene.py:build")
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    with users_code(path):
        module = _execute(path)
    found = getattr(module, name, None)
    if not callable(found):
        own = [key for key, value in vars(module).items()
               if callable(value) and getattr(value, "__module__", None) == module.__name__]
        raise InputError(f"{path}: it has no function {name!r}; functions there: {', '.join(own) or 'none'}")
    return found


@contextmanager
def users_code(path):
    """Turn exceptions that pass through the user's file into SceneFileError; input errors gain the line number."""
    try:
        yield
    except (Exception, SystemExit) as error:
        lines = _lines_of(error, path)
        if not lines:
            raise
        kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
        message = f"{path}, line {lines[-1].lineno}: {kind}{error.msg if isinstance(error, SyntaxError) else error}"
        raise SceneFileError(message, "" if isinstance(error, InputError) else _shortened(error, lines)) from error


def _execute(path):
    """Import the file as a module, with its folder first on the path, as Python does for a script."""
    spec = importlib.util.spec_from_file_location(f"scene_file_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    sys.path.insert(0, str(path.resolve().parent))
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
