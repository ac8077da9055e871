"""Packs give compiled code what they hold; entries give the same from Python and from compiled code."""

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest

import polyida
from polyida.jit import entry, pack, part, shared, typed
from polyida.jit.intrinsics import address, pointer

PATH = {"PYTHONPATH": str(Path(polyida.__file__).parents[1])}
PLAIN = PATH | {"POLYIDA_PLAIN_NUMBA": "1"}


@pack
class Inner(NamedTuple):
    places: np.ndarray
    half: np.ndarray
    nothing: None = None


@pack
class Outer(NamedTuple):
    matrix: np.ndarray
    inner: Inner
    factor: float
    count: int
    whole: bool


@part
def weighted(inner, k):
    return inner.half[inner.places[k]]


@entry
def total(s, x):
    result = 0.0 if s.inner.nothing is None else np.inf
    for i in range(s.count):
        for k in range(s.matrix.shape[1]):
            result += s.matrix[i, k] * x[k] + weighted(s.inner, i)
    x[0] = s.inner.nothing is None
    s.inner.half[0] += 1.0
    return result * s.factor if s.whole else -result


@shared
def doubled(x):
    return 2.0 * x


@entry
def doubled_twice(x):
    return doubled(doubled(x))


@entry
def first_of(x):
    return numba.carray(pointer(address(x)), (1,))[0]


def example(whole=True, matrix=None):
    matrix = np.arange(6.0).reshape(2, 3) if matrix is None else matrix
    return Outer(matrix, Inner(np.array([1, 0], np.int32), np.array([4.0, -1.5], np.float32)), -0.5, 2, whole)


def expected(s, x):
    result = (s.matrix @ x).sum() + s.matrix.shape[1] * s.inner.half[s.inner.places].sum()
    return result * s.factor if s.whole else -result


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize(
    "matrix", [None, np.arange(12.0).reshape(2, 6)[:, ::2], np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.zeros((2, 0))]
)
def test_compiled_code_reads_all_that_a_pack_holds(whole, matrix):
    s = example(whole, matrix)
    x = np.linspace(1.0, 2.0, s.matrix.shape[1] or 1)
    wanted = expected(s, x[: s.matrix.shape[1]])
    assert total(s, x) == pytest.approx(wanted, rel=1e-15)
    assert s.inner.half[0] == 5.0, "arrays are those of Python, not copies"


def test_a_pack_replaced_copied_or_pickled_has_arrays_of_its_own():
    s = example()
    total(s, np.ones(3))
    changed = s._replace(factor=3.0)
    assert total(changed, np.ones(3)) == pytest.approx(3.0 * (15.0 + 3 * 3.5))
    for other in (copy.deepcopy(s), pickle.loads(pickle.dumps(s))):
        before = s.inner.half.copy()
        total(other, np.ones(3))
        assert isinstance(other, Outer) and np.array_equal(s.inner.half, before)


def test_a_shared_entry_is_the_same_for_python_and_compiled_code():
    assert doubled_twice(3.0) == doubled(doubled(3.0)) == 12.0
    assert doubled_twice(2) == 8.0, "another type is another function"


def test_an_address_leads_back_to_an_array_and_a_typed_entry_to_the_same():
    assert first_of(np.array([3.0, 1.0])) == typed(first_of)(np.array([3.0])) == 3.0


def test_without_the_faster_compilers_all_is_the_same():
    """This file, with numba's own compilers in a process of its own."""
    options = ["-q", "-n0", "--noconftest", "-p", "no:cacheprovider", "-k", "not settings and not without"]
    command = [sys.executable, "-m", "pytest", *options, __file__]
    done = subprocess.run(command, env=os.environ | PLAIN, capture_output=True, text=True)
    assert done.returncode == 0 and "passed" in done.stdout, done.stdout[-2000:]


@pytest.mark.parametrize("version", [(0, 62), (9, 0)])
def test_with_a_numba_that_is_not_known_the_faster_compilers_are_left_out(version):
    other = f"import numba; numba.version_info = numba.version_info._replace(short={version}); from polyida import jit; assert not jit.compilers"
    subprocess.run([sys.executable, "-c", other], env=os.environ | PATH, check=True)
