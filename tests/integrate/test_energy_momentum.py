"""The energy-momentum method: energy and momenta exactly kept, second order, joints and motors included."""

import numpy as np
import pytest

import polyida as pi
from polyida.study.energy import unbalanced

ENERGY = 1e-9  # of the energy exchanged, for Newton's tolerance


def test_energy_is_kept_while_plates_swing(scenes):
    scene, upper, lower = scenes.pair(bend=0.3)
    scene.add(pi.Revolute(pi.ground, upper.section("left")))
    scene.add(pi.Revolute(upper.section("right"), lower.section("left")))
    scene.add(pi.PointMass(lower.section("right"), 0.5))
    run = pi.solve(scene.build(), 1.0, pi.EnergyMomentum(h=4e-3))
    assert run.success, run.message
    assert np.ptp(run.energy.total) < ENERGY * np.ptp(run.energy.potential)
    assert run.counts.factorizations == 1 and run.drift.max() < 1e-12


def test_free_plate_keeps_its_momenta(scenes):
    scene, _ = scenes.single((0.0, 0.0))
    model = scene.build()
    x, y = model.reference.T
    v0 = np.column_stack([1.0 - 8.0 * y, 8.0 * x]).ravel()
    run = pi.solve(model, 0.5, pi.EnergyMomentum(h=5e-3), v0=v0)
    momentum = (model.mass() @ run.v.T).T.reshape(len(run), -1, 2)
    place = model.reference + run.q.reshape(momentum.shape)
    angular = (place[..., 0] * momentum[..., 1] - place[..., 1] * momentum[..., 0]).sum(axis=1)
    assert np.ptp(momentum.sum(axis=1), axis=0).max() < 1e-10 * np.abs(momentum.sum(axis=1)).max()
    assert np.ptp(angular) < 1e-8 * abs(angular[0])
    assert np.ptp(run.energy.total) < ENERGY * run.energy.total[0]


def test_every_joint_holds_and_agrees(scenes, kind):
    model = scenes.jointed(kind).build()
    run, other = (pi.solve(model, 0.1, integrator) for integrator in (pi.EnergyMomentum(h=5e-4), pi.GeneralizedAlpha(h=5e-4)))
    assert run.success, run.message
    assert run.drift.max() < 1e-12
    assert np.abs(run.q[-1] - other.q[-1]).max() < 3e-5
    assert np.abs(unbalanced(run)).max() < 1e-4 * np.abs(run.energy.potential).max()


def test_second_order(scenes):
    """On a load that grows smoothly."""
    scene, upper = scenes.cantilever()
    scene.add(pi.PointLoad(upper.section("right"), (0.0, -1.0), pi.profile.ramp(0.0, 1.0, 0.25), name="tip"))
    model = scene.build()
    steps = np.array([8e-3, 4e-3, 2e-3])
    exact = pi.solve(model, 0.25, pi.EnergyMomentum(h=2.5e-4))
    runs = [pi.solve(model, 0.25, pi.EnergyMomentum(h=h)) for h in steps]
    for name in ("q", "v"):
        errors = [np.abs(getattr(run, name)[-1] - getattr(exact, name)[-1]).max() for run in runs]
        assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("damping", [{"viscosity": 1e-3}, {"mass_damping": 5.0}])
def test_damping_only_takes_energy(scenes, damping):
    scene, _ = scenes.cantilever((0.0, -9.81), material=damping)
    run = pi.solve(scene.build(), 0.3, pi.EnergyMomentum(h=2e-3))
    energy = run.energy.total
    assert np.all(np.diff(energy) <= 1e-9 * np.ptp(energy)) and energy[-1] < energy[0]


def test_a_model_that_is_no_scene_is_refused():
    with pytest.raises(pi.InputError, match="no scene"):
        pi.solve(pi.problems.get("pendulum").model, 0.1, pi.EnergyMomentum(h=1e-3), q0=[-1.0, 0.0])


@pytest.mark.parametrize("setting", [{"h": 0.0}, {"h": True}, {"tolerance": 2.0}, {"max_iterations": 0}])
def test_bad_settings(setting):
    with pytest.raises(pi.InputError, match=next(iter(setting))):
        pi.EnergyMomentum(**({"h": 1e-3} | setting))
