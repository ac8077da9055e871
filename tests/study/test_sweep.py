"""`pi.study.sweep`: the same rows wherever cases run; what is in the folder is not run again, unless code or case changed."""

import importlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import polyida as pi
from polyida.fingerprint import fingerprint_of

CALLS = []
RESERVED = ["error", "cpu_s", "wall_s", "memory_mb"]


def square(number, **more):
    """A row; some numbers make trouble."""
    CALLS.append(number)
    if number == 3:
        raise RuntimeError("three is no good")
    return {"square": np.float64(number**2), "path": Path("a"), "list": np.arange(2), "none": None}


def numbered(count):
    return [{"number": k} for k in range(count)]


def bare(rows):
    return [{name: value for name, value in row.items() if name not in RESERVED[1:]} for row in rows]


def test_a_row_is_the_case_what_it_gave_and_what_it_cost():
    study = pi.study.sweep(square, [{"number": np.int64(2), "extra": ("a", 1.5)}])
    (row,) = study.rows
    assert list(row) == ["number", "extra", "square", "path", "list", "none", *RESERVED] and study.ran == 1
    assert row | dict.fromkeys(RESERVED[1:], 0) == {
        "number": 2, "extra": ["a", 1.5], "square": 4.0, "path": "a", "list": [0, 1], "none": None, "error": "", "cpu_s": 0, "wall_s": 0, "memory_mb": 0
    }  # fmt: skip
    assert all(type(value) in (int, float, str, list, type(None)) for value in row.values())
    assert row["cpu_s"] >= 0 and row["wall_s"] > 0 and 10 < row["memory_mb"] < 1e5
    assert list(study.to_dataframe().columns) == list(row)


def test_memory_is_the_largest_while_the_case_ran():
    def fill(megabytes):
        return {"sum": float(np.ones(megabytes * 2**17).sum())}

    rows = pi.study.sweep(fill, [{"megabytes": m} for m in (1, 200, 2)]).rows
    assert rows[1]["memory_mb"] > rows[0]["memory_mb"] + 150
    if Path("/proc/self/clear_refs").exists():  # where the system measures anew
        assert rows[2]["memory_mb"] < rows[1]["memory_mb"] - 150


def test_a_case_that_fails_is_a_row_and_runs_again(tmp_path):
    study = pi.study.sweep(square, numbered(5), folder=tmp_path)
    assert [row["error"] for row in study.rows] == ["", "", "", "RuntimeError: three is no good", ""]
    assert "square" in study.rows[3]["traceback"] and "square" not in study.rows[3] and study.rows[4]["square"] == 16
    assert study.notes == ["1 of 5 cases failed; the first: RuntimeError: three is no good"]
    again = pi.study.sweep(square, numbered(5), folder=tmp_path)
    assert again.ran == 1 and bare(again.rows) == bare(study.rows)


@pytest.mark.parametrize(
    "gives, said",
    [
        (lambda x: None, "the function returned None; it must return a dictionary"),
        (lambda x: {"run": threading.Lock()}, r"the result of the function\['run'\] = .*no plain value"),
        (lambda x: {"z": [1, {"a": 1j}]}, r"\['z'\]\[1\]\['a'\] = 1j is no plain value"),
        (lambda x: {3: 1}, "no plain value"),
        (lambda x: {"error": 0.1}, "'error', which is a reserved column"),
        (lambda x: {"x": x + 1}, "'x', an argument of the case, with another value"),
        (lambda x: sys.exit(3), "SystemExit: 3"),
    ],
)
def test_what_is_no_row_is_told_in_one(gives, said):
    (row,) = pi.study.sweep(gives, [{"x": 1}]).rows
    assert re.search(said, row["error"])


def test_a_case_given_twice_runs_once():
    CALLS.clear()
    study = pi.study.sweep(square, [{"number": 1, "a": 2}, {"number": 2, "a": 2}, {"a": 2, "number": 1}])
    assert CALLS == [1, 2] and [row["square"] for row in study.rows] == [1, 4, 1] and study.ran == 2
    assert study.notes == ["1 cases were given more than once; each case ran once"]


class Backwards(Executor):
    """Finishes what it was given last first, so that rows come out of order."""

    def __init__(self):
        self.given = []

    def submit(self, function, /, *arguments, **named):
        self.given.append((Future(), partial(function, *arguments, **named)))
        if len(self.given) == 4:
            for future, call in reversed(self.given):
                future.set_result(call())
        return self.given[-1][0]


