"""The comparison as data: what its errors are measured against, and that its numbers are those of the runs."""

import re
import sys

import numpy as np
import pytest

import polyida as pi
from polyida.cli.commands import main
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.problems import plates
from polyida.problems.mechanisms import slider_crank
from polyida.results.motion import motor_work, unbalanced
from polyida.run.solve import solve
from polyida.study.comparison import FEW_FRAMES, compare, named_integrators, reference_run, with_frames_between
from polyida.study.ivp import InitialValueProblem, load


@pytest.fixture(scope="module")
def found():
    return compare(load("double-plate", cells=8, time=0.05))


def test_rows_are_the_runs_and_the_refined_run(found):
    assert [row["run"] for row in found.rows] == ["generalized-alpha", "IDA", "Radau IIA", "refined run"]
    assert found.success and found.rows[0]["steps"] == 50 and found.rows[3]["steps"] > 3 * found.rows[2]["steps"]
    assert found.figures["alpha_error_end"] == found.rows[0]["error_end"]


def test_the_refined_run_is_what_another_family_comes_to(found):
    """Generalized-alpha at 24 times the steps has 1/576 of its error left."""
    finer = solve(found.ivp.model, 0.05, GeneralizedAlpha(h=1e-3 / 24)).position("tip")[-1]
    own = reference_run(found.ivp, None, np.array([0.0, 0.03, 0.05]), lambda *seen: None)
    assert own.t[-1] == 0.05 and np.linalg.norm(own.watched[-1] - finer) < 5e-3 * found.rows[0]["error_end"]


def test_errors_are_those_between_the_steps_of_the_refined_run(found):
    """Its polynomial is as exact as its steps are."""
    run = found.runs["generalized-alpha"]
    exact = solve(found.ivp.model, 0.05, RadauIIA(rtol=1e-11), output=run.t).position("tip")
    distance = np.linalg.norm(run.position("tip") - exact, axis=1)
    assert found.distances["generalized-alpha"][1] == pytest.approx(distance, abs=1e-3 * distance.max())


def test_published_digits_judge_every_run_of_a_problem_that_has_them():
    rows = compare(load("andrews")).rows
    assert [row["published_error"] < limit for row, limit in zip(rows, (1e-2, 5e-3, 1e-3, 1e-3), strict=True)] == [True] * 4


def test_energy_gained_is_the_work_of_the_motors():
    run = solve(plates.double_plate_motors(cells=8).build(), 1.0, GeneralizedAlpha(h=1e-3))
    gained = run.energy.total[-1] - run.energy.total[0]
    assert gained > 60.0 and motor_work(run)[-1] == pytest.approx(gained, rel=1e-3)
    assert abs(unbalanced(run)[-1]) < 1e-3 * gained


def test_a_failed_run_is_a_note_and_the_others_are_kept():
    soft = plates.Material(E=2e5, nu=0.3, rho=1100.0)
    model = plates.double_plate_motors(cells=8, material=soft).build()
    found = compare(InitialValueProblem("soft", model, t_end=0.5, step=5e-3, point="tip"))
    assert not found.success and found.notes
    assert all(len(run.t) > 1 for run in found.runs.values())


def test_members_of_a_user_s_own_are_what_is_compared():
    members = {"two": pi.EnergyMomentum(h=1e-3), "IDA": pi.IDA(rtol=1e-8)}
    found = compare(load("double-plate", cells=8, time=0.01), integrators=members)
    assert [row["run"] for row in found.rows] == ["two", "IDA", "refined run"] and found.success
    ends = [run.position("tip")[-1] for run in found.runs.values()]
    assert found.gap == pytest.approx(np.linalg.norm(ends[0] - ends[1]), rel=1e-9)
    assert {"two_error_end", "ida_error_end", "refined_steps"} <= set(found.figures) and "alpha_error_end" not in found.figures
    fine = float(re.search(r"rtol=([\d.e-]+)", found.rows[-1]["settings"])[1])
    assert fine == pytest.approx(1e-11) and "two integrators" in found.gap_text()


OWN = """
import polyida as pi

class Mine:
    def __init__(self, h):
        self.h = h

    def steps(self, model, state, t_end, counts):
        return pi.EnergyMomentum(h=self.h).steps(model, state, t_end, counts)

class Tight(Mine):
    def __init__(self, rtol, h=0.25):
        self.rtol = rtol
        super().__init__(h)

def halved(step):
    return Mine(step / 2)

def two(h, x):
    return Mine(h)

def no_step():
    return Mine(1.0)

def three(h):
    return 3

made = Mine(0.125)
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder with a file of integrators, to stand in; a job with steps of 1e-2 s."""
    monkeypatch.chdir(tmp_path)
    for name in ("own.py", "other.py"):
        (tmp_path / name).write_text(OWN)
    yield InitialValueProblem("job", plates.double_plate(cells=4).build(), step=1e-2)
    for name in ("own", "other"):
        sys.modules.pop(name, None)


