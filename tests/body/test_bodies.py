"""Plates, masses and loads: what they weigh, how they push, and that motions of a rigid body cost nothing."""

import numpy as np
import pytest

import polyida as pi


def zeros(model):
    """No acceleration, no multipliers."""
    return np.zeros(model.n), np.zeros(model.m)


@pytest.fixture(params=["rectangle", "quads", "triangles", "link"])
def free(scenes, request):
    """A plate without joints or gravity, on each kind of mesh, turned in its place."""
    meshes = {
        "rectangle": lambda: scenes.mesh(),
        "quads": lambda: pi.mesh.quads(1.0, 0.1, 10, 2),
        "triangles": lambda: pi.mesh.triangles(1.0, 0.1, 8, 2),
        "link": lambda: pi.mesh.polygonize(pi.mesh.Link(1.0, 0.2, 0.05), cells=100, seed=2),
    }
    scene, _ = scenes.single((0.0, 0.0), mesh=meshes[request.param](), angle=0.3, origin=(0.5, -2.0))
    return scene.build()


def test_a_turned_state_has_turned_forces(free, scenes):
    q, angle = 5e-3 * np.random.default_rng(0).standard_normal(free.n), 1.1
    turn = scenes.rotation(angle)
    before, after = free.force(0.0, q, q), free.force(0.0, scenes.turned(free, q, angle), q)
    assert np.allclose(after.reshape(-1, 2), before.reshape(-1, 2) @ turn.T, atol=1e-10 * np.abs(before).max())
    again = scenes.turned(free, q, angle)
    assert free.strain_energy(again) == pytest.approx(free.strain_energy(q), rel=1e-10)
    assert np.allclose(pi.von_mises(free.stress(again)), pi.von_mises(free.stress(q)), rtol=1e-9)


def test_mass_and_weight(scenes):
    scene = scenes.jointed("revolute", mass=0.7)
    model = scene.build()
    total, ones = 2 * scenes.PLATE_MASS + 0.7, np.tile([1.0, 0.0], model.n_nodes)
    assert ones @ (model.mass() @ ones) == pytest.approx(total, rel=1e-12)
    weight = -model.force(0.0, np.zeros(model.n), np.zeros(model.n)).reshape(-1, 2).sum(axis=0)
    assert np.allclose(weight, [0.0, -9.81 * total], rtol=1e-12, atol=1e-9)
    assert abs(model.mass() - model.mass().T).max() < 1e-15


def test_moment_of_inertia(scenes):
    model = scenes.single()[0].build()
    spin = np.column_stack([-model.reference[:, 1], model.reference[:, 0]]).ravel()
    exact = scenes.PLATE_MASS * (1.0 / 3.0 + 0.1**2 / 12.0)
    assert spin @ (model.mass() @ spin) == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize(
    "load, total",
    [
        (lambda p, f: pi.PointLoad(p.section("right"), (3.0, -2.0), f), (3.0, -2.0)),
        (lambda p, f: pi.PointLoad(p.node((1.0, 0.05)), (3.0, -2.0), f), (3.0, -2.0)),
        (lambda p, f: pi.EdgeTraction(p.section("top"), (0.0, 500.0), f), (0.0, 500.0 * 1.0 * 0.01)),
        (lambda p, f: pi.EdgeTraction(p.section("right"), (100.0, 0.0), f), (100.0 * 0.1 * 0.01, 0.0)),
    ],
)
def test_loads_follow_their_profile(scenes, load, total):
    scene, upper = scenes.single((0.0, 0.0))
    scene.add(load(upper, pi.profile.polynomial([1.0, 2.0])))
    model = scene.build()
    a, lam = zeros(model)
    for t in (0.0, 0.75):
        pushed = -model.residual(t, a, a, a, lam).reshape(-1, 2).sum(axis=0)
        assert np.allclose(pushed, (1 + 2 * t) * np.array(total), atol=1e-12)


def test_uniform_stretch_has_the_cauchy_stress_of_the_formula(free, scenes):
    stretch = 1.1
    q = (free.reference * [stretch - 1, 0.0]).ravel()
    E, nu = scenes.RUBBER["E"], scenes.RUBBER["nu"]
    strain = (stretch**2 - 1) / 2
    S = E / (1 - nu**2) * np.array([strain, nu * strain])
    assert np.allclose(free.stress(q), [stretch * S[0], S[1] / stretch, 0.0], rtol=1e-9, atol=1e-6 * E)


def test_von_mises():
    assert np.allclose(pi.von_mises([[3.0, 0.0, 0.0], [0.0, 0.0, 2.0], [1.0, 1.0, 0.0]]), [3.0, 2 * np.sqrt(3.0), 1.0])
    assert pi.von_mises([2.0, 2.0, 0.0], 2.0) == 0.0, "pressure alone"


def test_von_mises_of_a_run_knows_the_plane_of_each_plate(scenes):
    """Both plates stretched by a small strain e along x, held along y: sxx = C11 e, syy = C12 e in either plane's Hooke."""
    scene, upper = scenes.single((0.0, 0.0), material={"nu": 0.4})
    scene.add(scenes.plate("lower", material={"nu": 0.4, "plane": "strain"}))
    model, e, nu, modulus = scene.build(), 1e-7, 0.4, scenes.RUBBER["E"]
    q = (model.reference * [e, 0.0]).ravel()
    run = pi.Trajectory(model, None, np.zeros(1), q[None], 0 * q[None], 0 * q[None], np.zeros((1, model.m)))
    found = np.split(run.von_mises(0), [upper.mesh.n_cells])
    thin = modulus * e / (1 - nu**2) * np.sqrt(1 - nu + nu**2)
    assert found[0] == pytest.approx(thin, rel=1e-5)
    assert found[1] == pytest.approx(modulus * e / (1 + nu), rel=1e-5), "2 mu e: syy = szz, their difference to sxx is all"
