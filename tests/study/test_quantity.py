"""Errors over time: of a point, a joint, a sensor or a function of the run, in a norm; and orders that are none yet."""

import numpy as np
import pytest

import polyida as pi
from polyida.errors import InputError
from polyida.study.precision import StepSizes
from polyida.study.quantity import Quantity

ALPHA = {"alpha": pi.GeneralizedAlpha}
STEPS = (4e-3, 2e-3, 1e-3)
POSITION, REACTION = pi.sensor.position("tip"), pi.sensor.reaction("pin")


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
    """Against a run whose steps are 64 times shorter, at the steps of the run."""
    found = study("tip", "max")
    run = pi.solve(pendulum(), 0.4, pi.GeneralizedAlpha(h=1e-3), every=2)
    fine = pi.solve(pendulum(), 0.4, pi.GeneralizedAlpha(h=1e-3 / 64), output=run.t)
    apart = np.linalg.norm(run.position("tip") - fine.position("tip"), axis=1)[1:]
    assert found.rows[-1]["error_tip"] == pytest.approx(apart.max(), rel=1e-2) and found.parts == ("tip",)
    assert found.orders["alpha"]["tip"] == pytest.approx(2.0, abs=0.1)
    assert study("tip", "rms").rows[-1]["error_tip"] == pytest.approx(np.sqrt(np.mean(apart**2)), rel=1e-2)
    assert study("tip").rows[-1]["error_tip"] == pytest.approx(apart[-1], rel=1e-2)


def swinging_bar(pushed=None):
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, angle=0.5, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hinge"))
    if pushed is not None:
        scene.add(pi.PointLoad(bar.at("right"), (0.0, 20.0), pushed))
    return scene.build()


def test_errors_over_time_are_not_those_of_interpolation():
    """Long steps of Radau IIA: lam is linear between them, which is a hundred times less accurate than the steps are."""
    rough, fine = (pi.RadauIIA(rtol=rtol) for rtol in (1e-6, 1e-12))
    found = pi.study.work_precision(swinging_bar(), 0.5, integrators={"Radau IIA": [rough]}, norm="max", progress=False)
    run = pi.solve(swinging_bar(), 0.5, rough)
    ends = [pi.solve(swinging_bar(), t, fine).lam[-1] for t in run.t[1::4]]
    assert len(run) < 60 and 0 < np.abs(run.lam[1::4] - ends).max() <= 1.01 * found.rows[0]["error_lam"] < 5e-5
    sizes = pi.study.step_sizes(swinging_bar(), 0.5, integrators=ALPHA, h=STEPS, norm="max", progress=False)
    assert [sizes.orders["alpha"][part] for part in ("q", "v", "lam")] == pytest.approx([2.0, 2.0, 2.0], abs=0.1)


def test_a_load_that_jumps_at_a_step_makes_no_error():
    """lam has two values there; steps and reference have the one before the jump."""
    pushed = pi.profile.from_function(lambda t: float(t >= 0.1), kinks=(0.1,))
    found = pi.study.step_sizes(swinging_bar(pushed), 0.2, integrators=ALPHA, h=(2e-3, 1e-3), norm="max", progress=False)
    assert found.rows[1]["error_lam"] < 0.5 * found.rows[0]["error_lam"] < 0.1


@pytest.mark.parametrize(
    ("of", "name"), [("pin", "pin"), (POSITION, "sensor"), (REACTION, "sensor"), (lambda run: run.energy.total, "quantity"), (None, "q")]
)
def test_what_can_be_compared_over_time(of, name):
    found = study(of, "rms")
    assert found.parts[0] == name and all(np.isfinite(row[f"error_{name}"]) for row in found.rows)
    assert found.plot().get_ylabel().startswith("rms error in") and "root mean square" in found.lead
    assert f"rms error in {'position of tip' if of is POSITION else 'reaction of pin' if of is REACTION else name}" in str(found)


def test_an_attachment_can_be_compared():
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 2.0, name="bar"))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), bar.at("left"), name="pin"))
    runs = {"alpha": [pi.GeneralizedAlpha(h=2e-3)]}
    with pytest.raises(InputError, match="'bar' has no single point; give an attachment of a body"):
        pi.study.work_precision(scene, 0.02, integrators=runs, of="bar", progress=False)
    found = pi.study.work_precision(scene, 0.02, integrators=runs, of=bar.at("right"), progress=False)
    assert found.parts == ("bar right",) and found.rows[0]["error_bar right"] > 0 and found.plot().get_ylabel() == "error in bar right, m"
    seen = pi.study.work_precision(scene, 0.02, integrators=runs, of=pi.sensor.position(bar.at("right")), progress=False)
    assert seen.plot().get_ylabel() == "error in position of RigidBody 'bar' right, m"
    elsewhere = pi.RigidBody.bar(1.0, 2.0, name="other").at("right")
    with pytest.raises(InputError, match="its body is not in the scene"):
        pi.study.work_precision(scene, 0.02, integrators=runs, of=elsewhere, progress=False)


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
        ([0.27, 0.37, 0.5, 0.7], 1e-9, np.nan, "no order in q, its errors hardly fall with the step, or grow (slope -0.5)"),
        ([0.27, 0.4], 1e-9, np.nan, "slope -0.6"),
        ([0.3, 0.3], 1e-9, np.nan, "slope"),
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