@pytest.mark.parametrize("make", [Backwards, lambda: ThreadPoolExecutor(3), lambda: ProcessPoolExecutor(2)])
def test_any_executor_gives_the_rows_of_none(make):
    with make() as executor:
        assert bare(pi.study.sweep(square, numbered(4), executor).rows) == bare(pi.study.sweep(square, numbered(4)).rows)


def test_ctrl_c_in_a_run_ends_the_sweep_and_no_row_is_of_the_part(tmp_path, heeds_ctrl_c):
    """A run that Ctrl-C ends comes back with what it has; that is no row."""
    model, log = pi.problems.get("pendulum").model, []

    def case(number):
        log.append(number)
        press = (lambda t: os.kill(os.getpid(), signal.SIGINT)) if number == 1 and log.count(1) == 1 else None
        return {"end": pi.solve(model, 0.01, pi.GeneralizedAlpha(h=1e-3), q0=[-1.0, 0.0], progress=press).t[-1]}

    with pytest.raises(KeyboardInterrupt):
        pi.study.sweep(case, numbered(3), folder=tmp_path)
    assert log == [0, 1]
    again = pi.study.sweep(case, numbered(3), folder=tmp_path)
    assert log == [0, 1, 1, 2] and again.ran == 2 and {row["end"] for row in again.rows} == {0.01}


SCRIPT = """
import json, os, signal, sys
from concurrent.futures import ProcessPoolExecutor
import polyida as pi

SCALE = 3.0

def scaled(number):
    return SCALE * number

def case(number):
    if number == 2 and os.environ.get("DIE"):
        os.kill(os.getpid(), signal.SIGKILL)
    return {"value": scaled(number), "where": os.getpid()}

def from_now_on():
    os.environ["DIE"] = "1"

def main(cases):
    rows = {}
    rows["serial"] = pi.study.sweep(case, cases).rows
    with ProcessPoolExecutor(2) as pool:
        rows["processes"] = pi.study.sweep(case, cases, pool).rows
    with pi.study.Isolated() as own:
        rows["isolated"] = pi.study.sweep(case, cases, own).rows
    import dask
    from distributed import Client, LocalCluster
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        rows["dask"] = pi.study.sweep(case, cases, client.get_executor(), "rows").rows
        client.run(from_now_on)
        rows["killed"] = pi.study.sweep(case, cases[2:3] + [{"number": 7}], client.get_executor()).rows
    rows["again"] = pi.study.sweep(case, cases, folder="rows").ran
    from_now_on()
    with ProcessPoolExecutor(2) as pool:
        rows["broken"] = pi.study.sweep(case, cases[2:3], pool).rows
    with pi.study.Isolated() as own:
        rows["crash"] = pi.study.sweep(case, cases, own).rows
    json.dump(rows, sys.stdout)

if __name__ == "__main__":
    if sys.argv[1:]:
        pi.study.sweep(case, [{"number": k} for k in range(5)], folder="rows")
    else:
        main([{"number": k} for k in range(4)])
"""


def run_script(folder, *arguments, script=SCRIPT, timeout=None, **environment):
    (folder / "cases.py").write_text(script)
    path = os.pathsep.join([str(Path(pi.__file__).parents[1])])
    return subprocess.run(
        [sys.executable, "cases.py", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": path} | environment,
        capture_output=True,
        text=True,
        timeout=timeout,
    )


def test_a_script_that_starts_processes_as_it_is_imported_ends_with_the_reason(tmp_path):
    text = """
import polyida as pi
def case(k):
    return {"value": k}
with pi.study.Isolated(limit=1.0) as own:
    print(pi.study.sweep(case, [{"k": 1}], own).rows)
"""
    ended = run_script(tmp_path, script=text, timeout=60.0)  # less than the case waited for its process
    assert "crash: exit code 1, before the case began (is what starts processes in the script under `if __name__" in ended.stdout


def test_a_scripts_own_function_gives_the_same_rows_here_in_processes_and_on_a_cluster(tmp_path):
    ended = run_script(tmp_path)
    assert ended.returncode == 0, ended.stderr
    rows = json.loads(ended.stdout)
    values = {name: [(row["number"], row.get("value"), row["error"]) for row in found] for name, found in rows.items() if name != "again"}
    assert values["serial"] == [(k, 3.0 * k, "") for k in range(4)]
    assert values["processes"] == values["isolated"] == values["dask"] == values["serial"] and rows["again"] == 0
    places = {name: {row.get("where") for row in rows[name]} for name in ("serial", "processes", "isolated", "dask")}
    assert len(set.union(*places.values())) == sum(map(len, places.values()))
    # processes that die are rows, of those cases that they had
    assert "KilledWorker" in values["killed"][0][2] and values["killed"][1] == (7, 21.0, "")
    assert values["broken"][0][2].startswith("BrokenProcessPool") and rows["broken"][0]["memory_mb"] is None
    assert [row[2] for row in values["crash"]] == ["", "", "crash: signal SIGKILL", ""]


def test_kill_9_in_a_case_keeps_those_before(tmp_path):
    assert run_script(tmp_path, "sweep", DIE="1").returncode == -signal.SIGKILL
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "rows").iterdir()}
    assert len(kept) == 2 and all(json.loads(path.read_text())["row"]["error"] == "" for path in kept)
    assert run_script(tmp_path, "sweep").returncode == 0
    assert len(list((tmp_path / "rows").iterdir())) == 5 and all(path.stat().st_mtime_ns == at for path, at in kept.items())


