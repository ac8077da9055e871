"""Progress bars on the error stream, drawn by whoever reports: no thread takes time from the run that is measured."""

import time
from contextlib import contextmanager

EVERY = 0.2  # s between two drawings


@contextmanager
def bars(stream=None):
    """Context that gives `tell(label, fraction, detail="")`: one bar a label; fraction None: end unknown."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn(),
               TextColumn("{task.fields[detail]}"))
    console = Console(file=stream) if stream else Console(stderr=True)
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
