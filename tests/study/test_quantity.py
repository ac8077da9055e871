"""Errors over time: of a point, a joint, a sensor or a function of the run, in a norm; and orders that are none yet."""

import numpy as np
import pytest

import polyida as pi
from polyida.errors import InputError
from polyida.study.precision import StepSizes
from polyida.study.quantity import TIMES, Quantity

ALPHA = {"alpha": pi.GeneralizedAlpha}
STEPS = (4e-3, 2e-3, 1e-3)


def pendulum():
    """A bar on a pin, from rest."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), bar.at("left"), name="pin"))
    scene.add(pi.PointMass(bar.at("right"), 0.1, name="tip"))
    return scene.build()


def study(of=None, norm="end", **more):
    return pi.study.step_sizes(pendulum(), 0.4, integrators=ALPHA, h=STEPS, of=of, norm=norm, progress=False, **more)


def test_errors_over_time_are_those_of_the_runs():
    """Against a run whose steps are 64 times shorter, at the same times."""
    found = study("tip", "max")
    times = np.linspace(0.0, 0.4, TIMES + 1)[1:]
    fine, run = (pi.solve(pendulum(), 0.4, pi.GeneralizedAlpha(h=h), output=times) for h in (1e-3 / 64, 1e-3))
    apart = np.linalg.norm(run.position("tip") - fine.position("tip"), axis=1)
    assert found.rows[-1]["error_tip"] == pytest.approx(apart.max(), rel=1e-2) and found.parts == ("tip",)
    assert found.orders["alpha"]["tip"] == pytest.approx(2.0, abs=0.1)
    assert study("tip", "rms").rows[-1]["error_tip"] == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-2)
    assert study("tip").rows[-1]["error_tip"] == pytest.approx(apart[-1], rel=1e-2)


@pytest.mark.parametrize(
    ("of", "name"),
    [
        ("pin", "pin"),
        (pi.sensor.position("tip"), "sensor"),
        (pi.sensor.reaction("pin"), "sensor"),
        (lambda run: run.energy.total, "quantity"),
        (None, "q"),
    ],
)
def test_what_can_be_compared_over_time(of, name):
    found = study(of, "rms")
    assert found.parts[0] == name and all(np.isfinite(row[f"error_{name}"]) for row in found.rows)
    assert found.plot().get_ylabel().startswith("rms error in") and "root mean square" in found.lead
    assert f"rms error in {name}" in str(found)


def test_the_norms_of_a_difference():
    difference = np.array([[3.0, 4.0], [0.0, 1.0], [1.0, 0.0]])
    norms = {norm: Quantity({}, np.zeros(3), norm, lengths=True).size(difference) for norm in ("end", "max", "rms")}
    assert norms == {"end": 1.0, "max": 5.0, "rms": pytest.approx(3.0)}
    assert Quantity({}, np.zeros(3), "max").size(difference) == 4.0


def test_a_function_of_the_run_has_its_name():
    def height(run):
        return run.position("tip")[:, 1]

    found = pi.study.work_precision(
        pendulum(), 0.1, integrators={"alpha": [pi.GeneralizedAlpha(h=2e-3)]}, of=height, norm="max", progress=False
    )
    assert found.parts == ("height",) and found.rows[0]["error_height"] > 0
    assert set(found.pictures()) == {"error-height", "residuals"}


def fails(run):
    raise ValueError("no such thing")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"norm": "mean"}, "norm = 'mean'"),
        ({"of": "elbow"}, "of = 'elbow'"),
        ({"of": 3}, "of = 3"),
        ({"of": fails}, "ValueError: no such thing"),
        ({"of": lambda run: 1.0}, "for each of the run's 2 frames"),
        ({"of": lambda run: np.full(len(run), np.nan)}, "finite numbers"),
        ({"of": "tip", "reference": {"q": [0.0]}}, "reference = dict"),
    ],
)
def test_wrong_quantities_are_refused_before_the_runs(wrong, told, monkeypatch):
    monkeypatch.setattr("polyida.study.ivp.InitialValueProblem.run", lambda *_, **__: pytest.fail("a run began"))
    with pytest.raises(InputError, match="step_sizes: ") as error:
        study(**wrong)
    assert told in str(error.value)


def test_a_name_of_a_point_needs_a_scene():
    with pytest.raises(InputError, match="names a point of a scene"):
        pi.study.step_sizes("pendulum", 0.1, integrators=ALPHA, h=STEPS, of="tip", progress=False)


@pytest.mark.parametrize(
    ("errors", "known", "order", "told"),
    [
        ([1e-2, 2.5e-3, 6.25e-4, 1.5625e-4], 1e-9, 2.0, ""),
        ([1e-3, 1e-3, 5e-4, 6e-5], 1e-9, np.nan, "no order in q yet"),
        ([1e-9, 2e-9, 1.5e-9, 1e-9], 1e-9, np.nan, "at the reference's level"),
    ],
)
def test_errors_that_are_not_asymptotic_have_no_order(errors, known, order, told):
    rows = [
        {
            "integrator": "one",
            "setting": f"h={h:g}",
            "h": h,
            "t": 1.0,
            "steps": round(1 / h),
            "status": "done",
            "cpu_s": h,
            "error_q": error,
        }
        for h, error in zip((1 / 8, 1 / 16, 1 / 32, 1 / 64), errors)
    ]
    found = StepSizes("made up", rows, [], {"q": np.zeros(2), "known_to": {"q": known}, "made_by": ["hand"], "failed": []})
    assert found.orders["one"]["q"] == pytest.approx(order, nan_ok=True)
    assert [note for note in found.notes if "no order" in note] == [note for note in found.notes if told and told in note]
    assert bool(told) == any("no order" in note for note in found.notes) and ("order_q one" in found.figures) == (not told)
