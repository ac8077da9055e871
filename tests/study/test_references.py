"""References of the studies: independent runs against what is known, and the cases' own consistency."""

import numpy as np
import pytest

import digits
from polyida import problems
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.integrate.solve import solve
from polyida.problems import plates
from polyida.study import families, references
from polyida.study.families import last_state
from polyida.study.kinds.sensitivity import smooth
from polyida.study.kinds.work_precision import cheapest, measure
from polyida.study.members import FIXED, IDA_FORMS, integrator


def test_explicit_runs_meet_the_closed_solution_of_the_pendulum():
    p = problems.get("pendulum")
    q, v, _, lam = families.explicit(p.model, p.t_end, 1e-11, q0=p.q0, v0=p.v0)[0]
    assert np.abs(q - p.reference["q"]).max() < 1e-8 and np.abs(v - p.reference["v"]).max() < 1e-7
    assert np.abs(lam - p.reference["lam"]).max() < 1e-6


def test_explicit_runs_give_every_time_that_is_asked_for_and_stop_at_kinks():
    model = references.sudden_blow(4, 0.02)
    times = np.linspace(0.0, 0.02, 5)
    states = families.explicit(model, 0.02, 1e-8, times=times)
    alone = families.explicit(model, 0.02, 1e-8)[0]
    assert len(states) == 5 and not states[0][0].any()
    assert np.abs(states[-1][0] - alone[0]).max() < 1e-9
    assert model.kinks(0.018, 0.02) == (pytest.approx(0.019),)


def test_explicit_and_fine_runs_of_the_integrators_agree():
    given = references.with_explicit("pair", plates.double_plate_motors(cells=4).build(), 0.02, (1e-2, 10.0), 1e-8)
    run = solve(given.model, 0.02, GeneralizedAlpha(h=5e-6, extrapolate=True, tolerance=1e-9), every=10**9)
    errors = given.errors(last_state(run))
    assert errors["error_q"] < 1e-10 and errors["error_v"] < 1e-6 and given.known["q"] < 1e-9


def test_three_families_agree_as_well_as_their_steps_allow():
    """On a smooth motion: extrapolated to fourth order, the distances fall by 16 as the steps are halved."""
    model = smooth("load", 4)
    exact = families.by_explicit(model, 0.05, 1e-11)
    for family in (families.by_alpha, families.by_energy_momentum):
        coarse, fine = (families.distance(exact, family(model, 0.05, h))["q"] for h in (2e-3, 1e-3))
        assert fine < coarse / 8 and fine < 1e-9


def test_a_reference_is_known_as_well_as_an_unlike_method_agrees():
    """Not as well as it agrees with itself: what both runs of one family share is seen."""
    one, other = ({part: np.array([1.0, x]) for part in families.PARTS} for x in (2.0, 2.0 + 1e-3))
    given = references.agreed("pair", None, 1.0, (1.0, 1.0), ("this", one), ("that", other))
    assert given.known == {part: pytest.approx(1e-3) for part in families.PARTS} and given.reference is one
    assert given.how.startswith("this; that")


def test_a_stiff_reference_shares_no_family_with_its_judge():
    given = references.too_stiff_for_explicit("pair", smooth("load", 4), 0.02, (1e-2, 10.0), 5e-4)
    exact = families.by_explicit(given.model, 0.02, 1e-11)
    off = families.distance(given.reference, exact)
    assert all(off[part] <= 1.5 * given.known[part] for part in off) and "energy-momentum" in given.how


def test_a_reference_run_that_stops_is_no_reference():
    with pytest.raises(RuntimeError, match="reference with h = 0.01 s: Newton does not converge"):
        families.by_alpha(smooth("load", 4), 0.02, 0.01, max_iterations=1, max_halvings=0)


def test_the_digits_are_printed_with_what_they_are_known_to(capsys):
    digits.main(["double-plate", "--cells", "4", "--time", "0.02", "--rtol", "1e-7", "--step", "1e-4"])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines] == [["double-plate", part] for part in ("tip", "tip_velocity", "lam")]
    assert all(float(line.rpartition(" known to ")[2]) < 1e-2 for line in lines)


def test_published_multipliers_are_those_of_the_published_state():
    given = references.case("andrews", True)
    assert np.allclose(given.reference["lam"], problems.get("andrews").reference["lam"], rtol=3e-6)


@pytest.mark.parametrize("name", [*FIXED, "alpha, adaptive", *(f"IDA {form}" for form in IDA_FORMS)])
def test_every_member_is_made(name):
    assert hasattr(integrator(name, 1e-3), "steps")


@pytest.mark.parametrize("name", ["alpha, adaptive", *sorted(set(FIXED) - {"alpha, Richardson", "energy-momentum"})])
def test_members_take_their_own_newton_tolerance_or_the_default(name):
    assert integrator(name, 1e-3).tolerance == GeneralizedAlpha(h=1e-3).tolerance
    assert integrator(name, 1e-3, newton=1e-9).tolerance == 1e-9


def test_unknown_members_are_named():
    with pytest.raises(InputError, match="'Euler' is unknown"):
        integrator("Euler", 1e-3)


def test_a_measured_run_has_errors_and_counts():
    row = measure("pendulum", "IDA ggl2", 1e-6, True)
    assert row["outcome"] == "done" and row["error_q"] < 1e-2 and row["residuals"] >= row["steps"]


def test_a_run_that_fails_is_a_row():
    row = measure("pendulum", "IDA index3", 1e-7, True)
    assert "error_q" not in row and "max_num_steps" in row["outcome"]


def test_multipliers_of_the_energy_momentum_method_are_those_of_the_end():
    model = smooth("load", 4)
    exact = families.explicit(model, 0.1, 1e-9)[0][3]
    runs = [solve(model, 0.1, EnergyMomentum(h=h), every=10**9) for h in (4e-3, 2e-3)]
    errors = [np.abs(last_state(run).lam - exact).max() for run in runs]
    assert errors[0] / errors[1] == pytest.approx(4.0, abs=0.3)


def test_energy_momentum_rows_have_an_error_of_lam():
    assert np.isfinite(measure("double-plate", "energy-momentum", 4e-3, True)["error_lam"])


def test_cheapest_interpolates_and_does_not_extrapolate():
    rows = [{"cpu_s": 1.0, "error_q": 1e-2}, {"cpu_s": 4.0, "error_q": 1e-4}, {"cpu_s": 2.0, "error_q": None}]
    assert cheapest(rows, "error_q", 1e-3) == pytest.approx(2.0)
    assert cheapest(rows, "error_q", 1e-1) == 1.0 and np.isnan(cheapest(rows, "error_q", 1e-5))
