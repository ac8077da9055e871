"""How far a command is, on the error stream: a bar a stage with the time left; where that is no terminal, a line now and then."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta

EVERY = 0.2  # s between two drawings of a bar
SELDOM = 30.0  # s between two lines
SETTLED = 1.0  # s of a stage after which its pace tells something
READ = 0.05  # s within which a part of a study is read, not run

Tell = Callable[..., None]


@contextmanager
def bars() -> Iterator[Tell]:
    """Context that gives `tell(label, fraction, detail="", left=None)`; fraction None: end unknown; left: s, from the pace where None.

    Drawn by whoever reports: no thread takes time from the run that is measured.
    """
    from rich.console import Console

    console = Console(stderr=True)
    if not console.is_terminal:
        yield Lines()
        return
    with _progress(console) as progress:
        yield Bars(progress)


def _progress(console):
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn
    from rich.table import Column

    columns = (
        TextColumn("{task.description}", table_column=Column(no_wrap=True, max_width=24)),
        BarColumn(bar_width=16),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[left]}", table_column=Column(no_wrap=True)),
        TextColumn("{task.fields[detail]}", markup=False, table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1)),
    )
    quiet = {"auto_refresh": False, "transient": True, "redirect_stdout": False, "redirect_stderr": False}
    return Progress(*columns, console=console, expand=True, **quiet)


class Stages:
    """When each stage began, and how long it goes on at its pace."""

    def __init__(self):
        self.begun, self.shown = {}, time.monotonic()

    def due(self, every):
        """Whether so many seconds are over since the last time that this was so."""
        now = time.monotonic()
        if over := now - self.shown >= every:
            self.shown = now
        return over

    def spent(self, label):
        """Seconds since a stage was first told."""
        now = time.monotonic()
        return now - self.begun.setdefault(label, now)

    def left(self, label, fraction):
        """Seconds until its end, None where that is not known."""
        spent = self.spent(label)
        return spent * (1 - fraction) / fraction if fraction and spent > SETTLED else None


class Bars:
    """A bar a stage."""

    def __init__(self, progress):
        self.progress, self.tasks, self.stages = progress, {}, Stages()

    def __call__(self, label, fraction, detail="", left=None):
        if new := label not in self.tasks:
            for task in self.tasks.values():  # a stage begins, so those before it are over, also those whose end was not known
                self.progress.update(task, total=1.0, completed=1.0, left="")
            self.tasks[label] = self.progress.add_task(label, total=None if fraction is None else 1.0, left="", detail="")
        if not new and not self.stages.due(EVERY) and not (fraction is not None and fraction >= 1):
            return
        left = self.stages.left(label, fraction) if left is None else left
        self.progress.update(self.tasks[label], completed=fraction or 0.0, left=in_words(left), detail=detail)
        self.progress.refresh()


class Lines:
    """A line, seldom."""

    def __init__(self):
        self.stages = Stages()

    def __call__(self, label, fraction, detail="", left=None):
        left = self.stages.left(label, fraction) if left is None else left
        if self.stages.due(SELDOM):
            done = "" if fraction is None else f"{fraction:.0%}"
            print(", ".join(filter(None, (f"{label}: {done}".rstrip(": "), in_words(left), detail))), file=sys.stderr, flush=True)


class Parts:
    """What the progress of a study tells: how many of its parts are done, and the time left, at the mean of those that were run."""

    def __init__(self, name, tell):
        self.name, self.tell, self.last, self.times = name, tell, time.monotonic(), []

    def __call__(self, done, total, task):
        now = time.monotonic()
        self.times += [now - self.last] if now - self.last > READ else []
        self.last = now
        left = (total - done) * sum(self.times) / len(self.times) if self.times else None
        named = ", ".join(f"{key} {value}" for key, value in task.items())
        self.tell(self.name, done / max(total, 1), f"{done}/{total} {named}".rstrip(), left)


def in_words(left: float | None) -> str:
    """Seconds as `0:01:30 left`, empty where they are not known."""
    return "" if left is None else f"{timedelta(seconds=round(left))} left"
