"""The line that the binding prints when SUNDIALS gives up becomes a message; all else printed passes through."""

import re
import sys
import threading

_ERROR = re.compile(r"\[IDA\w*, Error: -?\d+\] (.*)", re.DOTALL)
_lock = threading.Lock()
_open: list = []  # the filter in place and, as often as it is in use, a further entry
_last: list = []  # the last filter: making one would cost as much as a step of a small model


class _Filter:
    """Stands in for sys.stdout. `message` is the last error line of this thread, or an empty text."""

    def __init__(self, stream):
        self.stream, self._seen = stream, threading.local()

    @property
    def message(self):
        return getattr(self._seen, "message", "")

    @message.setter
    def message(self, text):
        self._seen.message = text

    def write(self, text):
        found = _ERROR.search(text)
        if found:
            self.message, self._seen.line_ends = " ".join(found[1].split()), True
        elif text == "\n" and getattr(self._seen, "line_ends", False):
            self._seen.line_ends = False
        else:
            self.stream.write(text)
        return len(text)

    def __getattr__(self, name):
        return getattr(self.stream, name)


class error_lines_kept:  # noqa: N801, used as a function; a generator would cost as much as the step that it is for
    """Within it, SUNDIALS' error lines go to the `message` of the object it gives. Threads may share it."""

    def __enter__(self):
        with _lock:
            if not _open:
                if not _last or _last[0].stream is not sys.stdout:
                    _last[:] = [_Filter(sys.stdout)]
                sys.stdout = _last[0]
                _open.append(_last[0])
            _open.append(_open[0])
            _open[0].message = ""
            return _open[0]

    def __exit__(self, *error):
        with _lock:
            _open.pop()
            if len(_open) == 1 and sys.stdout is _open.pop():
                sys.stdout = sys.stdout.stream
