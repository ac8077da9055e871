"""Damped plates and virtual elements in a scene: derivatives, what damping must and must not do."""

import numpy as np
import pytest

import polyida as pi

DAMPINGS = [{"viscosity": 1e-3}, {"mass_damping": 2.0}, {"viscosity": 1e-4, "mass_damping": 0.5}]


@pytest.mark.parametrize("element", ["wachspress", "virtual"])
@pytest.mark.parametrize("damping", [{}, *DAMPINGS])
def test_derivatives(scenes, element, damping):
    scene, upper = scenes.hinged(material=damping, element=element)
    model, random = scene.build(), np.random.default_rng(3)
    q, v = 1e-3 * random.standard_normal(model.n), random.standard_normal(model.n)
    assert max(pi.check_derivatives(model, q=q, v=v).values()) < 1e-8
    assert model.needs.velocity_forces == bool(damping) and model.flexible


def test_viscosity_does_not_brake_a_rigid_spin(scenes):
    model = scenes.single((0.0, 0.0), material={"viscosity": 1e-2})[0].build()
    angle, spin = 0.7, 3.0
    turned = model.reference @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    v = spin * np.column_stack([-turned[:, 1], turned[:, 0]])
    force = model.force(0.0, (turned - model.reference).ravel(), v.ravel())
    assert np.abs(force).max() < 1e-9 * 50e6 * 0.01 * 0.1


@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize(
    "integrator", [pi.GeneralizedAlpha(h=5e-4), pi.IDA(rtol=1e-7, atol=1e-9), pi.EnergyMomentum(h=5e-4), pi.RadauIIA(rtol=1e-7)]
)
def test_integrators_agree_on_a_damped_cantilever(scenes, damping, integrator):
    scene, upper = scenes.cantilever(material=damping)
    scene.add(pi.PointLoad(upper.section("right"), (0.0, -1.0), pi.profile.ramp(0.0, 1.0, 0.1), name="tip"))
    model = scene.build()
    run, fine = pi.solve(model, 0.2, integrator), pi.solve(model, 0.2, pi.GeneralizedAlpha(h=1e-4))
    assert run.success, run.message
    assert np.abs(run.q[-1] - fine.q[-1]).max() < 1e-4 * np.abs(fine.q[-1]).max() + 1e-7


@pytest.mark.parametrize("damping", DAMPINGS)
@pytest.mark.parametrize("form", ["ggl2", "ggl1"])
def test_ida_s_compiled_callbacks_take_the_steps_of_the_general_ones(scenes, damping, form):
    """Motors and a mass at a point, both plates damped: the same equations, and about as many Newton iterations."""
    model = scenes.jointed("motor between", material=damping).build()
    fast, plain = (pi.solve(model, 0.05, pi.IDA(rtol=1e-6, form=form, linear=linear)) for linear in ("auto", "kkt"))
    assert fast.counts.backend == "multifrontal L D L^T" and not plain.counts.backend
    assert fast.counts.steps == pytest.approx(plain.counts.steps, rel=0.05)
    assert fast.counts.newton_iterations <= 1.1 * plain.counts.newton_iterations
    assert np.abs(fast.q[-1] - plain.q[-1]).max() < 1e-6 and np.abs(fast.lam[-1] - plain.lam[-1]).max() < 1e-2


def test_mass_damping_brakes_a_free_plate_as_it_should(scenes):
    """A free plate with a velocity: v' = -c v."""
    model = scenes.single((0.0, 0.0), material={"mass_damping": 3.0})[0].build()
    run = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=1e-3), v0=np.tile([1.0, 0.0], model.n_nodes))
    assert np.allclose(run.v[-1].reshape(-1, 2), [np.exp(-1.5), 0.0], atol=1e-6)


def test_virtual_elements_take_hanging_nodes(scenes):
    """Two squares beside one of twice the size: five corners, one of them straight."""
    points = [[0, 0], [2, 0], [3, 0], [3, 1], [3, 2], [2, 2], [0, 2], [2, 1]]
    mesh = pi.mesh.PolygonMesh(np.array(points, float) / 10, [0, 1, 7, 5, 6, 1, 2, 3, 7, 7, 3, 4, 5], [0, 5, 9, 13], {})
    with pytest.raises(pi.InputError, match="convex"):
        scenes.plate("hanging", mesh=mesh)
    scene = pi.Scene((0.0, -9.81))
    plate = scene.add(scenes.plate("hanging", mesh=mesh, element="virtual"))
    scene.add(pi.Revolute(pi.ground, plate.section(lambda x: np.isclose(x[:, 0], 0.0))))
    run = pi.solve(scene.build(), 0.2, pi.GeneralizedAlpha(h=1e-3))
    assert run.success and abs(run.energy.total[-1] - run.energy.total[0]) < 1e-3 * np.ptp(run.energy.kinetic)


@pytest.mark.parametrize("name, value", [("viscosity", -1.0), ("mass_damping", np.nan)])
def test_bad_damping(name, value):
    with pytest.raises(pi.InputError, match=name):
        pi.Material(1.0, 0.3, 1.0, **{name: value})


def test_whole_numbers_do_for_the_tangent_s_factors(scenes):
    model = scenes.hinged(material=dict(viscosity=1e-3, mass_damping=0.5))[0].build()
    q, v, a, lam = np.zeros(model.n), np.ones(model.n), np.zeros(model.n), np.zeros(model.m)
    whole, real = (model.tangent(0.0, q, v, a, lam, *factors) for factors in ((1, 2, 3), (1.0, 2.0, 3.0)))
    assert abs(whole - real).max() == 0.0
