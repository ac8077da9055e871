"""Sweeps: one file a task, whole or not at all; what is there is not run again; a failing run is a row."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polyida.cli import study as cli_study
from polyida.errors import InputError
from polyida.files import OLD, PART
from polyida.study import tasks as study_tasks
from polyida.study.executors import Worker
from polyida.study.tasks import Study, run_tasks, task_key
from stress.kills import killed_sweeps

CALLS = []


def task(number, **more):
    """A row; some numbers make trouble."""
    CALLS.append(number)
    if number == 3:
        raise RuntimeError("three is no good")
    if number == 5:
        os.kill(os.getpid(), signal.SIGSEGV)
    if number == 6:
        os._exit(7)
    if number == 7:
        time.sleep(60)
    return {"square": np.float64(number**2), "where": os.getpid(), "path": Path("a"), "list": np.arange(2)}


def study(numbers=range(3), **options):
    return Study(
        "sweep",
        "A sweep",
        lambda quick: [{"number": k} for k in numbers],
        task,
        lambda rows: {"total": sum(row.get("square", 0.0) for row in rows)},
        **options,
    )


@pytest.mark.parametrize("content", ["", "{", "[1]", "null", '{"row": 3, "code": ""}', '{"number": 1}', "\0" * 100])
def test_a_file_that_is_not_whole_is_run_again(tmp_path, content):
    rows = run_tasks(study(), True, tmp_path)
    (tmp_path / f"{task_key(study(), {'number': 1})}.json").write_text(content)
    CALLS.clear()
    assert run_tasks(study(), True, tmp_path) == rows and CALLS == [1]


@pytest.mark.parametrize("fresh", [True, False])
def test_isolated_tasks_that_crash_are_rows(tmp_path, fresh):
    numbers = (2, 4, 5) if fresh else (2, 3, 4, 5, 6, 8)
    found = run_tasks(study(numbers, isolated=True, limit=600.0, fresh=fresh), True, tmp_path)
    rows = dict(zip(numbers, found))
    assert [row.get("square") for row in found] == [None if k in (3, 5, 6) else k**2 for k in numbers]
    assert rows[5]["outcome"] == "crash" and rows[5]["error"] == "crash: signal SIGSEGV" and os.getpid() != rows[2]["where"]
    assert (rows[2]["where"] == rows[4]["where"]) is not fresh
    if not fresh:
        assert rows[3]["error"] == "RuntimeError: three is no good" and rows[6]["error"] == "crash: exit code 7"
        assert rows[4]["where"] != rows[8]["where"]


def test_an_isolated_task_that_hangs_is_a_row(tmp_path):
    (row,) = run_tasks(study([7], isolated=True, limit=0.1), True, tmp_path)
    assert (row["outcome"], row["error"]) == ("hang", "hang: no end within 0.1 s")


def test_a_worker_takes_call_after_call_and_one_that_hangs_is_replaced():
    with Worker() as worker:
        rows = [worker.call(task, {"number": k}, 600.0) for k in (1, 2, 3, 4)]
        first = worker.process.pid
        hung, last = worker.call(task, {"number": 7}, 0.1), worker.call(task, {"number": 9}, 600.0)
        process = worker.process
    assert {row["where"] for row in (rows[0], rows[1], rows[3])} == {first} and "three" in rows[2]["error"] and not process.is_alive()
    assert hung["outcome"] == "hang" and last["square"] == 81 and last["where"] == process.pid != first


ORPHAN = """
import os, signal, sys, time
import polyida.study.executors as isolation
isolation.GRACE = 0.5
def long(place):
    open(place, "w").write(str(os.getpid()))
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(60)
if __name__ == "__main__":
    isolation.Worker().call(long, {"place": sys.argv[1]}, 1.0)
