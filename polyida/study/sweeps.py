"""`sweep`: a function of one's own over many cases, each a row, wherever they run."""

import hashlib
import inspect
import json
import pickle
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

import polyida
from polyida.errors import InputError
from polyida.mark import NoMark, mark_of
from polyida.progress import teller
from polyida.show.style import on_axes
from polyida.show.style import plain as plain_text
from polyida.study.drawing import look
from polyida.study.harness import Shelf, collected, package_mark
from polyida.study.isolation import COSTS, RESERVED, Isolated, Serial, measured, plain_value
from polyida.study.result import Result
from polyida.validation import is_number, named_keywords

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HEADINGS = {"cpu_s": ("CPU s", "{:.3g}"), "wall_s": ("wall s", "{:.3g}"), "memory_mb": ("memory MB", "{:.0f}")}
BY_NAME = (ProcessPoolExecutor, Isolated)  # executors that send functions by the names of their modules


class Sweep(Result):
    """What `sweep` gives: a Result whose rows are the cases, in their order.

    ran: how many cases were run now, the others were there. varied: names of what the cases give.
    """

    def __init__(self, title: str, rows: list[dict], ran: int, varied: list[str], notes: list[str]) -> None:
        super().__init__(rows, notes)
        self.title, self.ran, self.varied = title, ran, varied
        names = dict.fromkeys(name for row in self.rows for name in row)
        self.columns = {name: HEADINGS.get(name, (name, self._form(name))) for name in names if name != "traceback"}

    def _form(self, name):
        numbers = all(is_number(row.get(name, 0.0)) for row in self.rows)
        return "{:.6g}" if numbers else "{}"

    def plot(self, x: str | None = None, y: str | None = None, axes: "Axes | None" = None) -> "Axes":
        """Draw a column over another, a point a case, into matplotlib axes, new ones where None are given; returns the axes.

        x: by default the first number of the cases, y: the first number that the function gave. Cases without them are left out.
        Raises InputError where no case has both.
        """
        x = x or self._number(self.varied)
        y = y or self._number(self._given())
        found = [(row[x], row[y]) for row in self.rows if is_number(row.get(x)) and is_number(row.get(y))]
        if not found:
            raise InputError(f"Sweep.plot: no case has numbers x = {x!r} and y = {y!r}; there are {', '.join(self.columns)}")
        with on_axes(axes) as axis:
            axis.plot(*zip(*found), **look(0) | {"linestyle": "none"})
            axis.set(xlabel=plain_text(x), ylabel=plain_text(y))
            return axis

    def pictures(self) -> dict:
        """The first number that the function gave over the first of the cases, where there are both."""
        x, y = self._number(self.varied), self._number(self._given())
        return {"sweep": (f"{y} of each case against {x}.", lambda axes: self.plot(x, y, axes))} if x and y else {}

    def _given(self):
        """Columns of what the function gave."""
        return [name for name in self.columns if name not in self.varied and name not in RESERVED]

    def _number(self, names):
        """The first of the columns that has a number."""
        return next((name for name in names if any(is_number(row.get(name)) for row in self.rows)), None)


