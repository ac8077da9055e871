"""Studies of many independent runs: `Study`, and a folder with one file for each finished row, so that a stopped study can continue."""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, as_completed
from contextlib import closing
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path

from polyida.errors import InputError
from polyida.files import remove_left_over, write_file
from polyida.registry import study_folder
from polyida.study.executors import Isolated, SerialExecutor, error_text, run_as_row, to_json
from polyida.validation import path_of


@dataclass(frozen=True)
class Study:
    """What to vary, what to measure and what to plot.

    Parameters
    ----------
    name, title : str
    tasks : function(quick) -> list of dict
        The arguments of each run as plain values. quick: True for a small selection.
    run : function(**task) -> dict
        One run; the results of its row as plain values.
    figures : function(rows) -> {name: number}, or a tuple of them
        The key numbers of the study. Functions of a tuple are called separately: one that fails affects no other.
    draw : function(rows) -> pictures, or a tuple of them
        The pictures of the report (`polyida.study.plotting.picture`).
    columns : tuple of str
        Columns of the table; all if empty.
    isolated : bool
        Run the tasks in a separate process, so that a crash becomes a row.
    limit : float, s
        A task that takes longer counts as hanging, if `isolated`.
    notes : function(rows) -> lines, or a tuple of them
        Lines on failures and on the meaning of numbers.
    fresh : bool
        Start a new process for each task, if `isolated`; otherwise one process runs all and is replaced after a crash.
    headline : tuple of str
        Names of figures that are always present, NaN if their rows are missing.
    options : {name: (help text, function(value) -> Study)}
        Additional options of the command line and the study that each makes of this one.
    """

    name: str
    title: str
    tasks: Callable
    run: Callable
    figures: Callable | tuple
    draw: Callable | tuple = ()
    columns: tuple = ()
    isolated: bool = False
    limit: float = 600.0
    notes: Callable | tuple = ()
    fresh: bool = True
    headline: tuple = ()
    options: dict = field(default_factory=dict)

    def __post_init__(self):
        """Check the fields of the study: its name must be one that a folder can have. Raises InputError."""
        path = path_of("Study", "name", self.name)
        if not isinstance(self.name, str) or self.name != path.name or self.name == ".." or "\\" in self.name:
            raise InputError(f"Study: name = {self.name!r:.100} must be a text that can be the name of a folder")


def task_key(study, task):
    """Name of the file of a task's row: a hash of the study's name and the task's values."""
    text = json.dumps(task, sort_keys=True, default=str)
    return hashlib.sha256(f"{study.name} {text}".encode()).hexdigest()[:16]


def code_hash(study):
    """Hash of the source of the package and of the study's folder."""
    try:
        folder = Path(inspect.getfile(study.run)).resolve().parent
    except TypeError:  # a function without a file
        return package_hash()
    while (folder / "__init__.py").exists():
        folder = folder.parent
    return package_hash(folder)


@lru_cache(maxsize=4)
def package_hash(folder=None):
    """Hash of the source of the package, and of the files in a study's folder and its packages."""
    package, problems, digest = Path(__file__).parents[1], study_folder() / "problems", hashlib.sha256()
    study_files = [*folder.glob("*.py"), *folder.glob("*/*.py")] if folder else []
    for root, paths in ((package, package.rglob("*.py")), (problems, problems.glob("*.py")), (folder, study_files)):
        for path in sorted(paths):
            if path.is_file() and not path.name.startswith("."):  # editors put links that lead nowhere beside a file
                digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def run_tasks(study, quick, folder, progress=lambda done, total, task: None, fresh=False):
    """The rows of all tasks of a study: rows with a complete file in `folder` are read unless fresh, the other tasks run."""
    tasks = study.tasks(quick)
    with Isolated(study.limit, study.fresh) if study.isolated else SerialExecutor() as executor:
        submit = partial(executor.submit, run_as_row, function=study.run)
        return collect_rows(
            submit, tasks, [task_key(study, task) for task in tasks], RowFolder(folder, code_hash(study), fresh=fresh), progress
        )[0]


