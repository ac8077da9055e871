"""Two halves of a model in threads of their own: the same results, and figures that follow from the row. No times are judged."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from step_cost import threads


def test_a_row_of_two_threads(monkeypatch):
    monkeypatch.setattr(threads, "MANY", 2**16)
    row = threads.threads_row(400, 3, 2)
    assert row["lowest"] <= row["speedup"] <= row["highest"] and row["triad_gb_s_one"] > 0 and row["factor_mb"] > 0
    assert row["n"] == sum(threads.Half(200).model.n for _ in range(threads.THREADS))
    found = threads.figures([row])
    assert found == {"threads_speedup_1e5": row["speedup"], "triad_threads_speedup": row["triad_speedup"]}
    assert f"{row['n']} coordinates" in threads.notes([row])[0]


def test_halves_that_differ_are_seen():
    class Drifting(threads.Half):
        """Ends elsewhere each time."""

        def take(self, steps):
            state = super().take(steps)
            return type("Moved", (), {"q": state.q + np.random.random(), "v": state.v, "a": state.a, "lam": state.lam})

    with ThreadPoolExecutor(2) as pool, pytest.raises(ArithmeticError, match="other results"):
        threads.require_same([Drifting(100) for _ in range(2)], 2, pool)
