"""The runs of the study of levels: scenes with other bodies in place of their plates, their distances and costs."""

import numpy as np
import pytest

import polyida as pi
from levels import runs
from levels.scenes import FULL, RIGID, at_level
from polyida.problems.plates import double_plate_motors

pytestmark = pytest.mark.filterwarnings("ignore::polyida.errors.ReductionWarning")


@pytest.mark.parametrize("level, n", [(FULL, None), (3, 20), (RIGID, 8)])
def test_all_parts_hold_on_to_the_bodies_that_stand_for_plates(level, n):
    model = double_plate_motors(cells=12).build()
    other = at_level(model, level).build()
    assert list(other.parts) == list(model.parts) and other.gravity == model.gravity
    assert other.n == (n or model.n) and len(other.bodies) == (2 if level == FULL else 0)
    assert other.labels == model.labels or level == RIGID
    known, found = (pi.solve(each, 0.05, pi.GeneralizedAlpha(h=1e-3)) for each in (model, other))
    for name in ("shoulder", "elbow", "tip"):
        assert np.abs(found.position(name) - known.position(name)).max() <= {FULL: 0.0, 3: 1e-3, RIGID: 2e-2}[level]


def test_distances_fall_with_modes_and_steps_have_their_share(monkeypatch):
    monkeypatch.setattr(runs, "EXACT", 1e-8)
    monkeypatch.setattr(runs, "REFINED", 1e-7)
    full, few, more, rigid = (runs.measure("double-plate", level) for level in (FULL, 2, 5, RIGID))
    assert 10 * full["distance"] < more["distance"] < few["distance"] / 5 and few["distance"] < rigid["distance"]
    assert all(row["outcome"] == "done" and row["distance"] <= row["anywhere"] for row in (full, few, more, rigid))
    stepped = runs.measure("double-plate", 5, 1e-2)
    assert stepped["steps"] == 100 and stepped["distance"] > more["distance"] and stepped["n"] == more["n"] == 28
