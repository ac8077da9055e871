"""Error lines of IDA, which its binding prints to sys.stdout, as messages of the thread that runs it."""

import re
import sys
import threading
from traceback import extract_tb

ERROR_LINE = re.compile(r"\[IDA\w*, Error: -?\d+\] (.*)", re.DOTALL)


class ErrorLines:
    """Replaces sys.stdout while a thread is within it: the error line that the binding prints becomes a message, other text passes through.

    It returns an object whose `message` is the thread's last error line, or empty.
    """

    def __init__(self):
        """Begin without threads within it; sys.stdout stays as it is."""
        self.lock, self.users, self.stream, self.printed = threading.Lock(), 0, None, threading.local()

    def __enter__(self):
        """Begin to read what this thread prints; returns the object with its `message`."""
        with self.lock:
            self.users += 1
            if sys.stdout is not self:
                self.stream, sys.stdout = sys.stdout, self
        self.printed.message, self.printed.line_ends = "", False
        return self.printed

    def __exit__(self, *error):
        """End for this thread; the last one puts the former sys.stdout back."""
        with self.lock:
            self.users -= 1
            if not self.users and sys.stdout is self:
                sys.stdout = self.stream

    def write(self, text):
        """Keep an error line of IDA as the message of this thread, without the end of its line; pass any other text on."""
        match = ERROR_LINE.search(text)
        if match:
            self.printed.message, self.printed.line_ends = " ".join(match[1].split()), True
        elif text == "\n" and getattr(self.printed, "line_ends", False):
            self.printed.line_ends = False
        else:
            self.stream.write(text)
        return len(text)

    def __getattr__(self, name):
        """Any other attribute of the former sys.stdout, such as flush."""
        return getattr(self.stream, name)


error_lines = ErrorLines()


def raised_by_binding(error):
    """True if the binding itself raised an error, not a function of a user that it called."""
    return extract_tb(error.__traceback__)[-1].filename.endswith("_cy_ida.pyx")