def collect_rows(submit, tasks, keys, folder, progress=lambda done, total, task: None):
    """(rows of all tasks in their order, number of tasks that ran). Rows in `folder` are read, the others run and are written at once.

    submit(arguments=task) -> Future of the row. keys: file name of each task; tasks with equal keys run once. progress(rows, total, first
    task without a row). Ctrl-C, and an exception of `progress`, cancel the tasks that have not begun.
    """
    folder.prepare()
    rows = {key: row for key, task in dict(zip(keys, tasks)).items() if (row := folder.read(key, task)) is not None}
    waiting = {key: task for key, task in zip(keys, tasks) if key not in rows}
    total, count = len(rows) + len(waiting), len(waiting)
    progress(len(rows), total, next(iter(waiting.values()), {}))
    with closing(_finished_rows(submit, dict(waiting))) as finished:
        for key, row in finished:
            rows[key] = folder.write(key, waiting.pop(key), row)
            progress(len(rows), total, next(iter(waiting.values()), {}))
    return [rows[key] for key in keys], count


def _finished_rows(submit, waiting):
    """Yield (key, row) of each task as soon as it is finished."""

    def row_of(future):
        """The row of a finished Future; an exception of the executor becomes a row with an error."""
        try:
            return future.result()
        except Exception as error:  # noqa: BLE001, an executor whose process is lost may raise anything
            return {"error": error_text(error)}

    futures = {}
    try:
        for key, task in waiting.items():
            try:
                future = submit(arguments=task)
            except BrokenExecutor as error:
                future = Future()
                future.set_exception(error)
            except RuntimeError as error:
                raise InputError(f"executor: it takes no work: {error}") from None
            if future.done():
                yield key, row_of(future)
            else:
                futures[future] = key
        for future in as_completed(futures):
            yield futures[future], row_of(future)
    finally:
        for future in futures:
            future.cancel()


@dataclass(frozen=True)
class RowFolder:
    """Rows in a folder, one file each, with their case and `code`, the hash of what computes them. folder: None for none.

    Rows with an error are missing if other code computed them, and always with retry_failed. Raises InputError if a row or the folder
    cannot be written.
    """

    folder: Path | None = None
    code: str = ""
    retry_failed: bool = False
    fresh: bool = False

    def prepare(self):
        """Create the folder; remove incomplete files of processes that have ended."""
        if not self.folder:
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"the folder of rows {self.folder} cannot be made: {error.strerror}") from error
        remove_left_over(self.folder)

    def read(self, key, case):
        """The row stored in the file `key`.json, a dict, or None if the case must be run: no complete file of this case, or `fresh`.

        A row with an error counts only with the same code, and not if failed ones are to be retried. case: {name: value} of the settings.
        """
        data = _read_file(self.folder / f"{key}.json") if self.folder and not self.fresh else None
        if data is None or data["row"].get("error") and (self.retry_failed or data["code"] != self.code):
            return None
        shown = {name: data["row"].get(name) for name in case} if self.retry_failed else case  # rows of a study may replace values
        text = [
            json.dumps(values, sort_keys=True, default=to_json) for values in (case, shown, data.get("case"))
        ]  # as text, nan equals nan
        return data["row"] if text[0] == text[1] == text[2] else None

    def write(self, key, case, row):
        """Write the row of a case, the case and its result; returns it as it is read."""
        text = json.dumps({"row": case | row, "case": case, "code": self.code}, default=to_json)
        if self.folder:
            path = self.folder / f"{key}.json"
            try:
                write_file(path, text, sync=True)
            except OSError as error:
                count = len([path for path in self.folder.glob("[!.]*.json") if path.is_file()])
                reason = f"{path} cannot be written: {error.strerror or error}"
                raise InputError(f"{reason}; {count} rows are kept in that folder, the same call goes on from them") from error
        return json.loads(text)["row"]


def count_outdated(study, quick, folder):
    """Number of rows in the folder that other code computed."""
    data = [_read_file(folder / f"{task_key(study, task)}.json") for task in study.tasks(quick)]
    return sum(one is not None and one["code"] != code_hash(study) for one in data)


def _read_file(path):
    """{"row", "case", "code"} of a file, or None if it is missing or incomplete."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return data if isinstance(data, dict) and isinstance(data.get("row"), dict) and "code" in data else None