@named_keywords
def sweep(
    function: Callable[..., dict],
    cases: Iterable[dict],
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> Sweep:
    """Run `function(**case)` for every case; the rows of a Sweep are the same wherever the cases ran, and in their order.

    function: gives a dictionary of plain values: numbers, texts, True, False, None, and lists and dictionaries of them. cases:
    dictionaries of such values. executor: one of concurrent.futures: a ProcessPoolExecutor, `client.get_executor()` of Dask,
    `pi.study.Isolated()`; without one the cases run here, one after the other. progress: called with how many cases are done, of how
    many, and the first that is not, in words; True shows tqdm's bar.

    A row is the case, what the function gave, "error" (empty, or why the case failed, then with "traceback"), "cpu_s" and "wall_s", and
    "memory_mb": the largest resident memory of the process while the case ran, Python and libraries included, which is what a cluster is
    asked for. cpu_s and memory_mb are of the whole process: cases in threads of one process count each other's. On systems other than
    Linux memory_mb is the largest since the process began, so that of the cases before is in it. Where the process was lost these
    are None. A case that fails, or whose process or machine dies, is a row; a case that is given twice runs once.

    folder: each row is written to a file there when it comes, whole or not at all, so that after Ctrl-C, kill -9 or the end of a cluster's
    time the same call runs what is missing. What is there is not run again, unless it failed. It is found by the case, polyida's version
    and source, and the code of the function and of what that names in the user's own modules: functions, classes, values, defaults and
    closures. Changed code runs anew, and the rows of the code before stay beside. Packages that are installed do not count, nor do files
    that the function reads, nor a list or dictionary that it itself fills.

    Raises InputError for a wrong input, before the first case; KeyboardInterrupt after Ctrl-C.
    """
    cases = _require_cases(function, cases)
    _require_executor(function, executor)
    shelf = _shelf(function, folder)
    names = [_name(shelf.code, case) for case in cases]
    place, sweep_id = executor or Serial(), uuid4().hex

    def submit(arguments):
        try:
            return place.submit(measured, function=function, arguments=arguments, sweep_id=sweep_id)
        except (TypeError, AttributeError, pickle.PickleError) as error:
            raise InputError(_unsent(function, error)) from error

    in_words = lambda case: ", ".join(f"{name} {value}" for name, value in case.items())  # noqa: E731
    with teller("sweep", progress) as tell:
        rows, ran = collected(submit, cases, names, shelf, lambda done, total, case: tell(done, total, in_words(case)))
    varied = list(dict.fromkeys(name for case in cases for name in case))
    failed, lost = [row for row in rows if row["error"]], [row for row in rows if row["error"].startswith("BrokenProcessPool")]
    lines = [f"{len(failed)} of {len(rows)} cases failed; the first: {failed[0]['error']}"] if failed else []
    if lost:
        lines.append(
            f"{len(lost)} of them were lost with the pool of processes; with executor=pi.study.Isolated() the one that ends its process is told"
        )
    if twice := len(names) - len(set(names)):
        lines.append(f"{twice} of the cases were given before; each ran once")
    return Sweep(f"sweep of {_called(function)}", [row | {cost: row.get(cost) for cost in COSTS} for row in rows], ran, varied, lines)


def _require_cases(function, cases):
    """The cases as a list. Raises InputError unless the function can be called with each."""
    if not callable(function):
        raise InputError(f"sweep: function = {function!r} must be a function that gives a dictionary")
    try:
        cases = list(cases)
    except TypeError:
        raise InputError(f"sweep: cases = {cases!r} must be a list of dictionaries, one a case") from None
    if not cases:
        raise InputError("sweep: cases has no case in it")
    for k, case in enumerate(cases):
        if not isinstance(case, dict) or not all(isinstance(name, str) for name in case):
            raise InputError(f"sweep: cases[{k}] = {case!r} must be a dictionary {{argument of the function: value}}")
        if taken := [name for name in case if name in RESERVED]:
            raise InputError(f"sweep: cases[{k}] has {taken[0]!r}, which is the row's own; call it otherwise")
        plain_value(f"sweep: cases[{k}]", case)
        _require_call(function, k, case)
    return cases


def _require_call(function, k, case):
    try:
        signature = inspect.signature(function)
    except ValueError:
        return  # of some compiled functions nobody knows it
    try:
        signature.bind(**case)
    except TypeError as error:
        raise InputError(f"sweep: cases[{k}] does not fit {_called(function)}{signature}: {error}") from None


def _require_executor(function, executor):
    if executor is None:
        return
    if not isinstance(executor, Executor):
        hint = (
            "give client.get_executor()"
            if hasattr(executor, "get_executor")
            else "as ProcessPoolExecutor() or Dask's client.get_executor()"
        )
        raise InputError(f"sweep: executor = {executor!r} must be an executor of concurrent.futures; {hint}")
    if isinstance(executor, BY_NAME):
        try:
            pickle.dumps(function)
        except Exception as error:  # noqa: BLE001, whatever it holds
            raise InputError(_unsent(function, error)) from None


def _unsent(function, error):
    """What is said of a function that an executor cannot send; the first cause says what it holds."""
    while error.__cause__ is not None or error.__context__ is not None:
        error = error.__cause__ or error.__context__
    advice = "write it as a function of a module or of the script, with all it needs in its case"
    return f"sweep: {_called(function)} cannot be sent to other processes ({error}); {advice}"


def _shelf(function, folder):
    """Where rows are kept, with the mark of what makes them."""
    if folder is None:
        return Shelf()
    if not isinstance(folder, (str, Path)) or not str(folder) or "\0" in str(folder):
        raise InputError(f"sweep: folder = {folder!r} must be the path of a folder")
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"sweep: folder = {str(folder)!r} is none and cannot be made one: {error.strerror}") from None
    try:
        mark = mark_of(function)
    except NoMark as error:
        advice = "make it within the function, give what it is made of by the case, or sweep without a folder"
        raise InputError(f"sweep: {_called(function)} uses {error}; {advice}") from None
    return Shelf(Path(folder), f"{polyida.__version__} {package_mark()} {mark}", again=True)


def _name(code, case):
    """What a case's file is called."""
    text = json.dumps(plain_value("case", case), sort_keys=True)
    return hashlib.sha256(f"{code} {text}".encode()).hexdigest()[:32]


def _called(function):
    return getattr(function, "__name__", None) or repr(function)
