"""`sweep`: a user's function over many cases; each case is a row, wherever it runs."""

from __future__ import annotations

import hashlib
import inspect
import json
import pickle
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import polyida
from polyida.errors import InputError
from polyida.fingerprint import NoFingerprint, fingerprint_of
from polyida.progress import teller
from polyida.show.axes import finish
from polyida.show.styles import FAILED, literal, marker_style, on_axes
from polyida.study.executors import COSTS, RESERVED, Isolated, SerialExecutor, run_measured_case, to_plain_value
from polyida.study.kept import require_folder
from polyida.study.result import Result
from polyida.study.tasks import RowFolder, collect_rows, package_hash
from polyida.validation import is_number, named_keywords, one_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEADINGS = {"cpu_s": ("CPU s", "{:.3g}"), "wall_s": ("wall s", "{:.3g}"), "memory_mb": ("memory MB", "{:.0f}")}


class Sweep(Result):
    """Result of `sweep`.

    Parameters
    ----------
    title : str
        Title of the report.
    rows : list of dict
        A row for each case, in the order of the cases.
    ran : int
        Number of cases that this call ran; the others were read.
    varied : list of str
        Names of the arguments of the cases.
    notes : list of str
        Lines on failures.
    """

    def __init__(self, title: str, rows: list[dict], ran: int, varied: list[str], notes: list[str]) -> None:
        """Take the parts of the class's description, and give each column a heading and a format of its values."""
        super().__init__(rows, notes)
        self.title = title
        self.ran = ran
        self.varied = varied
        names = dict.fromkeys(name for row in self.rows for name in row if name != "traceback")
        numeric = {name: all(is_number(row.get(name, 0.0)) for row in self.rows) for name in names}
        self.columns = {name: HEADINGS.get(name, (name, "{:.6g}" if numeric[name] else "{}")) for name in names}

    @named_keywords
    def plot(self, x: str | None = None, y: str | None = None, axes: Axes | None = None, title: str | None = None) -> Axes:
        """Draw one column over another, a point for each case that has both. Cases that failed are crosses at the lower edge.

        Parameters
        ----------
        x, y : str, optional
            Default: the first number of the cases and the first number that the function returned.
        axes : Axes, optional
            New pyplot axes if None.
        title : str, optional
            None: no title.

        Returns
        -------
        axes : Axes

        Raises
        ------
        InputError
            If no case has both numbers.
        """
        for name, value in (("x", x), ("y", y)):
            if value is not None:
                one_of("Sweep.plot", name, value, self.columns)
        first_x, first_y = self._first_numbers()
        x, y = x or first_x, y or first_y
        points = [(row[x], row[y]) for row in self.rows if is_number(row.get(x)) and is_number(row.get(y))]
        if not points:
            raise InputError(f"Sweep.plot: no case has numbers x = {x!r} and y = {y!r}; there are {', '.join(self.columns)}")
        with on_axes(axes) as axis:
            axis.plot(*zip(*points), **marker_style(0) | {"linestyle": "none"})
            if failed := [row[x] for row in self.rows if row.get("error") and is_number(row.get(x)) and not is_number(row.get(y))]:
                cross: dict[str, Any] = {
                    "marker": "x",
                    "linestyle": "none",
                    "color": FAILED,
                    "clip_on": False,
                    "transform": axis.get_xaxis_transform(),
                }
                axis.plot(failed, [0.0] * len(failed), label=f"{len(failed)} failed", **cross)
            axis.set(xlabel=literal(x), ylabel=literal(y))
            return finish(axis, title)

    def pictures(self) -> dict:
        """The first number that the function returned over the first number of the cases."""
        x, y = self._first_numbers()
        return {"sweep": (f"{y} of each case against {x}.", lambda axes: self.plot(x, y, axes))} if x and y else {}

    def _first_numbers(self):
        """[name of the first varied column, name of the first column of results] with a number in some row.

        None stands for one that is missing.
        """
        results = [name for name in self.columns if name not in self.varied and name not in RESERVED]
        numeric = [[name for name in names if any(is_number(row.get(name)) for row in self.rows)] for names in (self.varied, results)]
        return [next(iter(names), None) for names in numeric]


