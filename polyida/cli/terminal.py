"""The terminal: tables, lines and progress bars on it, and what it cannot take: letters without a code, output to a place that is full."""

import os
import sys
import time
from contextlib import contextmanager, suppress

from polyida.errors import InputError

EVERY = 0.2  # s between two drawings of a progress bar


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
def bars():
    """Context that gives `tell(label, fraction, detail="")`: one bar a label on the error stream; fraction None: end unknown.

    Drawn by whoever reports: no thread takes time from the run that is measured.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[detail]}"),
    )
    console = Console(stderr=True)
    quiet = {"auto_refresh": False, "transient": True, "redirect_stdout": False, "redirect_stderr": False}
    with Progress(*columns, console=console, disable=not console.is_terminal, **quiet) as progress:
        tasks, drawn = {}, [0.0]

        def tell(label, fraction, detail=""):
            new = label not in tasks
            now = time.monotonic()
            if not new and now - drawn[0] < EVERY and not (fraction is not None and fraction >= 1):
                return
            drawn[0] = now
            if new:
                _finish(progress, tasks)
                tasks[label] = progress.add_task(label, total=None if fraction is None else 1.0, detail="")
            progress.update(tasks[label], completed=fraction or 0.0, detail=detail)
            progress.refresh()

        yield tell


def _finish(progress, tasks):
    """A stage begins, so those before it are over, also those whose end was not known."""
    for task in tasks.values():
        progress.update(task, total=1.0, completed=1.0)
