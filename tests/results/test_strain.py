"""Green's strain of elements: nothing in a rigid turn, (F^T F - I)/2 where F is the same everywhere, that of the energy anywhere."""

import numpy as np
import pytest

import polyida as pi
from polyida.results.motion import strains

F = np.array([[1.2, 0.3], [-0.1, 0.9]])


@pytest.fixture(params=["wachspress", "virtual"])
def model(request, scenes):
    scene, upper, lower = scenes.pair(bend=0.6, element=request.param)
    scene.add(pi.Revolute(upper.section("right"), lower.section("left")))
    return scene.build()


def test_of_a_homogeneous_deformation(model):
    q = (model.reference @ (F - np.eye(2)).T + [3.0, -1.0]).ravel()
    E = 0.5 * (F.T @ F - np.eye(2))
    assert np.allclose(strains(model, q), [E[0, 0], E[1, 1], 2 * E[0, 1]], rtol=1e-12)


def test_of_a_finite_rotation(model, scenes):
    assert np.abs(strains(model, scenes.turned(model, np.zeros(model.n), 2.5, (4.0, 1.0)))).max() < 1e-14


def test_with_the_stress_of_a_small_one_it_makes_hooke_s_law(model):
    q = 1e-7 * np.sin(3.0 * model.reference[:, ::-1]).ravel()
    (x, y, shear), modulus = strains(model, q).T, 50e6 / (1 - 0.3**2)
    hooke = np.stack([x + 0.3 * y, y + 0.3 * x, 0.35 * shear], axis=1) * modulus
    assert np.allclose(model.stress(q), hooke, atol=1e-5 * np.abs(hooke).max())


@pytest.mark.parametrize("element", ["wachspress", "virtual"])
def test_viscous_stress_of_a_homogeneous_rate(element):
    """Cauchy's stress F S F^T / det F of `S = D : (E + viscosity E')`."""
    mesh, viscosity, rate = pi.mesh.rectangle(1.0, 0.1, cells=12, seed=1), 0.03, np.array([[0.3, 2.0], [-1.0, 0.4]])
    scene = pi.Scene()
    scene.add(pi.Plate(mesh, pi.Material(50e6, 0.3, 1100.0, viscosity=viscosity), 0.01, element=element))
    stress = scene.build().stress((mesh.points @ (F - np.eye(2)).T).ravel(), (mesh.points @ rate.T).ravel())
    E = 0.5 * (F.T @ F - np.eye(2)) + viscosity * 0.5 * (rate.T @ F + F.T @ rate)
    S = 50e6 / (1 - 0.3**2) * (0.7 * E + 0.3 * np.trace(E) * np.eye(2))
    cauchy = F @ S @ F.T / np.linalg.det(F)
    assert np.allclose(stress, [cauchy[0, 0], cauchy[1, 1], cauchy[0, 1]], rtol=1e-11)


def test_a_rigid_plate_has_no_stress():
    """Its length may drift within the tolerance of a run."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = scene.add(pi.Rigid(pi.Plate(pi.mesh.quads(1.0, 0.1, 4, 1), pi.Material(2e11, 0.3, 7800.0), 0.01)))
    scene.add(pi.Revolute(pi.ground, plate.section("left")))
    run = pi.solve(scene.build(), 0.1, pi.IDA(rtol=1e-4))
    assert run.drift.max() > 0.0 and not run.stress(-1).any()


def test_of_a_run(run, file):
    found = run.strain(-1)
    assert found.shape == run.stress(-1).shape and np.array_equal(found, pi.load(file).strain(-1)) and found.any()
    with pytest.raises(pi.InputError, match="frame = 99"):
        run.strain(99)
