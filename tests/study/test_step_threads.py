"""Steps in one thread and in two: the same results, and figures that follow from the row. No times are judged."""

from types import SimpleNamespace

import numpy as np
import pytest

from polyida import machine
from step_cost import threads


def test_a_row_of_two_threads(monkeypatch):
    monkeypatch.setattr(threads, "MANY", 2**16)
    monkeypatch.setattr(machine, "cores", lambda: 2)
    row = threads.threads_row(400, 3, 2)
    assert row["lowest"] <= row["speedup"] <= row["highest"] and row["limit"] > 0 and row["triad_one_gb_s"] > 0 and row["factor_mb"] > 0
    assert threads.figures([row])["threads_speedup_1e5"] == row["speedup"] and machine.threads() == 1
    assert f"{row['n']} coordinates" in threads.notes([row])[0]


def test_results_that_differ_are_seen():
    state = SimpleNamespace(q=np.zeros(2), v=np.zeros(2), a=np.zeros(2), lam=np.zeros(1))
    threads.require_same(state, state)
    with pytest.raises(ArithmeticError, match="changes the results"):
        threads.require_same(state, SimpleNamespace(**vars(state) | {"lam": np.array([1e-300])}))
