"""What a terminal cannot take: letters that it has no code for, and output to a place that is full."""

import os
import sys
from contextlib import contextmanager, suppress

from polyida.errors import InputError


def tolerate_letters():
    """Letters that the terminal's encoding does not have are written as question marks."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, ValueError):  # a stream that somebody has put in the place of the terminal's
            stream.reconfigure(errors="replace")


@contextmanager
def writable():
    """What the operating system refuses within it, standard output included, is one InputError that names the place."""
    try:
        yield
        sys.stdout.flush()
    except BrokenPipeError:
        _give_up()
        sys.exit(1)
    except OSError as error:
        _give_up()
        raise InputError(f"{str(error.filename or 'standard output')[:200]}: {error.strerror or error}") from error


def _give_up():
    """Let what is still in standard output go nowhere, so that Python does not try again at its end."""
    with suppress(OSError, ValueError, AttributeError):
        sys.stdout.flush()
        return
    with suppress(OSError, ValueError, AttributeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
