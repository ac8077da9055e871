"""A scene's step matrix: its solves against those of the tangent, at the state of the factor and turned from there."""

import numpy as np
import pytest

from polyida.assembly.step_matrix import SceneStepMatrix

C_M, C_V = 4e6, 2e3


@pytest.fixture
def bent(scenes, kind):
    """(model, a state with every joint at work)."""
    model, random = scenes.jointed(kind).build(), np.random.default_rng(2)
    return model, (0.1, 1e-3 * random.standard_normal(model.n), np.zeros(model.n), np.zeros(model.n), random.standard_normal(model.m))


@pytest.mark.parametrize("backend", ["fronts", "band", "superlu"])
def test_a_solve_is_that_of_the_tangent(bent, backend):
    """To single precision, which the factor is in."""
    model, state = bent
    system, b = SceneStepMatrix(model, backend), np.random.default_rng(3).standard_normal((model.n, 2))
    system.factor(*state, C_M, C_V)
    exact = np.linalg.solve(model.tangent(*state, C_M, C_V, 1.0).toarray(), b)
    assert np.abs(system.solve(state[1], b) - exact).max() < 1e-4 * np.abs(exact).max()
    assert np.array_equal(system.solve(state[1], b[:, 0], transposed=True), system.solve(state[1], b)[:, 0])


def test_the_saddle_is_that_of_the_tangent(bent):
    model, (t, q, v, a, lam) = bent
    system, r = SceneStepMatrix(model), np.random.default_rng(3).standard_normal(model.n)
    phi, B = np.linspace(1.0, 2.0, model.m), model.phi_q(t, q).toarray()
    system.factor(t, q, v, a, lam, C_M, C_V)
    S = model.tangent(t, q, v, a, lam, C_M, C_V, 1.0).toarray()
    exact = -np.linalg.solve(np.block([[S, B.T], [B, np.zeros((model.m, model.m))]]), np.concatenate([r, phi]))
    dq, dlam = system.saddle(t, q, lam, r, phi)
    assert np.abs(dq - exact[: model.n]).max() < 1e-4 * np.abs(exact[: model.n]).max()
    assert np.abs(dlam - exact[model.n :]).max() < 1e-4 * np.abs(exact[model.n :]).max()
    assert np.allclose(B @ dq, -phi, rtol=1e-10)
