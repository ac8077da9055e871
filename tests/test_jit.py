"""Kernels: the code that a call selects, and the indices that compiled code may use."""

import ast
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import polyida
from polyida.jit import clock, compilers, entry, pack

DECORATORS = {"entry", "part", "shared", "leaf", "fast"}


@pack
class Row(NamedTuple):
    """Weights of a sum."""

    weights: np.ndarray


@entry
def total(row, x, factor):
    """A weighted sum."""
    result = 0.0 * factor * x[0]
    for i in range(x.shape[0]):
        result += row.weights[i] * x[i]
    return factor * result


def test_each_call_of_a_kernel_finds_the_code_of_its_types():
    """One argument after the other has another type; the calls come again when there is code for all of them."""
    x, ones = np.arange(4.0), np.ones(4)
    fixed = x.copy()
    fixed.flags.writeable = False
    calls = [(ones, x, factor) for factor in (2, 2.5, np.float32(2.0), np.float64(2.0), True, 1j)]
    calls += [(weights, x, 2.0) for weights in (ones, np.ones(4, np.int64), np.arange(8.0)[::2])]
    calls += [(ones, values, 2.0) for values in (x.astype(np.float32), x.astype(np.int64), 1j * x, np.repeat(x, 2)[::2], fixed)]
    calls += [(ones, np.repeat(x, 2).reshape(4, 2)[:, 0], 2.0)]
    for weights, values, factor in calls + calls:
        assert total(Row(weights), values, factor) == factor * (weights @ values)


def compiled_functions():
    """(file, function) of all kernels of the package."""
    for path in sorted(Path(polyida.__file__).parent.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef):
                names = {ast.unparse(one.func if isinstance(one, ast.Call) else one) for one in node.decorator_list}
                if names & DECORATORS:
                    yield path.name, node


def test_no_kernel_counts_indices_from_the_end():
    """In compiled code an index -1 would be the place before an array."""
    found, wrong = 0, []
    for name, function in compiled_functions():
        found += 1
        for node in ast.walk(function):
            indices = (
                node.slice.elts if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Tuple) else [getattr(node, "slice", None)]
            )
            wrong += [
                f"{name}:{node.lineno} {function.name}"
                for index in indices
                if isinstance(index, ast.UnaryOp) and isinstance(index.op, ast.USub)
            ]
    assert found > 500 and not wrong, wrong


@pytest.mark.skipif(not compilers, reason="plain numba")
def test_compiling_is_not_counted(monkeypatch):
    """By a time that goes on by one second at each look: entering and leaving are one second apart, nested compilations are part of the outer one."""
    now = iter(np.arange(100.0))
    monkeypatch.setattr("time.process_time", lambda: next(now))
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)
    before = clock()[0]
    with compilers.compiling, compilers.compiling:
        pass
    assert clock()[0] - before == 2.0  # of three looks since the first one


@pytest.mark.skipif(not compilers, reason="plain numba")
def test_an_entry_counts_its_compilation():
    @entry
    def twice(x):
        return 2 * x

    spent = compilers.compiling.seconds[1]
    assert twice(3) == 6 and compilers.compiling.seconds[1] > spent and compilers.compiling.depth == 0
