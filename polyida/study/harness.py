"""Many runs, one table: a study's tasks are independent, each leaves one file, and what is there is not run again."""

import hashlib
import inspect
import json
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

from polyida.study.isolation import Worker, attempt, plain


@dataclass(frozen=True)
class Study:
    """What to vary, what to measure, what to plot.

    tasks(quick): list of dictionaries of plain values, one a run. run(**task): a dictionary of plain values, the row's
    results. figures(rows): {name: number}, the study's findings. draw(rows, folder): writes pictures, returns their
    paths. notes(rows): lines that say what failed and what the numbers mean. figures, draw and notes may be tuples of
    such functions, each formed alone: rows that are missing spoil no more than what needs them. headline: names of
    figures that are there in any case, NaN where their rows are missing. columns: of the table, all where empty.
    isolated: run each task in a process of its own, so that a crash is a row; limit: seconds after which it counts as
    hanging; fresh: a new process for each, or else one for all that is replaced after a crash or a hang (starting one
    costs about a second). options: {name: (meaning, function of its value -> Study)}, further options of the command and
    the study that each makes of this one.
    """

    name: str
    title: str
    tasks: Callable
    run: Callable
    figures: Callable | tuple
    draw: Callable | tuple = lambda rows, folder: []
    columns: tuple = ()
    isolated: bool = False
    limit: float = 600.0
    notes: Callable | tuple = field(default=lambda rows: [])
    fresh: bool = True
    headline: tuple = ()
    options: dict = field(default_factory=dict)


def key_of(study, task):
    """File name of a task: stable for the same values."""
    text = json.dumps(task, sort_keys=True, default=str)
    return hashlib.sha256(f"{study.name} {text}".encode()).hexdigest()[:16]


def code_mark(study):
    """A mark of the source of the package and of what lies beside the study: results with another one were made by other code."""
    return _mark(_folder(study.run))


@lru_cache(maxsize=4)
def _mark(folder):
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    beside = [*folder.glob("*.py"), *folder.glob("*/*.py")] if folder else []
    for root, paths in ((package, package.rglob("*.py")), (folder, beside)):
        for path in sorted(paths):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _folder(run):
    """The folder of a study whose tasks this function runs, above those of its packages; None where no file tells."""
    try:
        folder = Path(inspect.getfile(run)).resolve().parent
    except TypeError:
        return None
    while (folder / "__init__.py").exists():
        folder = folder.parent
    return folder


def write_whole(path, text):
    """Write a text file so that it is there whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(partial, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def results(study, quick, folder, progress=lambda done, total, task: None):
    """The rows of all tasks: those with a whole file in `folder` are read, the others run. A failing run is a row."""
    folder.mkdir(parents=True, exist_ok=True)
    _remove_litter(folder)
    rows, tasks = [], study.tasks(quick)
    with Worker() as worker:
        for done, task in enumerate(tasks):
            progress(done, len(tasks), task)
            path = folder / f"{key_of(study, task)}.json"
            if _read(path) is None:
                row = _run(study, worker, task)
                write_whole(path, json.dumps({"row": task | row, "code": code_mark(study)}, default=plain))
            rows.append(_read(path)["row"])
    progress(len(tasks), len(tasks), {})
    return rows


def of_other_code(study, quick, folder):
    """How many tasks have a result that was made by other code than this."""
    found = [_read(folder / f"{key_of(study, task)}.json") for task in study.tasks(quick)]
    return sum(data is not None and data["code"] != code_mark(study) for data in found)


def _run(study, worker, task):
    if not study.isolated:
        return attempt(study.run, task)
    row = worker.call(study.run, task, study.limit)
    if study.fresh:
        worker.close()
    return row


def _read(path):
    """{"row", "code"} of a task's file, or None where there is none that is whole."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return data if isinstance(data, dict) and isinstance(data.get("row"), dict) and "code" in data else None


def _remove_litter(folder):
    """Remove what processes that were killed while writing have left."""
    for path in folder.glob(".*.json.*.part"):
        with suppress(OSError, ValueError):
            if not _lives(int(path.name.split(".")[-2])):
                path.unlink()


def _lives(number):
    if os.name != "posix":
        return True
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
