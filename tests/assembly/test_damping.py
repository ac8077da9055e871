"""Damped plates and virtual elements in a scene: derivatives, what damping must and must not do."""

import numpy as np
import pytest

import polyida as pi

DAMPINGS = [{"viscosity": 1e-3}, {"mass_damping": 2.0}, {"viscosity": 1e-4, "mass_damping": 0.5}]


def test_viscosity_does_not_brake_a_rigid_spin(scenes):
    model = scenes.single((0.0, 0.0), material={"viscosity": 1e-2})[0].build()
    angle, spin = 0.7, 3.0
    turned = model.reference @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    v = spin * np.column_stack([-turned[:, 1], turned[:, 0]])
    force = model.force(0.0, (turned - model.reference).ravel(), v.ravel())
    assert np.abs(force).max() < 1e-9 * 50e6 * 0.01 * 0.1


@pytest.mark.parametrize("damping", DAMPINGS)
def test_integrators_agree_on_a_damped_cantilever(scenes, damping):
    scene, upper = scenes.cantilever(material=damping)
    scene.add(pi.PointLoad(upper.section("right"), (0.0, -1.0), pi.profile.ramp(0.0, 1.0, 0.1), name="tip"))
    model = scene.build()
    fine = pi.solve(model, 0.2, pi.GeneralizedAlpha(h=1e-4))
    for integrator in (pi.GeneralizedAlpha(h=5e-4), pi.IDA(rtol=1e-7, atol=1e-9), pi.EnergyMomentum(h=5e-4), pi.RadauIIA(rtol=1e-7)):
        run = pi.solve(model, 0.2, integrator)
        assert run.success, run.message
        assert np.abs(run.q[-1] - fine.q[-1]).max() < 1e-4 * np.abs(fine.q[-1]).max() + 1e-7


def test_mass_damping_brakes_a_free_plate_as_it_should(scenes):
    """A free plate with a velocity: v' = -c v."""
    model = scenes.single((0.0, 0.0), material={"mass_damping": 3.0})[0].build()
    run = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=1e-3), v0=np.tile([1.0, 0.0], model.n_nodes))
    assert np.allclose(run.v[-1].reshape(-1, 2), [np.exp(-1.5), 0.0], atol=1e-6)
