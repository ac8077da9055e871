"""Compiled functions of users are kept between processes, and compiled anew if anything changes that their machine code depends on."""

import ctypes
import importlib
import json
import math
import os
import shutil
import subprocess
import sys
import types
from pathlib import Path

import numba
import numpy as np
import pytest

import polyida
import polyida as pi
from polyida import jit
from polyida.fingerprint import machine_code_fingerprint
from polyida.jit import cache as kernel_cache
from polyida.jit.user_functions import over

faster = pytest.mark.skipif(jit.compilers is None, reason="numba's own compilers keep code in files of their own, or do not keep it")
HELPERS = "SCALE = 2.0\n\n\ndef scaled(x):\n    return SCALE * x\n"
FUNCTIONS = """
import numpy as np
import polyida as pi
from own_helpers import scaled

FACTOR, TABLE = 3.0, np.array([1.0, 2.0])

def closed(shift):
    def function(x):
        return x + shift
    return function

shifted = closed(0.5)

def helper(x):
    return FACTOR * x + 0.25

@pi.compiled
def wave(t, q, v):
    return q[0] - 100.0

@pi.compiled
class Own(pi.Model):
    n, m, stiffness = 2, 0, 1.0

    def mass(self, q):
        return np.array([[1.0, 0.0], [0.0, 1.0]])

    def force(self, t, q, v):
        return self.stiffness * q + helper(TABLE) + scaled(shifted(q))
"""
SCRIPT = """
import json
from numba.core import event

compiled = []
class Listener(event.Listener):
    def on_start(self, found):
        compiled.append(found.data["dispatcher"].py_func.__qualname__)
    def on_end(self, found):
        pass

event.register("numba:compile", Listener())
run = pi.solve(Own(), 2e-3, pi.GeneralizedAlpha(h=1e-3), q0=[1.0, 2.0], until=wave, sensors={"wave": wave})
assert run.success
plain = Own.stiffness * np.array([1.0, 2.0]) + helper(TABLE) + scaled(shifted(np.array([1.0, 2.0])))
assert np.abs(run.a[0] + plain).max() < 1e-12
print(json.dumps(compiled))
"""
CHANGES = {
    "a constant of a module": ("FACTOR, TABLE = 3.0", "FACTOR, TABLE = 3.5"),
    "a constant of a function": ("+ 0.25", "+ 0.5"),
    "a global array": ("TABLE = 3.0, np.array([1.0, 2.0])", "TABLE = 3.0, np.array([1.0, 2.5])"),
    "a value of a closure": ("closed(0.5)", "closed(1.5)"),
    "a function that is called": ("return FACTOR * x", "return FACTOR - x"),
    "a function within a closure": ("return x + shift", "return x - shift"),
    "a constant in another file": ("SCALE = 2.0", "SCALE = 2.5"),
}
NO_CHANGES = {
    "a number of self": ("stiffness = 2, 0, 1.0", "stiffness = 2, 0, 4.0"),
    "the place in the file": ("def helper(x):", "# more lines\n\n\ndef helper(x):"),
}