@named_keywords
def sweep(
    function: Callable[..., dict],
    cases: Iterable[dict],
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> Sweep:
    """Run `function(**case)` for every case; the rows do not depend on where the cases run.

    Parameters
    ----------
    function : callable
        Returns a dictionary of plain values: numbers, texts, True, False, None, and lists and dictionaries of them.
    cases : iterable of dict
        Arguments as plain values. Equal cases run once.
    executor : concurrent.futures.Executor, optional
        For example a ProcessPoolExecutor, `client.get_executor()` of Dask, or `pi.study.Isolated()`. None: the cases run here one after the
        other.
    folder : str or Path, optional
        Folder with a file for each finished row. A later call with the same folder, for example after Ctrl-C or the end of a cluster job,
        runs only the missing and the failed cases.
    progress : callable or bool, optional
        Function of (done, total, description of the first case without a row); by default a bar of tqdm at a terminal and in a
        notebook; False: none.

    Returns
    -------
    result : Sweep
        A row is the case, the result of the function and

        - error : the reason of a failure with a "traceback", or empty. A case whose process or machine is lost is a row, too.
        - cpu_s, wall_s : s, without compiling and loading kernels
        - memory_mb : largest resident memory of the process during the case, Python and libraries included. Outside Linux: since the start
          of the process.

        Costs are of the whole process, so cases in threads count each other's; they are None if the process was lost.

    Raises
    ------
    InputError
        For invalid arguments, before the first case.
    KeyboardInterrupt
        After Ctrl-C.

    Notes
    -----
    A row in the folder is identified by its case, by polyida's version and source, and by the code of the function and of everything that it
    names in the user's modules: functions, classes, values, defaults and closures. Changed code gives new rows; the old ones stay. Installed
    packages, files that the function reads, and lists and dictionaries that it fills are not part of the identity.
    """
    cases = _checked_cases(function, cases)
    _require_executor(function, executor)
    rows_in_folder = _row_folder(function, folder)
    keys = [_key(rows_in_folder.code, case) for case in cases]
    executor, sweep_id = executor or SerialExecutor(), uuid4().hex

    def submit(arguments):
        """The Future of the row of one case. Raises InputError if the function cannot be sent to a process."""
        try:
            return executor.submit(run_measured_case, function=function, arguments=arguments, sweep_id=sweep_id)
        except (TypeError, AttributeError, pickle.PickleError) as error:
            raise InputError(_cannot_send(function, error)) from error

    with teller("sweep", progress) as report:

        def tell(done, total, case):
            """Report the progress of the sweep, (done, total), and the values of the present case as a text."""
            report(done, total, ", ".join(f"{name} {value}" for name, value in case.items()))

        rows, ran = collect_rows(submit, cases, keys, rows_in_folder, tell)
    varied = list(dict.fromkeys(name for case in cases for name in case))
    rows_with_costs = [row | {cost: row.get(cost) for cost in COSTS} for row in rows]
    return Sweep(f"sweep of {_name_of(function)}", rows_with_costs, ran, varied, _notes(rows, len(keys) - len(set(keys))))


def _key(code, case):
    """The identity of a row: a hash of the code that computes it and of its case."""
    text = json.dumps(to_plain_value("case", case), sort_keys=True)
    return hashlib.sha256(f"{code} {text}".encode()).hexdigest()[:32]


def _notes(rows, repeated):
    """Lines on cases that failed, that were lost with their process, and on the number of repeated ones."""
    failed = [row for row in rows if row["error"]]
    notes = [f"{len(failed)} of {len(rows)} cases failed; the first: {failed[0]['error']}"] if failed else []
    if lost := sum(row["error"].startswith("BrokenProcessPool") for row in failed):
        notes.append(f"{lost} of them were lost with the pool of processes; executor=pi.study.Isolated() shows which case ends its process")
    if repeated:
        notes.append(f"{repeated} cases were given more than once; each case ran once")
    return notes


def _checked_cases(function, cases):
    """The cases as a list. Raises InputError unless the function accepts each of them."""
    if not callable(function):
        raise InputError(f"sweep: function = {function!r} must be a function that gives a dictionary")
    try:
        cases = list(cases)
    except TypeError:
        raise InputError(f"sweep: cases = {cases!r} must be a list of dictionaries, one a case") from None
    if not cases:
        raise InputError("sweep: cases has no case in it")
    try:
        signature = inspect.signature(function)
    except ValueError:  # some compiled functions have none
        signature = None
    for k, case in enumerate(cases):
        if not isinstance(case, dict) or not all(isinstance(name, str) for name in case):
            raise InputError(f"sweep: cases[{k}] = {case!r} must be a dictionary {{argument of the function: value}}")
        if reserved := [name for name in case if name in RESERVED]:
            raise InputError(f"sweep: cases[{k}] has {reserved[0]!r}, which is a reserved column; use another name")
        to_plain_value(f"sweep: cases[{k}]", case)
        try:
            signature and signature.bind(**case)
        except TypeError as error:
            raise InputError(f"sweep: cases[{k}] does not fit {_name_of(function)}{signature}: {error}") from None
    return cases


def _require_executor(function, executor):
    """Raise InputError unless this is an executor of concurrent.futures, or None, and the function can be sent to its processes."""
    if executor is None:
        return
    if not isinstance(executor, Executor):
        is_client = hasattr(executor, "get_executor")
        hint = "give client.get_executor()" if is_client else "as ProcessPoolExecutor() or Dask's client.get_executor()"
        raise InputError(f"sweep: executor = {executor!r} must be an executor of concurrent.futures; {hint}")
    if isinstance(executor, (ProcessPoolExecutor, Isolated)):  # they send functions by the names of their modules
        try:
            pickle.dumps(function)
        except Exception as error:  # noqa: BLE001, pickling may raise anything
            raise InputError(_cannot_send(function, error)) from None


def _cannot_send(function, error):
    """Message for a function that cannot be pickled: its first cause, and advice."""
    while error.__cause__ is not None or error.__context__ is not None:
        error = error.__cause__ or error.__context__
    advice = "write it as a function of a module or of the script, with all it needs in its case"
    return f"sweep: {_name_of(function)} cannot be sent to other processes ({error}); {advice}"


def _row_folder(function, folder):
    """The RowFolder of a sweep, with a fingerprint of the package's and the user's code. Raises InputError without one."""
    if folder is None:
        return RowFolder()
    folder = require_folder("sweep", folder, "folder")
    try:
        code = fingerprint_of(function)
    except NoFingerprint as error:
        advice = "make it within the function, give what it is made of by the case, or sweep without a folder"
        raise InputError(f"sweep: {_name_of(function)} uses {error}; {advice}") from None
    return RowFolder(folder, f"{polyida.__version__} {package_hash()} {code}", retry_failed=True)


def _name_of(function):
    """Name of a function in messages; the repr of a callable without a name."""
    return getattr(function, "__name__", None) or repr(function)
