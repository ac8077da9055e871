"""Where a run's file lies: what comes back is this run's, whatever happens to the file's name meanwhile."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

import polyida as pi
from polyida.cli.commands import main
from polyida.problems import plates

FRAMES = ("t", "q", "v", "a", "lam")
ALPHA = pi.GeneralizedAlpha(h=1e-3, linear="kkt")


@pytest.fixture(scope="module")
def model():
    return plates.double_plate_motors(cells=4).build()


@pytest.fixture(scope="module")
def whole(model):
    return pi.solve(model, 0.03, ALPHA)


def equal(one, other):
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in FRAMES)


def once(action):
    """A `progress` that acts in the middle of the run."""
    left = [action]

    def progress(t):
        if t > 0.015 and left:
            left.pop()()

    return progress


@pytest.mark.parametrize("limit", [1e9, 0])
def test_a_file_that_was_replaced_is_not_taken_for_this_run_s(model, whole, tmp_path, limit):
    path, other = tmp_path / "run.h5", tmp_path / "other.h5"
    pi.solve(model, 0.004, ALPHA, out=other)
    theirs = other.read_bytes()
    run = pi.solve(model, 0.03, ALPHA, out=path, memory_limit=limit, progress=once(lambda: os.replace(other, path)))
    assert equal(run, whole) and run.status == "done" and "run.h5 was removed or replaced" in run.message
    assert path.read_bytes() == theirs


@pytest.mark.parametrize("limit", [1e9, 0])
@pytest.mark.parametrize("action", [os.unlink, lambda path: os.rename(path, f"{path}.bak")], ids=["removed", "renamed"])
def test_a_file_that_went_away(model, whole, tmp_path, action, limit):
    path = tmp_path / "run.h5"
    run = pi.solve(model, 0.03, ALPHA, out=path, memory_limit=limit, progress=once(lambda: action(path)))
    assert equal(run, whole) and "removed or replaced" in run.message and not path.exists()
    for moved in tmp_path.iterdir():
        assert equal(pi.load(moved), whole) and pi.load(moved).status == "done"


def test_a_file_that_is_being_written_is_not_overwritten(model, whole, tmp_path):
    path, told = tmp_path / "run.h5", []

    def other():
        for write in (lambda: pi.solve(model, 0.03, ALPHA, out=path, overwrite=True), lambda: whole.save(path, True)):
            with pytest.raises(pi.InputError, match="run.h5: another process is still writing it") as error:
                write()
            told.append(error)

    assert equal(pi.solve(model, 0.03, ALPHA, out=path, progress=once(other)), whole) and len(told) == 2
    assert equal(pi.load(path), whole) and os.listdir(tmp_path) == ["run.h5"]
    assert pi.solve(model, 0.03, ALPHA, out=path, overwrite=True).success


def test_places_where_no_file_can_be(model, tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for out in (os.devnull, tmp_path / ("x" * 300), tmp_path / "loop", tmp_path / "a\0b", 3):
        with pytest.raises(pi.InputError):
            pi.solve(model, 0.01, ALPHA, out=out, overwrite=True)
    assert os.listdir(tmp_path) == ["loop"]


KILLED = """
import os, signal, sys
import polyida as pi
from polyida.io import writer
writer._move_new = lambda *names: os.kill(os.getpid(), signal.SIGKILL)
model = pi.problems.get("pendulum").model
pi.solve(model, 1.0, pi.GeneralizedAlpha(h=1e-3), q0=[-1.0, 0.0], out=sys.argv[1])
"""


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="no locks that tell")
def test_what_a_killed_start_left_is_removed_by_the_next(model, whole, tmp_path):
    path = tmp_path / "run.h5"
    assert subprocess.run([sys.executable, "-c", KILLED, path]).returncode < 0
    (left,) = tmp_path.iterdir()
    assert left.suffix == ".part"
    pi.solve(model, 0.003, ALPHA, out=path)
    assert left.exists()  # it is young: somebody may be about to lock it
    os.utime(left, (0, time.time() - 3600))
    held = tmp_path / ".polyida-held.part"
    with open(held, "wb") as file:
        from polyida.io.locks import lock

        lock(file)
        os.utime(held, (0, time.time() - 3600))
        pi.solve(model, 0.003, ALPHA, out=path, overwrite=True)
    assert sorted(os.listdir(tmp_path)) == [held.name, "run.h5"]


def test_every_flush_is_brought_to_the_disk_where_asked(model, whole, tmp_path, monkeypatch):
    calls, fsync = [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda descriptor: calls.append(descriptor) or fsync(descriptor))
    pi.solve(model, 0.03, ALPHA, out=tmp_path / "run.h5", flush_every=10)
    assert not calls
    run = pi.solve(model, 0.03, ALPHA, out=tmp_path / "safe.h5", flush_every=10, fsync=True)
    assert equal(run, whole) and len(calls) >= 2 * 5 + 1
    with pytest.raises(pi.InputError, match="fsync = 1 "):
        pi.solve(model, 0.03, ALPHA, fsync=1)


def test_a_file_without_a_frame_yet_is_read_and_gone_on_with(tmp_path):
    scene = plates.double_plate(cells=4)
    scene.add(pi.PointLoad(scene.parts["tip"].at, (0.0, 1.0), np.sin, name="push"))
    model, path = scene.build(), tmp_path / "run.h5"

    def progress(t):
        if t > 0.004:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError):
        pi.solve(model, 0.01, ALPHA, output=[0.009], out=path, progress=progress)
    found = pi.load(path)
    assert (len(found), found.status, found.model) == (0, "error", None) and found.summary()
    assert main(["show", str(path)]) == 0 and main(["animate", str(path)]) == 2
    assert equal(pi.resume(path, model=model), pi.solve(model, 0.01, ALPHA, output=[0.009]))
