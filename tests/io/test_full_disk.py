"""A disk that takes no more, by a limit of the size of files in a child process: an error, the run is still there, and no signal."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

resource = pytest.importorskip("resource")  # not on Windows

CHILD = """
import resource, sys
from pathlib import Path
import polyida as pi

def limit(size):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))

scene = pi.Scene(gravity=(0.0, -9.81))
plate = pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=8), pi.Material(5e7, 0.3, 1100.0), 0.01, name="plate")
scene.add(pi.Rigid(plate))
model = scene.build()
run = pi.solve(model, 5e-3, pi.GeneralizedAlpha(h=1e-3))
for size in map(int, sys.argv[1:]):
    for write in (lambda: run.save("run.h5", overwrite=True), lambda: pi.solve(model, 5e-3, pi.GeneralizedAlpha(h=1e-3), out="run.h5", overwrite=True)):
        limit(size)
        try:
            done = write()
            said = "" if done is None else done.status
        except pi.InputError as error:
            said = str(error)
        limit(resource.RLIM_INFINITY)
        print(size, said or "whole", len(run.q), sum(1 for path in Path().glob(".polyida*")), pi.load("run.h5").status if Path("run.h5").exists() else "none")
"""


def test_a_full_disk_leaves_the_run_and_no_rest(tmp_path):
    sizes = np.geomspace(2e3, 4e5, 30).astype(int)
    child = subprocess.run([sys.executable, "-c", CHILD, *map(str, sizes)], cwd=tmp_path, capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
    rows = child.stdout.splitlines()
    assert len(rows) == 2 * len(sizes)
    for row in rows:
        assert "File too large" in row and row.endswith(" 6 0 none") or " whole 6 0 " in row or " done 6 0 " in row, row
    assert "File too large" in rows[0]


REPLACED = """
import json, resource, sys
from collections import Counter
from pathlib import Path
import numpy as np
import polyida as pi
from stress.kills import outcome, writers

resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
kinds = writers()
for name in sys.argv[2].split(","):
    write, read = kinds[name]
    write(Path(), 0)
    old = read(Path())
    write(Path(), 1)
    new = read(Path())
    found = Counter()
    for size in np.geomspace(50, 3e7, int(sys.argv[1])).astype(int):
        write(Path(), 0)
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(size), resource.RLIM_INFINITY))
        error = ""
        try:
            write(Path(), 1)
        except (pi.InputError, OSError) as raised:
            error = type(raised).__name__
            assert "too large" in str(raised) or "kept" in str(raised), raised
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        is_old, is_new = read(Path()) == old, outcome(read, Path(), old, new) == "new"
        found["failed, old" if error and is_old else "done, new" if not error and is_new else f"{error}: {is_old}, {is_new}"] += 1
        found["left over"] += len([*Path().rglob(".polyida*")])
    print(json.dumps(found))
"""


@pytest.mark.parametrize("names", ["page,mesh,export,figure", "movie", "save,stream"])
def test_what_a_full_disk_cannot_take_leaves_the_old_result(names, tmp_path):
    command = [sys.executable, "-c", REPLACED, "30", names]
    child = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    )
    assert child.returncode == 0, child.stderr
    for line in map(json.loads, child.stdout.splitlines()):
        assert line.pop("left over") == 0 and set(line) == {"failed, old", "done, new"}, line


LATE = """
import resource, sys
import numpy as np
import polyida as pi

def solve(**place):
    problem = pi.problems.get("pendulum")
    return pi.solve(problem.model, 5.0, pi.GeneralizedAlpha(h=1e-3), q0=problem.q0, v0=problem.v0, **place)

whole = solve()
for size in map(int, sys.argv[1:]):
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
    run = solve(out="run.h5", overwrite=True, flush_every=500)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    stored = pi.load("run.h5")
    same = all(np.array_equal(one.q, whole.q[: len(one)]) for one in (run, stored))
    print(run.status, len(run), same, len(stored) == len(run), repr(run.message))
"""


def test_a_run_that_meets_the_full_disk_later_keeps_its_frames(tmp_path):
    sizes = np.linspace(5.5e5, 1.2e6, 8).astype(int)
    child = subprocess.run([sys.executable, "-c", LATE, *map(str, sizes)], cwd=tmp_path, capture_output=True, text=True)
    assert child.returncode == 0, child.stderr
    rows = child.stdout.splitlines()
    for row in rows:
        assert row.startswith(("disk full", "done 5001")) and " True True " in row and ("File too large" in row) == row.startswith("disk")
    assert rows[0].startswith("disk") and rows[-1].startswith("done")
