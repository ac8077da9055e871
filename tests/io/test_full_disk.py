"""A disk that takes no more, by a limit of the size of files in a child process: an error, the run is still there, and no signal."""

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