HELPERS = """
import functools
import numpy as np
import polyida as pi
FACTOR, TABLE, ARRAY, UNUSED = 2.0, {"a": [1, 2]}, np.arange(3.0), 1
RUBBER = pi.Material(E=5e7, nu=0.3, rho=1100.0)
STORE = {}

def scale(x):
    return FACTOR * x

class Beam:
    width = 1.0

    def area(self, height):
        return self.width * height

@functools.lru_cache
def kept(x):
    return x + 10.0

def unused():
    return 1
"""
CASES = """
import functools
import swept_helpers as h
from swept_helpers import Beam, RUBBER
LOG, COUNT = [], 0

def inner(x, shift=1.0):
    return h.scale(x) + shift + h.ARRAY.sum() + len(h.TABLE["a"])

def case(x):
    global COUNT
    COUNT += 1
    LOG.append(x)
    h.STORE[x] = x
    def local():
        from swept_helpers import kept
        return Beam().area(x) + RUBBER.E + kept(x)
    return {"value": inner(x) + local()}

def given(material, x):
    return {"value": material.E * x}

partly = functools.partial(given, RUBBER)
short = lambda x: {"value": h.scale(x)}
"""


@pytest.fixture
def marked(tmp_path, monkeypatch):
    """Function (edits, name) -> (mark of a function of the two modules after an edit, the function)."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def mark(*edit, name="case"):
        for module, text in (("swept_helpers", HELPERS), ("swept_cases", CASES)):
            assert not edit or edit[0] in HELPERS + CASES
            (tmp_path / f"{module}.py").write_text(text.replace(*edit) if edit else text)
            sys.modules.pop(module, None)
        importlib.invalidate_caches()
        function = getattr(importlib.import_module("swept_cases"), name)
        return fingerprint_of(function), function

    yield mark
    for module in ("swept_helpers", "swept_cases"):
        sys.modules.pop(module, None)


CHANGES = {
    "a constant": ("FACTOR, TABLE, ARRAY, UNUSED = 2.0", "FACTOR, TABLE, ARRAY, UNUSED = 2.5"),
    "a dictionary": ("[1, 2]", "[1, 3]"),
    "an array": ("np.arange(3.0)", "np.arange(3.0) + 1e-12"),
    "a material": ("E=5e7", "E=6e7"),
    "a function it calls": ("FACTOR * x", "FACTOR + x"),
    "a method": ("self.width * height", "self.width + height"),
    "an attribute of a class": ("width = 1.0", "width = 2.0"),
    "a cached function that it imports": ("x + 10.0", "x + 11.0"),
    "a default": ("shift=1.0", "shift=2.0"),
    "itself": ("inner(x) + local()", "inner(x) - local()"),
    "a function within": ("Beam().area(x) +", "Beam().area(x) -"),
}
NO_CHANGES = {
    "nothing": (),
    "comments and lines": ("def scale(x):", "# of one place\n\ndef scale(x):  # that scales"),
    "a function it does not call": ("return 1\n", "return 2\n"),
    "a value it does not name": ("np.arange(3.0), 1", "np.arange(3.0), 2"),
    "a list it fills": ("LOG, COUNT = [], 0", "LOG, COUNT = [1], 3"),
    "a dictionary it fills": ("STORE = {}", "STORE = {1: 2}"),
}


@pytest.mark.parametrize("edit", CHANGES.values(), ids=CHANGES)
def test_changed_code_has_another_mark(marked, edit):
    assert marked()[0] != marked(*edit)[0]


@pytest.mark.parametrize("edit", NO_CHANGES.values(), ids=NO_CHANGES)
def test_what_changes_no_answer_keeps_the_mark(marked, edit):
    mark, function = marked()
    function(2.0)
    assert fingerprint_of(function) == mark == marked(*edit)[0]


def test_partials_lambdas_methods_and_closures_have_marks(marked):
    assert marked(name="partly")[0] != marked(*CHANGES["a material"], name="partly")[0]
    assert marked(name="short")[0] != marked(*CHANGES["a constant"], name="short")[0]
    closed = lambda factor: lambda x: {"y": factor * x}  # noqa: E731
    assert fingerprint_of(closed(1.0)) == fingerprint_of(closed(1.0)) != fingerprint_of(closed(2.0))
    adds = lambda scene: lambda x: {"y": scene.add(x)}  # noqa: E731, a thing that has an `add` is no list that is filled
    assert fingerprint_of(adds(pi.Scene((0.0, 0.0)))) != fingerprint_of(adds(pi.Scene((0.0, 1.0))))
    mesh = pi.mesh.rectangle(1.0, 0.1, cells=4)
    before = fingerprint_of(closed(mesh))
    mesh.quality()
    assert fingerprint_of(closed(mesh)) == before != fingerprint_of(closed(pi.mesh.rectangle(1.0, 0.1, cells=5)))


def test_other_code_another_version_and_another_case_run_anew(tmp_path, monkeypatch):
    def case(x):
        return {"y": FACTOR["is"] * x}

    ran = lambda cases: pi.study.sweep(case, cases, folder=tmp_path).ran  # noqa: E731
    one, two = [{"x": 1.0}], [{"x": 1.0}, {"x": 2.0}]
    assert [ran(one), ran(one), ran(two), ran(two)] == [1, 0, 1, 0]
    monkeypatch.setitem(FACTOR, "is", 3.0)
    assert [ran(two), ran(two)] == [2, 0]
    monkeypatch.setattr(pi, "__version__", "0.1.1")
    assert [ran(two), ran(two)] == [2, 0]
    monkeypatch.undo()
    assert ran(two) == 0


FACTOR = {"is": 2.0}


def test_what_has_no_mark_is_refused_for_a_folder_only(tmp_path):
    lock = threading.Lock()

    def locked(x):
        with lock:
            return {"y": x}

    with pytest.raises(pi.InputError, match="locked uses a lock, of which nobody can say whether it changed"):
        pi.study.sweep(locked, [{"x": 1}], folder=tmp_path)
    assert pi.study.sweep(locked, [{"x": 1}]).rows[0]["y"] == 1


ONE = [{"number": 1}]
WRONG = {
    "function": (lambda: pi.study.sweep(3, ONE), "function = 3 must be a function"),
    "cases": (lambda: pi.study.sweep(square, 3), "cases = 3 must be a list of dictionaries"),
    "no case": (lambda: pi.study.sweep(square, []), "no case in it"),
    "a number": (lambda: pi.study.sweep(square, [*ONE, 3]), r"cases\[1\] = 3 must be a dictionary"),
    "a taken name": (lambda: pi.study.sweep(square, [{"number": 1, "error": 1}]), "'error', which is a reserved column"),
    "no plain value": (lambda: pi.study.sweep(square, [{"number": 1j}]), r"cases\[0\]\['number'\] = 1j is no plain value"),
    "a wrong argument": (lambda: pi.study.sweep(_one, [{"nunber": 1}]), r"cases\[0\] does not fit _one\(number\)"),
    "executor": (lambda: pi.study.sweep(square, ONE, 4), "executor = 4 must be an executor of concurrent.futures"),
    "client": (lambda: pi.study.sweep(square, ONE, type("Client", (), {"get_executor": None})()), r"give client.get_executor\(\)"),
    "closed": (lambda: pi.study.sweep(square, ONE, _closed()), "takes no work: cannot schedule new futures after shutdown"),
    "lambda": (lambda: pi.study.sweep(lambda number: {}, ONE, ProcessPoolExecutor(1)), "cannot be sent to other processes"),
    "file": (lambda: pi.study.sweep(square, ONE, folder=__file__), "is none and cannot be made one"),
    "folder": (lambda: pi.study.sweep(square, ONE, folder=3), "folder = 3 must be the path of a file or folder"),
    "progress": (lambda: pi.study.sweep(square, ONE, progress=3), "progress = 3 must be a function"),
}


def _one(number):
    return {}


def _closed():
    executor = ThreadPoolExecutor(1)
    executor.shutdown()
    return executor


@pytest.mark.parametrize("name", WRONG)
def test_wrong_input_is_told_before_the_first_case(name):
    CALLS.clear()
    call, said = WRONG[name]
    with pytest.raises(pi.InputError, match=said):
        call()
    assert not CALLS


def test_a_sweep_shows_itself(tmp_path):
    study = pi.study.sweep(square, [*numbered(5), {"number": 7, "extra": "<b>"}])
    axes = study.plot()
    assert axes.get_xlabel() == "number" and axes.get_ylabel() == "square" and len(axes.lines[0].get_xdata()) == 5
    assert study.plot("number", "cpu_s", axes) is axes and "number" in str(study) and "&lt;b&gt;" in study._repr_html_()
    assert any(line.split()[:2] == ["4", "16"] for line in str(study).splitlines()) and repr(study) == "<Sweep: sweep of square, 6 rows>"
    written = study.report(tmp_path / "report")
    assert (written / "report.html").exists() and (written / "sweep.png").exists()
    with pytest.raises(pi.InputError, match="no case has numbers x = 'path'"):
        study.plot("path")


def test_a_row_of_another_case_is_not_taken_for_this_one_s(tmp_path):
    """Its file was renamed, or its case edited."""
    pi.study.sweep(square, numbered(3), folder=tmp_path)
    files = {json.loads(path.read_text())["row"]["number"]: path for path in tmp_path.glob("*.json")}
    files[0].write_bytes(files[1].read_bytes())
    files[2].write_text(files[2].read_text().replace('"number": 2', '"number": 7', 1))
    again = pi.study.sweep(square, numbered(3), folder=tmp_path)
    assert again.ran == 2 and [row["square"] for row in again.rows] == [0.0, 1.0, 4.0]
    assert pi.study.sweep(square, numbered(3), folder=tmp_path).ran == 0


def test_a_row_that_cannot_be_written_is_told_with_those_that_are_kept(tmp_path, monkeypatch):
    """A full disk, and a folder in the place of a row."""
    from polyida.study import tasks

    whole, written = tasks.write_file, []

    def full(path, text, sync):
        if len(written) == 2:
            raise OSError(28, "No space left on device")
        written.append(path)
        whole(path, text, sync)

    with monkeypatch.context() as patch:
        patch.setattr(tasks, "write_file", full)
        with pytest.raises(pi.InputError, match=r"cannot be written: No space left on device; 2 rows are kept .* goes on from them"):
            pi.study.sweep(square, numbered(3), folder=tmp_path)
    assert pi.study.sweep(square, numbered(3), folder=tmp_path).ran == 1
    written[0].unlink()
    written[0].mkdir()
    with pytest.raises(pi.InputError, match="cannot be written: .*; 2 rows are kept"):
        pi.study.sweep(square, numbered(3), folder=tmp_path)


def test_sweeps_of_one_folder_at_once_give_the_same_rows(tmp_path, monkeypatch):
    """From threads, and from processes that have the same number, as on two machines."""
    monkeypatch.setattr(os, "getpid", lambda: 1)
    together, rows = threading.Barrier(4, timeout=60), [None] * 4

    def sweep(k):
        together.wait()
        rows[k] = [row.get("square") for row in pi.study.sweep(square, numbered(8), folder=tmp_path).rows]

    threads = [threading.Thread(target=sweep, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert rows == [[None if k == 3 else float(k * k) for k in range(8)]] * 4
    assert len([*tmp_path.iterdir()]) == 8 and all(path.suffix == ".json" for path in tmp_path.iterdir())
    assert pi.study.sweep(square, numbered(8), folder=tmp_path).ran == 1  # the one that fails


def test_a_function_that_an_executor_cannot_send_is_told():
    class Sends(Executor):
        def submit(self, function, /, *arguments, **named):
            try:
                raise TypeError("cannot pickle '_thread.lock' object")
            except TypeError as error:
                raise TypeError("Could not serialize object of type LLGExpr") from error

    with pytest.raises(pi.InputError, match="square cannot be sent to other processes .cannot pickle '_thread.lock' object.; write it as"):
        pi.study.sweep(square, numbered(1), Sends())