@pytest.mark.parametrize("edit", (CHANGES | NO_CHANGES).values(), ids=CHANGES | NO_CHANGES)
def test_the_mark_of_a_function_is_that_of_its_machine_code(edit, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    marks = []
    for change in (("", ""), edit):
        for name, text in (("own_helpers", HELPERS), ("own_functions_here", FUNCTIONS)):
            (tmp_path / f"{name}.py").write_text(text.replace(*change))
            monkeypatch.delitem(sys.modules, name, raising=False)
        importlib.invalidate_caches()
        marks.append(machine_code_fingerprint(importlib.import_module("own_functions_here").Own.force))
    assert None not in marks and (marks[0] != marks[1]) is (edit in CHANGES.values())


@faster
def test_kept_code_serves_other_processes_and_is_compiled_anew_where_it_does_not_fit(tmp_path):
    """Each process compares the forces with those in Python, and says what it compiled; polyida's own kernels are there."""
    kernels = kernel_cache.folder()
    shutil.copytree(kernels, tmp_path / "cache" / kernels.name, ignore=shutil.ignore_patterns("user_functions.*"))
    own = {
        "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(polyida.__file__).parents[1])]),
        "NUMBA_CACHE_DIR": str(tmp_path / "cache"),
    }

    def compiled(edit=("", ""), processes=1):
        for name, text in (("own_helpers", HELPERS), ("script", FUNCTIONS + SCRIPT)):
            (tmp_path / f"{name}.py").write_text(text.replace(*edit))
        settings = os.environ | own | {"PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, tmp_path / "script.py"]
        started = [subprocess.Popen(command, env=settings, cwd=tmp_path, stdout=subprocess.PIPE, text=True) for _ in range(processes)]
        answers = [process.communicate()[0] for process in started]
        assert [process.returncode for process in started] == [0] * processes
        return [name for answer in answers for name in json.loads(answer)]

    assert compiled(processes=2)  # at once with an empty cache
    assert not compiled(NO_CHANGES["the place in the file"])
    assert any("Own.force" in name for name in compiled(CHANGES["a constant in another file"]))


class Springs(pi.Model):
    """Reads a number of its module."""

    n, m = 1, 0
    by_numba = True

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return STIFFNESS[0] * q


STIFFNESS = np.array([1.0])


def test_a_value_that_changes_between_runs_is_the_new_one():
    for stiffness in (1.0, 5.0):
        STIFFNESS[0] = stiffness
        run = pi.solve(Springs(), 1e-3, pi.GeneralizedAlpha(h=1e-3), q0=[1.0])
        assert run.a[0] == pytest.approx(-stiffness, rel=1e-12)


@numba.njit
def before(x):
    return STIFFNESS[0] * x


def test_numba_s_functions_are_taken_with_the_values_of_now():
    """A dispatcher keeps what it was compiled from first, under whatever mark it would be kept now."""
    STIFFNESS[0] = 2.0
    assert before(1.0) == 2.0
    STIFFNESS[0] = 3.0
    found = over("test", before, np.array([1.0]))
    assert found[0, 0] == 3.0


def closed(value):
    return lambda x: x * value


def test_what_cannot_be_told_by_value_has_no_mark():
    here = types.ModuleType("here")
    here.before = before
    c_function = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(lambda x: x)
    callback = numba.cfunc("float64(float64)")(lambda x: x)
    given_types = numba.njit("float64(float64)")(lambda x: x)
    assert None not in [
        machine_code_fingerprint(closed(x)) for x in (1.0, (1, "a"), np.ones(3), np.float32(1.0), before, np.sin, np.dot, math.sin)
    ]
    assert machine_code_fingerprint(before) != machine_code_fingerprint(numba.njit(fastmath=True)(before.py_func))
    assert [machine_code_fingerprint(closed(x)) for x in (c_function, callback, given_types, object())] == [None] * 4
    assert machine_code_fingerprint(lambda x: here.before(x)) is None


def test_what_is_printed_is_the_same_from_kept_code(tmp_path):
    """Printing takes objects of Python, which kept code has to find again."""
    script = tmp_path / "script.py"
    script.write_text(
        "import numpy as np, polyida as pi\nfrom polyida.jit.user_functions import over\n\n\ndef inner(x):\n    print(x)\n    return x[0]\n\n\n"
        "@pi.compiled\ndef outer(x):\n    return inner(x)\n\n\nover('test', outer, np.eye(2))\n"
    )
    settings = os.environ | {"PYTHONPATH": str(Path(polyida.__file__).parents[1]), "NUMBA_CACHE_DIR": str(tmp_path)}
    for _ in range(2):
        done = subprocess.run([sys.executable, script], env=settings, capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stdout) == (0, "[1. 0.]\n[0. 1.]\n")


@faster
def test_code_that_holds_an_address_is_not_kept(tmp_path, monkeypatch, recwarn):
    """numba takes a large array by its address."""
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path)
    for size, kept in ((300_000, False), (3, True)):
        table = np.ones(size)
        assert over("test", pi.compiled(lambda x, table=table: x * table[2]), np.array([2.0]))[0, 0] == 2.0
        assert any(tmp_path.rglob("user_functions.*")) is kept and not recwarn.list


@faster
@pytest.mark.parametrize("damage", [b"", b"no pickle", None])
def test_a_damaged_file_of_a_users_function_is_compiled_anew(tmp_path, monkeypatch, damage):
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path)
    whole = []
    for _ in range(2):
        assert over("test", pi.compiled(lambda x: 3.0 * x), np.array([2.0]))[0, 0] == 6.0
        (path,) = tmp_path.rglob("user_functions.*.nbc")
        whole.append(len(path.read_bytes()))
        path.write_bytes(path.read_bytes()[:200] if damage is None else damage)
    assert min(whole) > 200  # the lengths differ by those of running numbers in names


def test_old_files_of_users_functions_go(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "folder", lambda: tmp_path)
    for k in range(kernel_cache.USER_FILES + 2):
        path = tmp_path / f"user_functions.{k}.nbc"
        path.touch()
        os.utime(path, (k, k))
    (tmp_path / "other.0.nbc").touch()
    kernel_cache.remove_old_own.__wrapped__("user_functions")
    assert not {"user_functions.0.nbc", "user_functions.1.nbc"} & {path.name for path in tmp_path.iterdir()}
    assert len(list(tmp_path.iterdir())) == kernel_cache.USER_FILES + 1
