"""Result files that are cut, foreign, damaged or hostile: one clear message, or no harm done."""

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

import polyida as pi

LOAD = """
import resource, sys, polyida
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
for path in sys.argv[1:]:
    try:
        polyida.load(path).summary()
        print("whole")
    except polyida.InputError as error:
        print("named" if path in str(error) else error)
"""


def outcomes(paths):
    """What loading each file comes to, in a process of its own with a limit of CPU time: no file may hang its reader."""
    command = [sys.executable, "-c", LOAD, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=Path(pi.__file__).parents[1])
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_truncated(file):
    content, paths = file.read_bytes(), []
    for fraction in (0.0, 0.05, 0.5, 0.9):
        paths.append(file.with_name(f"{fraction} of it.h5"))
        paths[-1].write_bytes(content[: int(fraction * len(content))])
    assert outcomes(paths) == ["named"] * 4


@pytest.mark.parametrize("content", [b"", b"garbage", b"\x89HDF\r\n\x1a\n" + bytes(200), bytes(range(256)) * 20])
def test_garbage(tmp_path, content):
    path = tmp_path / "other.h5"
    path.write_bytes(content)
    with pytest.raises(pi.InputError, match="other.h5"):
        pi.load(path)


def test_missing_and_foreign(tmp_path):
    with pytest.raises(pi.InputError, match="none.h5"):
        pi.load(tmp_path / "none.h5")
    with pytest.raises(pi.InputError):
        pi.load(tmp_path)
    with h5py.File(tmp_path / "foreign.h5", "w") as other:
        other["t"] = np.arange(3.0)
    with pytest.raises(pi.InputError, match="not a polyida trajectory"):
        pi.load(tmp_path / "foreign.h5")


def damaged(file, where, change):
    """Every copy of the file in which one dataset whose name contains `where` is changed; yields its name."""
    content, names = file.read_bytes(), []
    with h5py.File(file, "r") as opened:
        opened.visititems(lambda name, node: names.append(name) if hasattr(node, "dtype") and where in name else None)
    for name in names:
        file.write_bytes(content)
        with h5py.File(file, "r+") as opened:
            value = change(opened[name][()])
            if value is not None:
                del opened[name]
                opened[name] = value
        yield name


def usable(file):
    """Load and use a file: either all of it works or there is one InputError that names it."""
    try:
        run = pi.load(file)
    except pi.InputError as error:
        assert file.name in str(error)
        return False
    run.energy, run.drift, run.summary(), run.stress(-1), run.position("tip"), run.reaction("joint")
    return True


CHANGES = {
    "shorter": lambda x: x[:-1] if np.ndim(x) and len(x) > 1 else None,
    "narrower": lambda x: x[:, :-1] if np.ndim(x) > 1 else None,
    "empty": lambda x: x[:0] if np.ndim(x) else None,
    "a number": lambda x: 1.0,
    "text": lambda x: "hello",
    "large": lambda x: x + 10**6 if np.asarray(x).dtype.kind in "if" else None,
    "negative": lambda x: -1 - x if np.asarray(x).dtype.kind == "i" else None,
    "not finite": lambda x: x * np.nan if np.asarray(x).dtype.kind == "f" else None,
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_damaged_scene_is_refused_or_harmless(file, change):
    """Kernels do not check bounds, so what they are given must have been checked."""
    assert [usable(file) for _ in damaged(file, "scene", CHANGES[change])]


@pytest.mark.parametrize("name", ["t", "q", "v", "a", "lam"])
@pytest.mark.parametrize("change", ["empty", "narrower", "a number", "text"])
def test_damaged_frames_are_refused(file, name, change):
    content = file.read_bytes()
    with h5py.File(file, "r+") as opened:
        value = CHANGES[change](opened[name][()])
        if value is None:
            return
        del opened[name]
        opened[name] = value
    assert not usable(file)
    file.write_bytes(content)
    assert usable(file)


@pytest.mark.parametrize("text", ["{", "[" * 100_000, "{}", "null", '{"gravity": [0, 0], "parts": [{"kind": "os.system"}]}'])
def test_damaged_descriptions_are_refused(file, text):
    with h5py.File(file, "r+") as opened:
        names = [name for name, value in opened.attrs.items() if isinstance(value, str) and value.startswith("{")]
        for name in names:
            opened.attrs[name] = text
        texts = [name for name, node in opened.items() if getattr(node, "dtype", None) is not None and node.dtype.kind in "SO"]
        for name in texts:
            del opened[name]
            opened[name] = text
    if names or texts:
        assert not usable(file)


def test_random_bytes_are_refused_or_harmless(file):
    random, content, paths = np.random.default_rng(0), file.read_bytes(), []
    for number in range(40):
        changed = bytearray(content)
        for at in random.integers(0, len(content), 8):
            changed[at] = random.integers(256)
        paths.append(file.with_name(f"changed {number}.h5"))
        paths[-1].write_bytes(changed)
    assert set(outcomes(paths)) <= {"whole", "named"}
