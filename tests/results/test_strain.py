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


@pytest.mark.filterwarnings("ignore::polyida.errors.ReductionWarning")  # so few modes of rubber leave much out
def test_of_few_coordinates(scenes):
    """A rigid plate has none; a reduced one that of its fields, and the stress goes with it."""
    scene = pi.Scene((0.0, -9.81))
    plates = [pi.Rigid(scenes.plate("rigid")), pi.Reduced(scenes.plate("reduced"), modes=5)]
    for body in map(scene.add, plates):
        scene.add(pi.Clamp(pi.ground, body.section("left")))
    model = scene.build()
    run = pi.solve(model, 1e-3, pi.GeneralizedAlpha(h=1e-3), state=pi.static(model))
    rigid, reduced = np.split(run.strain(-1), 2)
    (x, y, shear), modulus = reduced.T, 50e6 / (1 - 0.3**2)
    hooke = np.stack([x + 0.3 * y, y + 0.3 * x, 0.35 * shear], axis=1) * modulus
    assert np.abs(rigid).max() < 1e-14 and np.abs(reduced).max() > 1e-5
    assert np.allclose(run.stress(-1)[20:], hooke, atol=2e-2 * np.abs(hooke).max())


def test_of_a_run(run, file):
    found = run.strain(-1)
    assert found.shape == run.stress(-1).shape and np.array_equal(found, pi.load(file).strain(-1)) and found.any()
    with pytest.raises(pi.InputError, match="frame = 99"):
        run.strain(99)
