"""Settings as runs used them: what SUNDIALS got, in runs, files, tables and reports."""

import json

import numpy as np
import pytest

import polyida as pi
from polyida.cli.commands import main
from polyida.errors import InputError
from polyida.study.ivp import settings_text

PASSED = 1e-5**1.5  # rtol of IDA for rtol = 1e-5 of flexible bodies, with order 2


def plate():
    """A rubber plate of 12 cells that swings on a pin."""
    scene, rubber = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=50e6, nu=0.3, rho=1100.0)
    arm = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1), rubber, 0.01, name="arm"))
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="pin"))
    scene.add(pi.PointMass(arm.section("right"), 0.1, name="tip"))
    return scene.build()


@pytest.fixture(scope="module")
def model():
    with pytest.warns(pi.LockingWarning):
        return plate()


@pytest.mark.parametrize(
    "integrator", [pi.IDA(rtol=1e-5), pi.IDA(), pi.IDA(rtol=1e-5, atol=1e-6), pi.IDA(ida_rtol=1e-6, atol=(1e-7, 1e-3))]
)
def test_settings_used_are_what_sundials_got(integrator, model, monkeypatch):
    from sksundae.ida import IDA as Solver

    got = {}
    monkeypatch.setattr("sksundae.ida.IDA", lambda residual, **settings: got.update(settings) or Solver(residual, **settings))
    used = pi.solve(model, 2e-3, integrator).settings_used
    n = model.n
    assert (used["ida_rtol"], used["max_order"]) == (got["rtol"], got["max_order"])
    assert (used["atol"][0], used["atol"][1]) == (got["atol"][0], got["atol"][n]) and used["rtol"] is not None


def test_what_is_asked_and_what_is_passed_are_one_run(model, tmp_path):
    asked, passed = (pi.solve(model, 0.01, integrator) for integrator in (pi.IDA(rtol=1e-5), pi.IDA(ida_rtol=PASSED)))
    assert asked.counts == passed.counts and np.abs(asked.q - passed.q).max() < 1e-12
    assert passed.settings_used["rtol"] == pytest.approx(1e-5, rel=1e-12)
    asked.save(tmp_path / "run.h5")
    assert pi.load(tmp_path / "run.h5").settings_used == asked.settings_used


def test_a_rigid_model_gets_what_is_asked():
    used = pi.solve(pi.problems.get("rigid-pendulum").model, 0.01, pi.IDA(rtol=1e-6)).settings_used
    assert used["rtol"] == used["ida_rtol"] == 1e-6 and used["max_order"] == 5


@pytest.mark.parametrize(
    "more", [{"until": lambda t, q, v: t - 2e-3}, {"events": [pi.Event(lambda state: state.t - 2e-3)]}, {"output": [1e-3]}]
)
def test_settings_used_are_known_however_a_run_goes_on(more, model):
    assert pi.solve(model, 4e-3, pi.IDA(rtol=1e-5), **more).settings_used["ida_rtol"] == pytest.approx(PASSED)


@pytest.mark.parametrize(("integrator", "names"), [(pi.RadauIIA(), ("rtol", "atol")), (pi.GeneralizedAlpha(), ("rtol", "atol"))])
def test_tolerances_that_a_run_chose_stand_in_place_of_none(integrator, names, model):
    used = pi.solve(model, 0.01, integrator).settings_used
    assert all(used[name] > 0 for name in names)
    assert f"rtol={used['rtol']:g}" in settings_text(integrator, [integrator], used)


def test_labels_of_studies_have_the_number_that_acted(model):
    integrators = [pi.IDA(rtol=1e-4), pi.IDA(rtol=1e-5)]
    used = pi.solve(model, 2e-3, integrators[1]).settings_used
    assert settings_text(integrators[1], integrators) == "rtol=1e-05"
    assert settings_text(integrators[1], integrators, used) == "rtol=1e-05, ida_rtol=3.16228e-08"


@pytest.mark.parametrize("settings", [{"ida_rtol": 1e-5}, {"rtol": 1e-5}])
def test_labels_do_not_say_one_number_twice(settings):
    used = pi.solve(pi.problems.get("rigid-pendulum").model, 0.01, pi.IDA(**settings)).settings_used
    ((name, value),) = settings.items()
    assert settings_text(pi.IDA(**settings), [pi.IDA(**settings), pi.IDA(**{name: 1e-6})], used) == f"{name}={value:g}"


def test_an_integrator_of_a_user_shows_its_own_settings():
    class Mine:
        def __init__(self, h):
            self.h, self._hidden = h, 1.0

        def steps(self, model, state, t_end, counts):
            yield from pi.GeneralizedAlpha(h=self.h).steps(model, state, t_end, counts)

    run = pi.solve(pi.problems.get("rigid-pendulum").model, 0.01, Mine(5e-3))
    assert run.settings_used == {"h": 5e-3}


@pytest.mark.parametrize("wrong", [{"ida_rtol": 2.0}, {"ida_rtol": "1e-5"}, {"ida_rtol": 1e-17}, {"rtol": 1e-5, "ida_rtol": 1e-7}])
def test_wrong_settings_of_what_is_passed(wrong):
    with pytest.raises(InputError, match="IDA: ida_rtol"):
        pi.IDA(**wrong)


def test_the_files_of_compare_hold_the_settings_used(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "rigid-pendulum", "--time", "0.02", "--integrators", "ida,radau", "--out", "page"]) == 0
    rows = json.loads((tmp_path / "page/figures.json").read_text())["rows"]
    assert [row["settings_used"]["rtol"] is not None for row in rows] == [True] * 3 and "None" not in " ".join(
        row["settings"] for row in rows
    )
    assert rows[0]["settings_used"]["ida_rtol"] == rows[0]["settings_used"]["rtol"]
    assert "ida_rtol=" in (tmp_path / "page/report.html").read_text()
