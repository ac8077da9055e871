"""Condition number of the iteration matrix: slopes in h for each scaling and choice of unknowns; exact and
estimated.
"""

import numpy as np
import pytest

import polyida as pi
from polyida.linear.condition import condition_number, iteration_matrix
from polyida.problems import plates

SMALL = 10.0 ** -np.arange(5.0, 10.0)


@pytest.fixture(scope="module")
def scene():
    model = plates.double_plate_motors(cells=12).build()
    return model, pi.consistent_state(model)


def at(scene, steps, *choice, **more):
    return np.array([condition_number(scene[0], pi.GeneralizedAlpha(h=h), scene[1], *choice, **more) for h in steps])


@pytest.mark.parametrize("unknown, slope", [("q", -4.0), ("v", -3.0), ("a", -2.0)])
@pytest.mark.parametrize("exact", [True, False])
def test_slopes_without_scaling(scenes, scene, unknown, slope, exact):
    found = at(scene, SMALL, "none", unknown, exact=exact)
    assert scenes.slope(SMALL, found) == pytest.approx(slope, abs=0.1)


@pytest.mark.parametrize("scaling", ["bottasso", "physical"])
def test_flat_with_scaling(scenes, scene, scaling):
    found = at(scene, SMALL, scaling)
    assert scenes.slope(SMALL, found) == pytest.approx(0.0, abs=0.05) and found.max() < 1e5
    assert (at(scene, 10.0 ** -np.arange(3.0, 10.0), "physical") < 1e4).all()


def test_masses_far_from_1_kg_need_the_physical_scaling(scene):
    """Nodes of some grams: beta h^2 alone leaves them beside constraints of size 1."""
    assert (at(scene, SMALL, "physical") < 0.1 * at(scene, SMALL, "bottasso")).all()


def test_the_integrator_s_scaling_is_the_default(scene):
    model, state = scene
    alpha = pi.GeneralizedAlpha(h=1e-3, scaling="bottasso")
    assert condition_number(model, alpha, state) == condition_number(model, alpha, state, "bottasso")


def test_exact_is_the_ratio_of_singular_values(scene):
    model, state = scene
    matrix = iteration_matrix(model, pi.GeneralizedAlpha(h=1e-3), state, "physical")
    assert matrix.shape == (model.n + model.m, model.n + model.m)
    values = np.linalg.svd(matrix.toarray(), compute_uv=False)
    assert condition_number(model, pi.GeneralizedAlpha(h=1e-3), state) == pytest.approx(
        values[0] / values[-1], rel=1e-6
    )


def test_the_estimate_is_that_of_the_1_norm(scene):
    model, state = scene
    matrix = iteration_matrix(model, pi.GeneralizedAlpha(h=1e-3), state, "physical").toarray()
    estimate = condition_number(model, pi.GeneralizedAlpha(h=1e-3), state, exact=False)
    assert 0.1 * np.linalg.cond(matrix, 1) < estimate < 1.001 * np.linalg.cond(matrix, 1)


@pytest.mark.parametrize("exact", [True, False])
def test_a_user_s_model_and_a_singular_matrix(exact):
    model = pi.problems.get("pendulum").model
    state = pi.consistent_state(model, 0.0, [-1.0, 0.0])
    assert 1 < condition_number(model, pi.GeneralizedAlpha(h=1e-3), state, exact=exact) < 1e4
    twice = type(
        "Twice",
        (type(model),),
        {"m": 2, "phi_q": lambda self, t, q: np.tile(2 * q, (2, 1)), "phi": lambda self, t, q: np.full(2, q @ q - 1)},
    )
    bad = twice()
    state = type(state)(0.0, state.q, state.v, state.a, np.zeros(2))
    assert condition_number(bad, pi.GeneralizedAlpha(h=1e-3), state, exact=exact) > 1e14


def test_unknown_names(scene):
    for choice in (("best",), ("none", "p")):
        with pytest.raises(pi.InputError, match=choice[-1]):
            condition_number(scene[0], pi.GeneralizedAlpha(h=1e-3), scene[1], *choice)
