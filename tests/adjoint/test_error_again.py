"""Errors of quantities by runs with other steps: a verdict is earned by two of them."""

import dataclasses

import numpy as np
import pytest

import polyida as pi

P = pi.objective


def last(name, row):
    """One entry of q, v or lam at the end."""

    def slopes(run):
        result = np.zeros(getattr(run, name).shape)
        result[-1, row] = 1.0
        return {name: result}

    return P.UserObjective(lambda run: float(getattr(run, name)[-1, row]), slopes)


def chain():
    """Three bars that fall, with springs between them."""
    scene, side = pi.Scene(gravity=(0.0, -9.81)), pi.ground
    for k in range(3):
        bar = scene.add(pi.RigidBody.bar(0.5, 1.0, origin=(0.5 * k, 0.0), name=f"bar {k}"))
        scene.add(pi.Revolute(side, bar.at("left"), name=f"pin {k}"))
        if k:
            scene.add(pi.TorsionSpring(side, bar.at("left"), stiffness=20.0, name=f"spring {k}"))
        side = bar.at("right")
    scene.add(pi.PointMass(side, 0.5, name="tip"))
    return scene.build()


def clamped():
    """A plate without damping that gravity bends suddenly: steps of 5 to 40 ms lose the phase of its vibrations."""
    scene, material = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=5e7, nu=0.3, rho=1100.0)
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=8, seed=1), material, thickness=0.01, name="arm"))
    scene.add(pi.Weld(pi.ground, plate.section("left"), name="clamp"))
    scene.add(pi.PointMass(plate.section("right"), 0.1, name="tip"))
    return scene.build()


FORCE, PLACE = P.PeakReaction("pin 0", p=2), P.Deviation("tip", (0.3, -0.1))
WRONG = [  # one further run gives an estimate that is wrong by a factor of two or more, or has the wrong sign
    (chain, 0.8, pi.NonsmoothAlpha(h=8e-3), last("lam", 0)),
    (chain, 0.8, pi.RadauIIA(rtol=1e-3), FORCE),
    (chain, 0.8, pi.IDA(rtol=1e-3), FORCE),
    (clamped, 0.5, pi.EnergyMomentum(h=2e-2), P.StrainEnergy("arm")),
    (clamped, 0.5, pi.MoreauJean(h=2e-2), PLACE),
    (clamped, 0.5, pi.NonsmoothAlpha(h=2e-2), last("v", 5)),
    (clamped, 0.5, pi.RadauIIA(h=4e-2), last("v", 5)),
]
RIGHT = [
    (chain, 0.8, pi.EnergyMomentum(h=2e-3), PLACE),
    (chain, 0.8, pi.NonsmoothAlpha(h=2e-3), last("q", 4)),
    (chain, 0.8, pi.MoreauJean(h=2e-3), PLACE),
    (chain, 0.8, pi.RadauIIA(h=1e-2), PLACE),
    (chain, 0.8, pi.IDA(rtol=1e-6), last("v", 5)),
]


def bars_of(make, t_end, settings, objective):
    return pi.error_of(pi.solve(make(), t_end, settings), objective, again=True)


@pytest.mark.parametrize(("make", "t_end", "settings", "objective"), WRONG)
def test_estimates_that_runs_contradict_are_not_trusted(make, t_end, settings, objective):
    bars = bars_of(make, t_end, settings, objective)
    assert not bars.trusted and bars.corrected == bars.value and "not trusted" in repr(bars)


@pytest.mark.parametrize(("make", "t_end", "settings", "objective"), RIGHT)
def test_trusted_estimates_are_right_within_a_factor_of_two(make, t_end, settings, objective):
    bars = bars_of(make, t_end, settings, objective)
    exact = objective(pi.solve(make(), t_end, pi.RadauIIA(rtol=1e-9)))
    assert bars.trusted and 0.5 < bars.time / (exact - bars.value) < 2.0


@dataclasses.dataclass(frozen=True)
class Own:
    """A user's integrator, of any declared order."""

    h: float
    order: int

    def steps(self, model, state, t_end, counts):
        if self.h > 1.5e-2:
            raise pi.StepFailure("newton", "steps are too long", state.t)
        return pi.GeneralizedAlpha(h=self.h).steps(model, state, t_end, counts)


def test_an_own_integrator_of_a_wrong_order_is_not_trusted():
    """The ratio of the differences is that of its true order, 2."""
    right, wrong = (bars_of(chain, 0.4, Own(2e-3, order), PLACE) for order in (2, 1))
    assert right.trusted and not right.reasons["again"]
    assert not wrong.trusted and "of order 1 it is 2" in wrong.reasons["time"][0]


@pytest.mark.parametrize("order", [2, 5])
def test_an_own_integrator_without_a_third_run(order):
    """2 h is too long for it; of high order both further runs are finer."""
    bars = bars_of(chain, 0.4, Own(1e-2, order), PLACE)
    assert bars.trusted == (order == 5)
    assert order == 5 or "no run with 2 h" in bars.reasons["time"][0]


def test_runs_that_agree_contradict_an_estimate_by_the_adjoint(monkeypatch):
    """The adjoint's own estimate is right here; one that is three times as large is not trusted."""
    run = pi.solve(chain(), 0.4, pi.GeneralizedAlpha(h=2e-3))
    bars = pi.error_of(run, PLACE, again=True)
    assert bars.trusted and 0.9 < bars.again / bars.time < 1.1
    estimate = pi.adjoint.error_bars._estimate
    monkeypatch.setattr(pi.adjoint.error_bars, "_estimate", lambda *a: dataclasses.replace(estimate(*a), time=3.0 * bars.time))
    other = pi.error_of(run, PLACE, again=True)
    assert not other.trusted and "other steps" in other.reasons["time"][-1]


def test_a_quantity_without_an_error():
    """Gravity alone moves a free body: its place is exact for methods of second order, so that both differences are round-off or zero."""
    scene = pi.Scene()
    scene.add(pi.RigidBody.bar(1.0, 1.0, velocity=(1.0, 0.0), name="bar"))
    bars = bars_of(scene.build, 0.5, pi.MoreauJean(h=0.125), last("v", 0))
    assert bars.time == 0.0 and bars.trusted
