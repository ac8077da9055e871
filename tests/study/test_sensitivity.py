"""Order and round-off of generalized-alpha against runs that share no code with it."""

import pytest

from polyida.study.rows import fitted
from step_size_sensitivity import errors as sensitivity
from step_size_sensitivity import slopes

STEPS = [1e-2 / 2**k for k in range(4)]


@pytest.mark.parametrize("kind", ["load", "motors"])
def test_second_order_from_the_first_step_on(kind):
    errors = [sensitivity.order_errors(kind, 4, 1e-2, k, 0.05) for k in range(4)]
    for part in ("q", "v", "lam"):
        assert fitted(STEPS, [error[part] for error in errors]) == pytest.approx(2.0, abs=0.12), part


def test_the_references_floor_lies_below_the_errors_that_are_fitted():
    floor, errors = (sensitivity.reference_floor("load", 4, 1e-2, 0.05), sensitivity.order_errors("load", 4, 1e-2, 0, 0.05))
    assert all(floor[part] < 0.1 * errors[part] for part in sensitivity.PARTS)


def rows_of(errors, phi="carried", part="tiny", scene="smooth motors", **more):
    named = {f"error_{name}": error for name, error in errors.items()}
    return [
        {"part": part, "scene": scene, "phi": phi, "solve": "physical", "h": h, **more} | {name: value(h) for name, value in named.items()}
        for h in sensitivity.decades(1e-9, 1e-2)
    ]


def test_slopes_are_fitted_where_one_cause_alone_is_seen():
    method = rows_of({part: (lambda h, p=power: h**p) for part, power in slopes.METHOD.items()})
    noise = rows_of(
        {part: (lambda h, p=slopes.METHOD[part], r=power: h**p + 1e-22 * h**r) for part, power in slopes.ROUND_OFF.items()},
        "from positions",
    )
    for part in slopes.PARTS:
        assert slopes.method(method, "smooth motors", part, "physical") == pytest.approx(slopes.METHOD[part])
    for part in ("a", "lam"):
        assert slopes.round_off(method + noise, "smooth motors", part, "physical") == pytest.approx(-2, abs=0.1)


def test_errors_below_the_references_floor_are_not_fitted():
    floored = rows_of({"a": lambda h: max(h**2, 1e-8)}, part="order", scene="load", form="index3", floor_a=1e-8)
    assert slopes.order(floored, "load", "a") == pytest.approx(2.0)


def test_stalls_beyond_the_steps_own_motion_are_not_fitted():
    rows = [row | {"stall_q": 1e-16 / row["h"] ** 2 if row["h"] > 2e-9 else 1e3} for row in rows_of({}, "from positions", scene="scene 2")]
    assert slopes.stall(rows, "scene 2", "from positions", "physical") == pytest.approx(-2.0)


def tiny(h, **settings):
    return sensitivity.tiny_steps("smooth motors", 4, h, 1e-9, 1e-8, **settings)


def test_carried_constraints_are_clean_at_tiny_steps():
    row = tiny(1e-9)
    assert row["outcome"] == "done" and row["error_lam"] < 1e-10 and row["error_a"] < 1e-7


def test_constraints_from_positions_are_not():
    row = tiny(1e-9, incremental_phi=False)
    assert row["error_lam"] > 1e-5 and row["error_a"] > 1e-2


def test_newton_stalls_at_round_off_over_h_squared():
    stalls = [tiny(1e-9, incremental_phi=carried)["stall_q"] for carried in (True, False)]
    assert stalls[0] < 1e-8 < 1e-6 < stalls[1]


def test_decades_are_exact():
    assert sensitivity.decades(1e-9, 1e-7) == [1e-9, 1e-8, 1e-7]
