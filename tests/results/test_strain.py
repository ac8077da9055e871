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


def test_of_a_run(run, file):
    found = run.strain(-1)
    assert found.shape == run.stress(-1).shape and np.array_equal(found, pi.load(file).strain(-1)) and found.any()
    with pytest.raises(pi.InputError, match="frame = 99"):
        run.strain(99)