def test_classes_functions_of_a_step_and_objects_of_a_file_are_integrators(own):
    names = ["energy", "own.py:Mine", "own.py:halved", "own.py:made", "own.py:Tight", "IDA"]
    found = named_integrators(own, names, step=own.step, rtol=1e-3)
    assert list(found) == ["energy-momentum", "Mine", "halved", "made", "Tight", "IDA"]
    assert [getattr(member, "h", None) for member in found.values()] == [1e-2, 1e-2, 5e-3, 0.125, 0.25, None]
    assert [getattr(member, "rtol", None) for member in found.values()] == [None, None, None, None, 1e-3, 1e-3]


def test_what_is_compared_by_default_takes_the_step_and_the_tolerance_that_it_always_took(own):
    assert list(named_integrators(own).values()) == [pi.GeneralizedAlpha(h=1e-2), pi.IDA(), pi.RadauIIA()]
    assert list(named_integrators(own, step=own.step, rtol=1e-7).values()) == [
        pi.GeneralizedAlpha(h=1e-2),
        pi.IDA(rtol=1e-7),
        pi.RadauIIA(rtol=1e-7),
    ]


@pytest.mark.parametrize(
    "names, settings, said",
    [
        (["nope"], {}, "'nope' is unknown; there are alpha, ida, radau, energy"),
        (["own.py:nope"], {}, "integrators there: Mine, Tight, halved, two, three, made"),
        (["own.py:two"], {}, "needs x"),
        (["own.py:no_step"], {}, "has no 'no_step'"),
        (["own.py:three"], {}, "3 is no integrator"),
        (["own.py:Tight"], {}, "must have --rtol"),
        (["alpha", "GeneralizedAlpha"], {}, "alpha and GeneralizedAlpha are the same"),
        (["alpha", "energy"], {"rtol": 1e-3}, "--rtol is no setting of alpha, energy"),
    ],
)
def test_an_integrator_that_cannot_be_is_told_with_those_that_can(own, names, settings, said):
    with pytest.raises(InputError, match=re.escape(said)):
        named_integrators(own, names, **settings)


def test_estimated_errors_stand_beside_the_measured_ones():
    """Of a point and of coordinates; a run whose estimate is not trusted has none, and the reason."""
    crank = InitialValueProblem("crank", slider_crank("rigid").build(), t_end=0.2, point="slider")
    for ivp, h in ((crank, 1e-3), (load("andrews", time=5e-3), 5e-5)):
        members = {"alpha": pi.GeneralizedAlpha(h=h, tolerance=1e-10), "IDA": pi.IDA(rtol=1e-6)}
        found = compare(ivp, integrators=members, errors=True)
        assert found.rows[0]["estimated_error"] == pytest.approx(found.rows[0]["error_end"], rel=0.05)
        assert not any("estimated_error" in row for row in found.rows[1:]) and not found.estimates
    found = compare(load("double-plate", cells=8, time=0.5), integrators={"alpha": pi.GeneralizedAlpha(h=2e-3)}, errors=True)
    assert "estimated_error" not in found.rows[0] and "alpha has no estimated error" in found.estimates[0]
    assert "phase is lost" in found.estimates[0]


def test_the_command_prints_and_reports_estimated_errors(tmp_path, capsys, monkeypatch, pages_alone):
    monkeypatch.setenv("COLUMNS", "200")
    words = ["compare", "pendulum", "--time", "0.2", "--integrators", "alpha", "--errors", "--out", str(tmp_path / "report")]
    assert main(words) == 0
    assert "at the end, estimated" in capsys.readouterr().out
    assert "at the end, estimated" in (tmp_path / "report" / "report.html").read_text()


def test_a_run_of_few_steps_is_drawn_with_frames_between_them():
    ivp = load("pendulum", time=0.3)
    runs = {"Radau IIA": ivp.run(pi.RadauIIA(rtol=1e-6))}
    drawn = with_frames_between(ivp, runs)["Radau IIA"]
    assert len(runs["Radau IIA"]) < 50 and len(drawn) >= FEW_FRAMES
    assert drawn.q[-1] == pytest.approx(runs["Radau IIA"].q[-1], abs=1e-12)
    length = np.hypot(*drawn.q.T)
    assert length == pytest.approx(1.0, abs=1e-5)  # a chord between two steps is off by more
