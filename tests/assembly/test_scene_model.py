"""The model of a scene: fused kernels against the parts of the default model, needs, names."""

import numpy as np
import pytest

import polyida as pi
from polyida.model import Model


@pytest.fixture
def state(scenes, kind):
    """(model, t, q, v, a, lam) at random."""
    model, random = scenes.jointed(kind, pi.profile.sine(0.5, 1.0, 0.1)).build(), np.random.default_rng(5)
    return model, 0.2, *(0.1 * random.standard_normal(model.n) for _ in range(3)), random.standard_normal(model.m)


def test_residual_is_the_sum_of_its_parts(state):
    model, t, q, v, a, lam = state
    parts = Model.residual(model, t, q, v, a, lam)
    assert np.allclose(model.residual(t, q, v, a, lam), parts, atol=1e-12 * np.abs(parts).max())


def test_tangent_is_the_sum_of_its_parts(state):
    model, t, q, v, a, lam = state
    parts = Model.tangent(model, t, q, v, a, lam, 7e5, 3.0, 2.0)
    assert abs(model.tangent(t, q, v, a, lam, 7e5, 3.0, 2.0) - parts).max() < 1e-12 * abs(parts).max()


def test_a_tangent_of_complex_coefficients_is_the_sum_of_its_parts():
    scene = pi.Scene(gravity=(0.0, -9.81))
    damped = pi.Material(E=5e6, nu=0.3, rho=1100.0, viscosity=1e4)
    scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=20, seed=1), damped, thickness=0.01))
    model = scene.build()
    t, q, v, a, lam = 0.2, *(0.01 * np.random.default_rng(5).standard_normal((3, model.n))), np.zeros(model.m)
    parts = (7e5 + 4e5j) * model.mass(q) + (3.0 + 2.0j) * model.force_v(t, q, v) + model.force_q(t, q, v)
    assert abs(model.tangent(t, q, v, a, lam, 7e5 + 4e5j, 3.0 + 2.0j, 1.0) - parts).max() < 1e-12 * abs(parts).max()


def test_the_mass_system_is_that_of_the_whole_matrix(state):
    model, t, q, v, a, lam = state
    dq, dlam = model.mass_system(t, q).solve(a, lam)
    whole = Model.mass_system(model, t, q).solve(a, lam)
    assert np.abs(dq - whole[0]).max() < 1e-9 * np.abs(dq).max() and np.abs(dlam - whole[1]).max() < 1e-9 * np.abs(dlam).max()
