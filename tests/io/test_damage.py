"""Damage is noticed wherever it lies: nothing comes back changed, and the frames before it come back."""

import random

import h5py
import numpy as np
import pytest

import polyida as pi
from polyida.io.layout import frames_at_once
from polyida.problems import plates

FRAMES = ("t", "q", "v", "a", "lam")
ALPHA = pi.GeneralizedAlpha(h=1e-3)
SHOWN = ("status", "message", "counts", "cpu_seconds", "machine", "plan", "integrator")


@pytest.fixture(scope="module")
def model():
    return plates.double_plate_motors(cells=6).build()


@pytest.fixture(scope="module")
def whole(model):
    return pi.solve(model, 1.8, ALPHA)


@pytest.fixture(scope="module")
def good(whole, tmp_path_factory):
    """The bytes of a file of several blocks."""
    path = tmp_path_factory.mktemp("good") / "run.h5"
    whole.save(path)
    assert len(whole) > 2 * block(whole)
    return path.read_bytes()


@pytest.fixture
def path(good, tmp_path):
    (tmp_path / "run.h5").write_bytes(good)
    return tmp_path / "run.h5"


def block(run):
    return frames_at_once(1 + 3 * run.q.shape[1] + run.lam.shape[1])


def same(run, whole, count=None):
    return all(np.array_equal(getattr(run, name), getattr(whole, name)[:count]) for name in FRAMES)


def flipped(path, content, at, bit=0):
    changed = bytearray(content)
    changed[at] ^= 1 << bit
    path.write_bytes(changed)


def outcome(path, whole):
    """What a file comes to: "refused", "before" (the frames before the damage), "whole"; anything else fails."""
    try:
        run = pi.load(path)
    except pi.InputError as error:
        assert "run.h5" in str(error)
        return "refused"
    assert same(run, whole, len(run))
    if len(run) < len(whole):
        assert run.status == "damaged" and not run.success and f"frames {len(run)} to {len(whole) - 1}" in run.message
        return "before"
    assert all(getattr(run, name) == getattr(whole, name) for name in SHOWN)
    assert list(run.model.parts) == list(whole.model.parts) and run.model.gravity == whole.model.gravity
    assert np.array_equal(run.model.reference, whole.model.reference) and run.state.t == whole.state.t
    assert all(np.array_equal(run.state.memory[name], value) for name, value in whole.state.memory.items())
    return "whole"


def test_no_flipped_bit_changes_what_is_loaded(path, good, whole):
    draw, outcomes = random.Random(3), []
    for _ in range(40):
        flipped(path, good, draw.randrange(len(good)), draw.randrange(8))
        outcomes.append(outcome(path, whole))
    assert set(outcomes) == {"refused", "before", "whole"} and outcomes.count("before") > 12


def test_the_structure_of_a_file_is_guarded_too(path, good, whole):
    """The scene, the settings and HDF5's own bookkeeping lie in the first part of the file."""
    draw = random.Random(4)
    outcomes = [flipped(path, good, draw.randrange(30_000), draw.randrange(8)) or outcome(path, whole) for _ in range(30)]
    assert outcomes.count("refused") > 5


@pytest.mark.parametrize("name", FRAMES)
def test_the_frames_before_a_damaged_block_come_back(path, whole, name):
    step = block(whole)
    with h5py.File(path, "r") as file:
        at = file[name].id.get_chunk_info(1).byte_offset
    flipped(path, path.read_bytes(), at + 20)
    for limit in (1e9, 0):
        run = pi.load(path, memory_limit=limit)
        assert len(run) == step and same(run, whole, step) and run.status == "damaged"
        assert f"{name}: its checksum does not fit" in run.message and run.state.t == run.t[-1]
    assert run.drift.max() < 1e-9
    with pytest.raises(pi.InputError, match=f"frames {step} to .* give its `state`"):
        pi.resume(path, 1.0)


@pytest.mark.parametrize("name", ["about", "scene/mesh 0/points"])
def test_a_file_says_what_is_damaged(path, name):
    with h5py.File(path, "r") as file:
        at = file[name].id.get_chunk_info(0).byte_offset
    flipped(path, path.read_bytes(), at + 20)
    with pytest.raises(pi.InputError, match=f"run.h5: {name} is damaged"):
        pi.load(path)


class Wide(pi.Model):
    n, m, needs = 2500, 0, pi.Needs(False, False, False, False)

    def mass(self, q):
        from scipy.sparse import eye_array

        return eye_array(self.n, format="csc")

    def force(self, t, q, v):
        return q - 1.0


def test_a_coordinate_s_history_is_read_without_the_others(tmp_path):
    """A frame lies in three chunks; what one of them has lost is told when it is asked for."""
    path = tmp_path / "wide.h5"
    whole = pi.solve(Wide(), 0.033, pi.GeneralizedAlpha(h=1e-3), out=path)
    with h5py.File(path, "r") as file:
        assert file["q"].chunks == (16, 834)
        at = [file["q"].id.get_chunk_info_by_coord((16, first)).byte_offset for first in (0, 834, 1668)]
    flipped(path, path.read_bytes(), at[1] + 20)
    assert len(pi.load(path)) == 16
    run = pi.load(path, memory_limit=0, check=False)
    assert run.status == "done" and len(run) == 34
    for columns in (0, 833, 1668, -1, slice(1668, None, 2), [2400, 2000], slice(7, 3)):
        assert np.array_equal(run.q[:, columns], whole.q[:, columns])
        assert np.array_equal(run.q[30:5:-3, columns], whole.q[30:5:-3, columns])
    for key in ((slice(None), 834), (slice(None), [2000, 5]), 17):
        with pytest.raises(pi.InputError, match="wide.h5: frames .* are damaged"):
            run.q[key]
    with pytest.raises(pi.InputError, match="load: check = 1 must"):
        pi.load(path, check=1)


def test_a_file_without_a_whole_frame_is_refused(path):
    with h5py.File(path, "r+") as file:
        file["v"][0, 2] = np.inf
    with pytest.raises(pi.InputError, match="run.h5: all its frames are damaged: v"):
        pi.load(path)


def test_a_damaged_flush_of_a_run_that_was_killed_is_told(model, tmp_path):
    """The flush before it holds: fewer frames, and the message says why."""
    path, copy = tmp_path / "run.h5", tmp_path / "copy.h5"

    def progress(t):
        if t > 0.6 and not copy.exists():
            copy.write_bytes(path.read_bytes())

    whole = pi.solve(model, 0.7, ALPHA, out=path, progress=progress)
    good, before = copy.read_bytes(), pi.load(copy)
    assert before.status == "interrupted" and "not whole" not in before.message
    with h5py.File(path, "r") as file:
        places = [file[f"slot {k}"].id.get_chunk_info(0).byte_offset for k in range(2)]
    lengths = []
    for at in places:
        flipped(copy, good, at + 40)
        run = pi.load(copy)
        assert run.status == "interrupted" and "not whole" in run.message and same(run, whole, len(run))
        lengths.append(len(run))
    assert max(lengths) == len(before) > min(lengths) > 1
