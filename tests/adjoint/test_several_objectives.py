"""Gradients of several objectives from one backward sweep are those of each objective alone."""

import numpy as np
import pytest

import polyida as pi
from polyida.adjoint import history
from polyida.problems.equations import Pendulum

OBJECTIVES = [
    pi.objective.Deviation("tip", (1.0, 0.3)),
    1e8 * pi.objective.PeakReaction("motor", p=4),
    1e-8 * pi.objective.StrainEnergy("arm"),
    pi.objective.PeakStress("arm"),
]
WAYS = {
    "fixed": (pi.GeneralizedAlpha(2.3e-3, tolerance=1e-10), {}),
    "few frames": (pi.GeneralizedAlpha(2e-3, tolerance=1e-10), {"every": 3}),
    "changes of h": (pi.GeneralizedAlpha(4e-3, rtol=1e-3, tolerance=1e-10), {}),
    "stabilised": (pi.GeneralizedAlpha(2e-3, form="stabilised", tolerance=1e-10), {}),
    "Radau": (pi.RadauIIA(h=4e-3), {}),
    "adaptive Radau, ggl": (pi.RadauIIA(rtol=1e-4, form="ggl"), {"every": 2}),
}


def arm():
    """A soft plate that a motor turns, with a kink in the run, and a mass at its tip."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.25, cells=8, seed=1), pi.Material(3e7, 0.3, 1100.0), thickness=0.01, name="arm"))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="hub"))
    scene.add(pi.AngleMotor(pi.ground, plate.section("left"), angle=pi.profile.quintic(0.0, 1.0, 0.04), name="motor"))
    scene.add(pi.PointMass(plate.section("right"), 0.05, name="tip"))
    return scene.build()


MODEL = arm()


def require_same(found, alone, rtol):
    assert [one.value for one in found] == [one.value for one in alone]
    for one, other in zip(found, alone):
        assert set(one) == set(other) and one.left_out == other.left_out
        for name in other:
            assert np.allclose(one[name], other[name], rtol=rtol, atol=rtol * np.abs(other[name]).max()), name


@pytest.mark.parametrize("way", WAYS)
def test_runs(way, monkeypatch):
    integrator, asked = WAYS[way]
    run = pi.solve(MODEL, 0.06, integrator, **asked)
    alone, solved, again = [pi.gradient(run, one) for one in OBJECTIVES], [], history.replayed_history
    for module in (history, pi.adjoint.radau_history):
        monkeypatch.setattr(module, "replayed_history", lambda *arguments: solved.append(1) or again(*arguments))
    together = pi.gradient(run, OBJECTIVES)
    require_same(together, alone, 1e-6)
    assert len(solved) <= 1
    assert together[0].counts.factorizations <= max(one.counts.factorizations for one in alone) + 1 or way == "stabilised"


def test_a_list_of_one_and_what_is_no_objective():
    run = pi.solve(MODEL, 0.02, pi.GeneralizedAlpha(2e-3))
    require_same(pi.gradient(run, OBJECTIVES[:1]), [pi.gradient(run, OBJECTIVES[0])], 0.0)
    with pytest.raises(pi.InputError, match="list of objectives is empty"):
        pi.gradient(run, [])
    with pytest.raises(pi.InputError, match="3.0 is no objective"):
        pi.gradient(run, [OBJECTIVES[0], 3.0])


def test_equilibria():
    scene = pi.Scene()
    plate = scene.add(pi.Plate(pi.mesh.quads(1.0, 0.2, 4, 2), pi.Material(3e7, 0.3, 1100.0), thickness=0.01, name="arm"))
    scene.add(pi.Clamp(pi.ground, plate.section("left"), name="motor"))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, -1.0), name="load"))
    state = pi.static(scene.build())
    objectives = [pi.objective.Compliance(), pi.objective.PeakStress("arm"), pi.objective.StrainEnergy("arm")]
    together = pi.gradient(state, objectives)
    require_same(together, [pi.gradient(state, one) for one in objectives], 1e-12)
    assert (together[0].counts.factorizations, together[0].counts.solves) == (1, 3)


def test_models_of_ones_own_and_their_events():
    heights = [pi.objective.UserObjective(lambda run, k=k: float(run.q[-1, k]), lambda run, k=k: {"q": last(run, k)}) for k in range(2)]

    def last(run, k):
        slopes = np.zeros(np.shape(run.q))
        slopes[-1, k] = 1.0
        return slopes

    model = Pendulum()
    for integrator in (pi.GeneralizedAlpha(5e-3), pi.RadauIIA(h=1e-2)):
        run = pi.solve(model, 0.5, integrator, q0=(1.0, 0.0))
        require_same(pi.gradient(run, heights), [pi.gradient(run, one) for one in heights], 1e-10)


def test_runs_with_impacts():
    scene = pi.Scene(gravity=(0.0, -9.81))
    ball = scene.add(pi.RigidBody(1.0, 0.01, {"centre": (0.0, 0.3)}, name="ball"))
    scene.add(pi.Contact(ball.at("centre"), pi.ground.at((0.0, 0.0)), restitution=0.7, name="floor"))
    run = pi.solve(scene.build(), 0.4, pi.GeneralizedAlpha(1e-3))
    assert len(run.events) == 1
    objectives = [pi.objective.Deviation("floor", (0.0, 0.0)), pi.objective.Deviation("floor", (0.1, 0.2))]
    require_same(pi.gradient(run, objectives), [pi.gradient(run, one) for one in objectives], 1e-10)
