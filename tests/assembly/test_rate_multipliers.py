"""Corrections with lam and mu: against the whole matrix, for real and complex step matrices."""

import numpy as np
import pytest

from polyida.assembly import corotated
from polyida.assembly.rate_multipliers import add_rate_forces, factor_rates, rate_multipliers, rate_values, slowing, solve_rates
from polyida.assembly.scene_step_matrix import SceneStepMatrix
from polyida.jit import entry

DAMPED = {"viscosity": 1e-3, "mass_damping": 300.0}
KINDS = ["motor between", "motor to ground", "clamp between", "revolute"]


@entry
def corrections(s, c, cr, x, slow, drives, rotation, dz, lam, c_v, r2, r3, right, dq, dlam, dmu):
    if not (factor_rates(s, x, drives, dz) and solve_rates(x, right, dmu)):
        return False
    corotated.turn_frames(s, c, cr, rotation)
    add_rate_forces(s, x, slow, cr, c_v, dmu, r2)
    return corotated.solve(s, c, cr, drives, rotation, dz, lam, r2, r3, c_v * c_v, dq, dlam)


@entry
def values_of(s, c, cr, x, slow, rotation, c_v, dw, values):
    corotated.turn_frames(s, c, cr, rotation)
    rate_values(s, x, slow, cr, c_v, dw, values)


@pytest.fixture
def system(scenes, kind, damped, c):
    """(model, state, matrices K + c C + c^2 M, c M + C, B) of a scene with a mass at a point, and its factor."""
    model, random = scenes.jointed(kind, material=DAMPED if damped else {}).build(), np.random.default_rng(2)
    n, m, t, zero = model.n, model.m, 0.1, np.zeros(model.n)
    q, lam = 1e-3 * random.standard_normal(n), random.standard_normal(m)
    M, B = model.mass(q).toarray(), model.phi_q(t, q).toarray()
    C = model.force_v(t, q, zero).toarray() if damped else np.zeros((n, n))
    S = model.tangent(t, q, zero, zero, lam, 0.0, 0.0, 1.0).toarray() + c * C + c * c * M
    step = SceneStepMatrix(model)
    step.factor(t, q, zero, zero, lam, c * c, c)
    return model, random, (t, q, lam), (S, c * M + C, B), step


@pytest.mark.parametrize("c", [2e3, 2e3 * (0.66 + 0.75j)], ids=["real", "complex"])
@pytest.mark.parametrize("kind, damped", list(zip(KINDS, (True, False, True, False))), indirect=["kind"])
def test_the_corrections_are_those_of_the_whole_matrix(system, damped, c):
    """With motors, a mass at a point and damping; the rows hold to round-off although the factor is in single precision."""
    model, random, (t, q, lam), (S, D, B), step = system
    n, m, none = model.n, model.m, np.zeros((model.m, model.m))
    r, r3, r4 = (x * random.standard_normal(k) * type(c)(c / abs(c)) for k, x in ((n, 1.0), (m, 1e-6), (m, 1e-3)))
    matrix = np.block([[S, B.T, D @ B.T], [B, none, none], [c * B, none, B @ B.T]])
    exact = np.split(np.linalg.solve(matrix, -np.concatenate([r, r3, r4])), [n, n + m])
    found = np.empty((n // 2, 2), type(c)), np.empty(m, type(c)), np.empty(m, type(c))
    where = model.arrays.links, step.corotated, step.workspace, rate_multipliers(model), slowing(model, t, q), model.drives(t)
    state = model.rotation(q), model.dz(q), lam, c
    assert corrections(*where, *state, r.reshape(-1, 2).copy(), r3, c * r3 - r4, *found)
    dq, dlam, dmu = found[0].ravel(), *found[1:]
    for one, other in zip((dq, dlam, dmu), exact):
        assert np.abs(one - other).max() < 2e-4 * np.abs(other).max()
    assert np.abs(B @ dq + r3).max() < 1e-11 * np.abs(dq).max()
    assert np.abs(c * B @ dq + B @ (B.T @ dmu) + r4).max() < 1e-11 * abs(c) * np.abs(dq).max()
    # `w . (c M + C) B^T mu = mu . B (c M + C)^T w`, with the transposed matrix of numpy
    w, values = random.standard_normal(n).astype(type(c)), np.empty((model.n_points, 2), type(c))
    values_of(*where[:5], model.rotation(q), c, w.reshape(-1, 2), values)
    Bz, links = model.slope_values(t, q), model.arrays.links
    found = [Bz[e0:e1] @ values.ravel()[links.row_columns[e0:e1]] for e0, e1 in zip(links.row_start, links.row_start[1:])]
    assert np.allclose(found, B @ (D.T @ w), rtol=1e-10, atol=1e-10 * np.abs(B @ (D.T @ w)).max())
