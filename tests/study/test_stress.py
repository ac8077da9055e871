"""The stress study tells right from wrong: what is broken on purpose is found, what is sound passes."""

from dataclasses import replace

import numpy as np
import pytest

import polyida as pi
from polyida.errors import StepFailure
from stress import cases, identities, outcome, scenes
from stress.axes import AXES, run
from stress.kills import killed_runs
from stress.long import many_steps
from stress.outcome import Check, Stop, judged, outcome_of


@pytest.fixture(scope="module")
def swing():
    return pi.solve(scenes.swing(), 0.1, pi.GeneralizedAlpha(h=1e-3))


GOOD = [Check("good", 0.5, 1.0)]


def test_right_is_what_meets_its_checks(swing):
    assert judged(swing, GOOD)["outcome"] == "right"
    row = judged(swing, [*GOOD, Check("bad", 2.0, 1.0)])
    assert (row["outcome"], row["checked"], row["reason"]) == ("wrong", "bad", "bad 2 > 1")


COLLAPSE = Stop(("inverted",), ("has collapsed",))
GAVE_UP = {"status": "newton", "message": "Newton does not converge at t = 0.1 s"}


def test_a_stop_is_right_only_where_it_was_foreseen(swing):
    stopped = replace(swing, status="inverted", message="St. Venant-Kirchhoff has collapsed")
    assert judged(stopped, [], COLLAPSE)["outcome"] == "stated_stop"
    assert judged(stopped, [])["outcome"] == "unforeseen_stop"
    assert judged(replace(swing, **GAVE_UP), [], COLLAPSE)["outcome"] == "unforeseen_stop"
    assert judged(replace(stopped, message="it stops"), [], COLLAPSE)["outcome"] == "unforeseen_stop"


def test_a_stop_needs_a_message_and_sound_frames(swing):
    stopped = replace(swing, status="inverted", message="St. Venant-Kirchhoff has collapsed")
    assert judged(replace(stopped, message=""), [], COLLAPSE)["outcome"] == "wrong"
    assert judged(replace(stopped, q=swing.q + 0.1), [], COLLAPSE)["checked"] == "drift at the stop"
    assert judged(replace(stopped, lam=swing.lam * np.nan), [], COLLAPSE)["outcome"] == "wrong"


def test_a_foreseen_stop_must_come_and_at_its_time(swing):
    assert judged(swing, GOOD, COLLAPSE)["outcome"] == "wrong"
    assert judged(swing, GOOD, replace(COLLAPSE, only=False))["outcome"] == "right"
    stopped = replace(swing, status="inverted", message="St. Venant-Kirchhoff has collapsed")
    late = [Check("time of the collapse, s", 2.0, 1.0, at_stop=True), Check("of the end", 2.0, 1.0)]
    assert judged(stopped, late[1:], COLLAPSE)["outcome"] == "stated_stop"
    assert (judged(stopped, late, COLLAPSE)["outcome"], judged(stopped, late, COLLAPSE)["checked"]) == ("wrong", late[0].name)
    assert judged(swing, [*GOOD, late[0]])["outcome"] == "right"


def refuse():
    raise pi.InputError("Plate 'board': cell 5 is a sliver")


def test_refused_input_is_right_where_it_was_foreseen_and_a_traceback_is_not():
    row = run("held twice", "hinge twice", "alpha")
    assert row["outcome"] == "stated_stop" and row["status"] == "refused" and "redundant" in row["reason"]
    assert outcome_of(refuse)["outcome"] == outcome_of(refuse, foreseen=COLLAPSE)["outcome"] == "unforeseen_stop"
    assert outcome_of(refuse, foreseen=cases.too_thin(1e-9, "alpha"))["outcome"] == "stated_stop"
    assert outcome_of(refuse, foreseen=cases.too_thin(1e-7, "alpha"))["outcome"] == "unforeseen_stop"
    with pytest.raises(ZeroDivisionError):
        outcome_of(lambda: 1 / 0)
    assert outcome.outcome_in({"error": "ZeroDivisionError: division by zero"}) == "crash"


def test_the_benign_value_of_every_axis_but_one_foresees_no_stop():
    benign = {title: [axis.foreseen(axis.values[0], name) for name in axis.integrators] for title, axis in AXES.items()}
    assert {title for title, stops in benign.items() if any(stops)} == {"held twice"}


class Wrong:
    """An integrator that is a little wrong: gravity, or the constraints, are not quite what the model says."""

    def __init__(self, change):
        self.change = change

    def steps(self, model, state, t_end, counts):
        for after in pi.GeneralizedAlpha(h=1e-3).steps(model, state, t_end, counts):
            yield self.change(after)


def shifted(state):
    return replace(state, q=state.q + 1e-6)


def faster(state):
    return replace(state, v=1.05 * state.v)


@pytest.mark.parametrize("change, found", [(shifted, "drift"), (faster, "energy gained")])
@pytest.mark.parametrize("axis", ["modulus, Pa", "four-bar from, rad"])
def test_a_wrong_integrator_is_found(monkeypatch, change, found, axis):
    monkeypatch.setattr(cases, "integrator", lambda name, *_, **__: Wrong(change) if name == "ggl1" else outcome.integrator("alpha"))
    row = outcome_of(AXES[axis].case, AXES[axis].quick[0], "ggl1")
    assert row["outcome"] == "wrong" and found in row["reason"]


