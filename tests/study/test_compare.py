"""The comparison as data: what its errors are measured against, and that its numbers are those of the runs."""

import numpy as np
import pytest

import polyida as pi
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.solve import solve
from polyida.problems import plates
from polyida.results.balance import motor_work, unbalanced
from polyida.show.page import gap
from polyida.study.compare import compare, refine, watch
from polyida.study.job import Job, load


@pytest.fixture(scope="module")
def found():
    return compare(load("double-plate", cells=8, time=0.05))


def test_rows_are_the_runs_and_the_refined_run(found):
    assert [row["run"] for row in found.rows] == ["generalized-alpha", "IDA", "Radau IIA", "refined run"]
    assert found.success and found.rows[0]["steps"] == 50 and found.rows[3]["steps"] > 3 * found.rows[2]["steps"]
    assert found.figures["alpha_error_end"] == found.rows[0]["error_end"]


def test_the_refined_run_is_what_another_family_comes_to(found):
    """Generalized-alpha at 24 times the steps has 1/576 of its error left."""
    finer = solve(found.job.model, 0.05, GeneralizedAlpha(h=1e-3 / 24)).position("tip")[-1]
    own = refine(found.job, None, np.array([0.0, 0.03, 0.05]), lambda *seen: None)
    assert own.t[-1] == 0.05 and np.linalg.norm(own.watched[-1] - finer) < 5e-3 * found.rows[0]["error_end"]


def test_errors_are_those_between_the_steps_of_the_refined_run(found):
    """Its polynomial is as exact as its steps are."""
    run = found.runs["generalized-alpha"]
    exact = solve(found.job.model, 0.05, RadauIIA(rtol=1e-11), output=run.t).position("tip")
    distance = np.linalg.norm(run.position("tip") - exact, axis=1)
    assert found.distances["generalized-alpha"][1] == pytest.approx(distance, abs=1e-3 * distance.max())


def test_the_watched_point_is_where_the_trajectory_says(found):
    run = found.runs["IDA"]
    assert np.array([watch(found.job)(q) for q in run.q]) == pytest.approx(run.position("tip"), abs=1e-14)


def test_published_digits_judge_every_run_of_a_problem_that_has_them():
    rows = compare(load("andrews")).rows
    assert [row["published_error"] < limit for row, limit in zip(rows, (1e-2, 5e-3, 1e-3, 1e-3), strict=True)] == [True] * 4


def test_energy_gained_is_the_work_of_the_motors():
    run = solve(plates.double_plate_motors(cells=8).build(), 1.0, GeneralizedAlpha(h=1e-3))
    gained = run.energy.total[-1] - run.energy.total[0]
    assert motor_work(run)[-1] == pytest.approx(gained, rel=1e-3)
    assert abs(unbalanced(run)[-1]) < 1e-3 * gained


def test_a_failed_run_is_a_note_and_the_others_are_kept():
    soft = plates.Material(E=2e5, nu=0.3, rho=1100.0)
    model = plates.double_plate_motors(cells=8, material=soft).build()
    found = compare(Job("soft", model, time=0.5, step=5e-3, point="tip"))
    assert not found.success and found.notes
    assert all(len(run.t) > 1 for run in found.runs.values())


def test_jobs_take_time_and_step_from_the_caller_first():
    job = load("pendulum", time=0.5, step=0.01)
    assert (job.time, job.step, job.published) == (0.5, 0.01, {})
    assert load("pendulum").published
    with pytest.raises(InputError, match="step 0"):
        load("pendulum", step=0.0)


def test_a_further_integrator_is_compared_too():
    found = compare(load("double-plate", cells=8, time=0.01), others={"energy-momentum": pi.EnergyMomentum(h=1e-3)})
    assert [row["run"] for row in found.rows][3] == "energy-momentum" and found.success
    ends = [run.position("tip")[-1] for run in found.runs.values()]
    assert found.gap == pytest.approx(max(np.linalg.norm(a - b) for a in ends for b in ends), rel=1e-9)
    assert {"alpha_error_end", "ida_error_end", "energy-momentum_error_end", "refined_steps"} <= set(found.figures)
    assert "two of the integrators" in gap(found)


@pytest.mark.parametrize(
    "others",
    [
        3,
        pi.IDA(),
        {"mine": 3},
        {"mine": pi.IDA},
        {3: pi.IDA()},
        {"": pi.IDA()},
        {"a/b": pi.IDA()},
        {"n" * 300: pi.IDA()},
        {"IDA": pi.IDA()},
        {"refined run": pi.IDA()},
    ],
)
def test_others_of_the_wrong_kind_are_refused(others):
    with pytest.raises(InputError, match="others|no integrator|label"):
        compare(load("double-plate", cells=8, time=0.01), others=others)


@pytest.mark.parametrize("rtol", ["1e-3", None.__class__, [1e-3]])
def test_a_tolerance_of_the_wrong_kind_is_refused(rtol):
    with pytest.raises(InputError, match="rtol"):
        compare(load("double-plate", cells=8, time=0.01), rtol=rtol)