"""


def test_a_worker_left_alone_ends_itself(tmp_path):
    """The process that asked is killed while a task goes on: the task ends at its limit and does not stay for ever."""
    (tmp_path / "orphan.py").write_text(ORPHAN)
    paths = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.run([sys.executable, tmp_path / "orphan.py", tmp_path / "pid"], env=paths).returncode == -signal.SIGKILL
    number = int((tmp_path / "pid").read_text())
    _wait_for(lambda: not _exists(number) or _is_zombie(number) or None)


def _exists(number):
    """True if a process of this number exists."""
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    return True


def _wait_for(question):
    """The first answer; the limit is that of the test that hangs."""
    end = time.monotonic() + 600.0
    while time.monotonic() < end:
        try:
            answer = question()
            if answer:
                return answer
        except (OSError, ValueError):
            pass
        time.sleep(0.05)
    raise AssertionError("it did not happen in time")


def _is_zombie(number):
    return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"


def test_the_litter_of_killed_processes_is_removed(tmp_path):
    """Unfinished files that nobody has written to for an hour; another machine may be writing a younger one."""
    old, young = (tmp_path / f"{PART.format(name)}.json" for name in ("old", "young"))
    old.write_text("half")
    young.write_text("half")
    long_ago = time.time() - OLD - 60.0
    os.utime(old, (long_ago, long_ago))
    run_tasks(study(), True, tmp_path)
    assert list(tmp_path.glob(".*")) == [young]


def test_five_kills_of_a_sweep(in_a_new_process):
    assert all(check.share <= 1 for check in in_a_new_process(killed_sweeps, 5)[1])


def command(folder, *more):
    return cli_study.main(study(range(4), columns=("number", "square")), ["--quick", "--out", str(folder), *more])


def test_the_command_writes_figures_and_tells_what_failed(tmp_path, capsys):
    data = command(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "figures.json").read_text()) == data and data["figures"] == {"total": 5.0}
    assert data["command"] == "python studies/sweep.py --quick" and {"machine", "rows"} <= set(data) and "traceback" not in data["rows"][3]
    shown = capsys.readouterr().out
    assert "failed: number 3: RuntimeError: three is no good" in shown and "total: 5" in shown and "figures.json" in shown


def test_figures_are_strict_json(tmp_path, capsys):
    wild = Study(
        "sweep", "", lambda quick: [{"number": 1}], lambda number: {"x": float("nan"), "y": [np.inf, 1.0]}, lambda rows: {"z": float("inf")}
    )
    cli_study.main(wild, ["--out", str(tmp_path / "out")])
    data = json.loads((tmp_path / "out" / "figures.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert data["figures"] == {"z": None} and data["rows"][0]["x"] is None and data["rows"][0]["y"] == [None, 1.0]


def test_the_command_says_which_results_are_of_other_code(tmp_path, capsys, monkeypatch):
    command(tmp_path / "out")
    assert "earlier state of the code" not in capsys.readouterr().out
    monkeypatch.setattr(study_tasks, "code_hash", lambda study: "another")
    CALLS.clear()
    command(tmp_path / "out")
    assert CALLS == [3]  # the task that failed: other code may be right
    assert "3 of 4 results are of an earlier state of the code; --fresh" in capsys.readouterr().out
    CALLS.clear()
    command(tmp_path / "out", "--fresh")
    assert CALLS == [0, 1, 2, 3] and "earlier" not in capsys.readouterr().out


def test_the_figures_of_another_study_are_kept(tmp_path, capsys):
    command(tmp_path / "out")
    there = {path: path.read_bytes() for path in (tmp_path / "out").iterdir() if path.is_file()}
    with pytest.raises(SystemExit):
        cli_study.main(replace(study(range(4)), name="another"), ["--quick", "--out", str(tmp_path / "out")])
    assert "has the figures of the study" in capsys.readouterr().err and all(path.read_bytes() == was for path, was in there.items())


@pytest.mark.parametrize("made, said", [("out", "is a file"), ("out/mine.txt", "that no study made")])
def test_the_commands_exit_codes(tmp_path, capsys, made, said):
    (tmp_path / made).parent.mkdir(exist_ok=True)
    (tmp_path / made).write_text("")
    with pytest.raises(SystemExit) as caught:
        command(tmp_path / "out")
    assert caught.value.code == 2 and said in capsys.readouterr().err and len(list(tmp_path.rglob("*"))) <= 2


def test_what_lies_beside_a_study_is_in_the_mark_of_its_code(tmp_path, monkeypatch):
    """A study's own files and its packages are its code, as the package is; what lies elsewhere is not."""
    own = tmp_path / "studies"
    (own / "marked_parts").mkdir(parents=True)
    for place in ("marked_parts/__init__.py", "marked_parts/run.py", "other.py", "../elsewhere.py"):
        (own / place).write_text("def run():\n    return {}\n")
    monkeypatch.syspath_prepend(own)
    from marked_parts.run import run

    marked, marks = Study("marked", "", lambda quick: [], run, dict), []
    for place in (None, "marked_parts/run.py", "other.py", "../elsewhere.py"):
        if place:
            (own / place).write_text("changed = 1\n")
        study_tasks.package_hash.cache_clear()
        marks.append(study_tasks.code_hash(marked))
    assert len(set(marks)) == 3 and marks[2] == marks[3]
    study_tasks.package_hash.cache_clear()


def test_an_option_of_its_own_makes_another_study(tmp_path, monkeypatch, capsys):
    def fewer(value):
        if not value.isdigit():
            raise InputError(f"--upto {value}: a number is needed")
        return study(range(int(value)))

    monkeypatch.chdir(tmp_path)
    given = study(range(9), options={"upto": ("how far", fewer)})
    data = cli_study.main(given, ["--quick", "--upto", "3"])
    assert data["figures"] == {"total": 5.0} and data["command"] == "python studies/sweep.py --quick --upto 3"
    assert (tmp_path / "sweep-upto-quick" / "figures.json").exists()
    with pytest.raises(SystemExit) as caught:
        cli_study.main(given, ["--upto", "x"])
    assert caught.value.code == 2 and "a number is needed" in capsys.readouterr().err
