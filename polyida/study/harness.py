"""Many runs, one table: a study's tasks are independent, each leaves one file, and what is there is not run again."""

import hashlib
import inspect
import json
import os
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, as_completed
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path

from polyida.errors import InputError
from polyida.study.isolation import Isolated, Serial, attempt, plain, told


def _nothing(rows):
    return []


@dataclass(frozen=True)
class Study:
    """What to vary, what to measure, what to plot.

    tasks(quick): list of dictionaries of plain values, one a run. run(**task): a dictionary of plain values, the row's results.
    figures(rows): {name: number}, the study's findings. draw(rows): pictures of the report (`polyida.show.html.Picture`). notes(rows):
    lines that say what failed and what the numbers mean. figures, draw and notes may be tuples of such functions, each formed alone: rows
    that are missing spoil no more than what needs them. headline: names of figures that are there in any case, NaN where their rows are
    missing. columns: of the table, all where empty. isolated: run each task in a process of its own, so that a crash is a row; limit:
    seconds after which it counts as hanging; fresh: a new process for each, or else one for all that is replaced after a crash or a hang
    (starting one costs about a second). options: {name: (meaning, function of its value -> Study)}, further options of the command and the
    study that each makes of this one.
    """

    name: str
    title: str
    tasks: Callable
    run: Callable
    figures: Callable | tuple
    draw: Callable | tuple = field(default_factory=lambda: _nothing)
    columns: tuple = ()
    isolated: bool = False
    limit: float = 600.0
    notes: Callable | tuple = field(default_factory=lambda: _nothing)
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


def package_mark():
    """The same of the package alone."""
    return _mark(None)


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
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def results(study, quick, folder, progress=lambda done, total, task: None):
    """The rows of all tasks: those with a whole file in `folder` are read, the others run. A failing run is a row."""
    tasks = study.tasks(quick)
    with Isolated(study.limit, study.fresh) if study.isolated else Serial() as executor:
        names = [key_of(study, task) for task in tasks]
        return collected(partial(executor.submit, attempt, function=study.run), tasks, names, Shelf(folder, code_mark(study)), progress)[0]


def collected(submit, tasks, names, shelf, progress=lambda done, total, task: None):
    """(rows of all tasks in their order, how many were run now): those that the shelf has are read, the others run.

    submit(arguments=task): a concurrent.futures.Future of the task's row. names: one a task; what is there twice runs once.
    Rows are put on the shelf as they come. progress: called with how many rows there are, of how many, and the first task that has none,
    {} in the end. Ctrl-C, and what progress raises, calls off the tasks that have not begun.
    """
    shelf.tidy()
    rows = {name: row for name, task in dict(zip(names, tasks)).items() if (row := shelf.read(name, task)) is not None}
    waiting = {name: task for name, task in zip(names, tasks) if name not in rows}
    total, ran = len(rows) + len(waiting), len(waiting)
    progress(len(rows), total, next(iter(waiting.values()), {}))
    with closing(_ended(submit, dict(waiting))) as ended:
        for name, row in ended:
            rows[name] = shelf.put(name, waiting.pop(name), row)
            progress(len(rows), total, next(iter(waiting.values()), {}))
    return [rows[name] for name in names], ran


def _ended(submit, waiting):
    """(name, row) of each task as it ends."""
    futures = {}
    try:
        for name, task in waiting.items():
            future = _submitted(submit, task)
            if future.done():
                yield name, _row(future)
            else:
                futures[future] = name
        for future in as_completed(futures):
            yield futures[future], _row(future)
    finally:
        for future in futures:
            future.cancel()


def _submitted(submit, task):
    """The future of a task; one that failed where the executor broke before."""
    try:
        return submit(arguments=task)
    except BrokenExecutor as error:
        future = Future()
        future.set_exception(error)
        return future
    except RuntimeError as error:
        raise InputError(f"executor: it takes no work: {error}") from None


def _row(future):
    """What a future gives; where its process or its machine was lost, {"error"}."""
    try:
        return future.result()
    except Exception as error:  # noqa: BLE001, whatever an executor answers
        return {"error": told(error)}


@dataclass(frozen=True)
class Shelf:
    """Rows by name, one file each in `folder`, whole or not at all; without a folder nothing is kept.

    Beside each stand its case and code, the mark of what makes it. again: rows with an error count as not there. InputError where a row or
    the folder cannot be written: those before are kept.
    """

    folder: Path | None = None
    code: str = ""
    again: bool = False

    def tidy(self):
        """Have the folder there, without what killed processes left half written."""
        if self.folder:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"the folder of rows {self.folder} cannot be made: {error.strerror}") from error
            # remove what processes that were killed while writing have left
            for path in self.folder.glob(".*.json.*.part"):
                with suppress(OSError, ValueError):
                    if not _lives(int(path.name.split(".")[-2])):
                        path.unlink()

    def read(self, name, case):
        """The row of a case by its name, or None: where there is no file, or another case's is in its place."""
        data = _read(self._path(name)) if self.folder else None
        if data is None or self.again and data["row"].get("error"):
            return None
        shown = {name: data["row"].get(name) for name in case} if self.again else case  # a study's rows may have other values there
        text = [json.dumps(values, sort_keys=True, default=plain) for values in (case, shown, data.get("case"))]  # nan is nan there
        return data["row"] if text[0] == text[1] == text[2] else None

    def put(self, name, case, row):
        """Keep the row of a case, which is this with what it gave; returns it as it is read."""
        text = json.dumps({"row": case | row, "case": case, "code": self.code}, default=plain)
        if self.folder:
            try:
                write_whole(self._path(name), text)
            except OSError as error:
                kept = len([path for path in self.folder.glob("*.json") if path.is_file()])
                reason = f"{self._path(name)} cannot be written: {error.strerror or error}"
                raise InputError(f"{reason}; {kept} rows are kept in that folder, the same call goes on from them") from error
        return json.loads(text)["row"]

    def _path(self, name):
        return self.folder / f"{name}.json"


def of_other_code(study, quick, folder):
    """How many tasks have a result that was made by other code than this."""
    found = [_read(folder / f"{key_of(study, task)}.json") for task in study.tasks(quick)]
    return sum(data is not None and data["code"] != code_mark(study) for data in found)


def _read(path):
    """{"row", "code"} of a task's file, or None where there is none that is whole."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return data if isinstance(data, dict) and isinstance(data.get("row"), dict) and "code" in data else None


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
