"""Kernels: the code that a call selects, and the indices that compiled code may use."""

import ast
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest

import polyida
import polyida as pi
from polyida.clock import LONG, Teller, clock, loading
from polyida.jit import entry, pack

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


def test_compiling_is_not_counted(monkeypatch):
    """By a time that goes on by one second at each look: entering and leaving are one second apart, nested compilations are part of the outer one."""
    now = iter(np.arange(100.0))
    monkeypatch.setattr("time.process_time", lambda: next(now))
    monkeypatch.setattr("time.perf_counter", lambda: 0.0)
    before = clock()[0]
    with loading, loading:
        pass
    assert clock()[0] - before == 2.0  # of three looks since the first one


@pytest.mark.parametrize("decorator", [entry, numba.njit], ids=["entry", "function of a user"])
def test_a_compilation_is_counted(decorator):
    @decorator
    def twice(x):
        return 2 * x

    spent = loading.seconds[1]
    assert twice(3) == 6 and loading.seconds[1] > spent and loading.depth == 0


def test_the_first_run_of_a_model_has_its_compilation_apart():
    """The model calls a function that numba compiles at its first call."""

    @numba.njit
    def pull(q):
        return np.array([9.81 * q[0] / (1.0 + q[0] ** 2) + np.sin(q[0])])

    class Own(pi.Model):
        n, m = 1, 0

        def mass(self, q):
            return np.eye(1)

        def force(self, t, q, v):
            return pull(q)

    before = loading.seconds[0]
    run = pi.solve(Own(), 0.01, pi.GeneralizedAlpha(h=5e-3), q0=[0.1])
    assert 0.0 < run.compile_seconds <= loading.seconds[0] - before and len(pull.signatures) == 1


@pytest.mark.parametrize(
    ("seconds", "looks_on", "quiet", "lines"), [(1.0, True, "", 0), (3.0, True, "", 1), (3.0, False, "", 0), (3.0, True, "1", 0)]
)
def test_who_looks_on_is_told_once_that_kernels_compile(seconds, looks_on, quiet, lines, monkeypatch, capsys):
    monkeypatch.setenv("POLYIDA_QUIET", quiet)
    monkeypatch.setattr("polyida.clock.watched", lambda: looks_on)
    now = [0.0]
    monkeypatch.setattr("time.perf_counter", lambda: now[0])
    teller = Teller(lambda: "the/folder")
    for _ in range(2):
        teller.begin("polyida.integrate.alpha.step", "take_steps")
        now[0] += seconds * LONG / 2
        teller.begin("polyida.integrate.alpha.step", "correct")
        teller.end()
        teller.end()
    written = capsys.readouterr().err
    assert written.count("polyida compiles its kernels") == lines and written.count("kept in the/folder") == lines
