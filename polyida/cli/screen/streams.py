"""Standard output and the error stream: lines on them, one document, and what they cannot take: letters without a code, a full place."""

import json
import os
import sys
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress

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


def lines(*given, style=None):
    """Print lines, empty ones left out."""
    from rich.console import Console
    from rich.text import Text

    for line in filter(None, given):
        Console().print(Text(line, style=style or ""), soft_wrap=True)


def error(message, trace=""):
    """One red line on the error stream; under it the user's own traceback where the fault is in their file."""
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True)
    console.print(Text(message, style="red"), soft_wrap=True)
    if trace:
        console.print(Text(trace), soft_wrap=True)


@contextmanager
def document(wanted):
    """Context of `--json`, where that is `wanted`: what is printed within goes to the error stream.

    Gives a function that takes the one document, plain data, which goes to standard output at the end, also where the command leaves with
    1.
    """
    out, given = sys.stdout, []
    try:
        with redirect_stdout(sys.stderr) if wanted else nullcontext():
            yield given.append
    finally:
        if wanted and given:
            from polyida.show.page import finite

            print(json.dumps(finite(given[-1]), indent=1, allow_nan=False), file=out)