def taken(number, title):
    """Ways of an axis: two through contacts, alpha and Radau by turns through motions that are smooth."""
    names = AXES[title].integrators
    return names[:2] if "nonsmooth" in names else ("radau",) if "radau" in names and number % 2 else ("alpha",)


BENIGN = [(title, name) for k, title in enumerate(AXES) for name in taken(k, title) if title.split()[0] not in ("steps", "kills")]


@pytest.mark.parametrize("axis, name", BENIGN)
def test_the_benign_end_of_every_axis_is_right(axis, name):
    row = run(axis, AXES[axis].values[0], name)
    assert row["outcome"] == ("stated_stop" if axis == "held twice" else "right"), row


@pytest.mark.parametrize("name", ["alpha", "energy", "ggl2", "radau"])
def test_the_materials_limit_is_found_and_named(name):
    assert outcome_of(cases.pressing, 0.18, name)["outcome"] == "right"
    beyond = run("pressure over modulus", 0.25, name)
    assert beyond["outcome"] == "stated_stop" and "St. Venant-Kirchhoff has collapsed" in beyond["reason"]


def test_rigid_bodies_fall_as_in_the_textbook():
    """Uniform thin rods of 1 m: at first the upper one turns with 9 g/7 / m, the lower one with -3 g/7 / m."""
    t = 1e-2
    scene = pi.problems.get("double-plate", cells=40).model
    place = cases.rigid_tip(scene, t)
    mass = {"plates": [1.1, 1.1], "tip": 0.5}
    one, two = mass["plates"]
    inertia = np.array([[one * (1 / 3 + 0.01 / 12) + two + 0.5, two / 2 + 0.5], [two / 2 + 0.5, two * (1 / 3 + 0.01 / 12) + 0.5]])
    turn = np.linalg.solve(inertia, -9.81 * np.array([one / 2 + two + 0.5, two / 2 + 0.5])) * t**2 / 2
    assert place[1] == pytest.approx(turn.sum(), rel=1e-3) and place[0] == pytest.approx(2.0, abs=1e-5)


class Turning:
    """A run of a plate that turns as `driven` does: rigid, but for what `change` makes of its frames."""

    def __init__(self, change):
        self.change = change

    def steps(self, model, state, t_end, counts):
        for after in pi.GeneralizedAlpha(h=1e-3).steps(model, state, t_end, counts):
            yield self.change(model, after)


def one_turn_less(model, state):
    """The whole of a step's motion as it would be where the motor stood still."""
    return replace(state, q=0 * state.q, v=0 * state.v)


def longer(model, state):
    """Every node 0.1 % farther from the hub."""
    return replace(state, q=state.q + 1e-3 * (model.reference.ravel() + state.q))


def idle(model, state):
    return replace(state, v=0.9 * state.v)


@pytest.mark.parametrize("change, found", [(one_turn_less, "turned angle"), (longer, "length"), (idle, "kinetic energy")])
def test_turns_that_are_none_are_found(monkeypatch, change, found):
    monkeypatch.setattr(identities, "integrator", lambda name, **settings: Turning(change))
    _, checks = identities.many_turns(3, "alpha")
    assert [check for check in checks if found in check.name and check.share > 1]


def lopsided(model, state):
    """Accelerations 1 % too large."""
    return replace(state, a=1.01 * state.a)


def test_long_steps_without_balance_are_found(monkeypatch):
    monkeypatch.setattr(identities, "integrator", lambda name, h: Turning(lopsided))
    _, checks = identities.large_steps(0.01, "alpha")
    assert next(check for check in checks if check.name == "balance of all forces").share > 1


def test_a_motion_that_does_not_come_back_is_found(monkeypatch):
    """Steps so long that they damp the bending: going back ends elsewhere."""
    monkeypatch.setattr(identities, "integrator", lambda name: pi.GeneralizedAlpha(h=1e-2, rho_inf=0.5))
    _, checks = identities.reversal(10.0, "alpha")
    assert next(check for check in checks if check.name.startswith("back at the start")).share > 1


def test_a_collapse_at_another_time_is_found(monkeypatch):
    """The driven plates fold at 0.642 s; a run that stops there is right, one that stops before is not."""
    assert run("driven collapse, Pa", 1e6, "alpha")["outcome"] == "stated_stop"
    monkeypatch.setattr(cases, "integrator", lambda name, *_, **__: Early() if name == "ggl1" else outcome.integrator(name, *_, **__))
    row = run("driven collapse, Pa", 1e6, "ggl1")
    assert row["outcome"] == "wrong" and "collapse" in row["checked"]


class Early:
    def steps(self, model, state, t_end, counts):
        yield from pi.GeneralizedAlpha(h=1e-3).steps(model, state, 0.5, counts)
        raise StepFailure("inverted", "St. Venant-Kirchhoff has collapsed", 0.5)


@pytest.mark.parametrize("name, t_end", [("alpha", 0.4), ("radau", 0.1)])
def test_five_kills_of_a_run(name, t_end, in_a_new_process):
    last, checks = in_a_new_process(killed_runs, 5, name, seed=3, t_end=t_end)
    assert judged(last, checks)["outcome"] == "right", checks


@pytest.mark.parametrize("name", ["alpha", "energy"])
def test_many_steps_cost_the_same_to_the_end(name, monkeypatch):
    """Drift and memory; the time of a step is not asked for here, where other things run beside."""
    last, checks = many_steps(5_000, name)
    assert last.success and all(check.share <= 1 for check in checks if not check.name.startswith("time")), checks
