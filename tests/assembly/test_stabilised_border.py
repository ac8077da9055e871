"""The border by constraints and their rates: against the whole matrix with lam and mu, for real and complex step matrices."""

import numpy as np
import pytest

from polyida.assembly import corotated
from polyida.assembly.corotated import SceneStepMatrix
from polyida.assembly.stabilised_border import mass_columns, stabilised_border, stabilised_workspace
from polyida.jit import entry

DAMPED = {"viscosity": 1e-3, "mass_damping": 300.0}


@entry
def bordered(s, c, cm, cr, w, drives, rotation, dz, vz, lam, c_v, anew, r2, r3, r4, dq, dlam, dmu):
    corotated.solve_plates(s, c, cr, rotation, r2, dq)
    return stabilised_border(s, c, cm, cr, w, drives, dz, vz, lam, c_v, anew, dq, r3, r4, dlam, dmu)


def rates_q(model, t, q, v):
    """H = d(B v + phi_t)/dq, (m, n): the rate is of second degree in q, its central differences are exact."""
    step = 1e-2 * np.eye(model.n)
    return np.stack([(model.phi_rate(t, q + e, v) - model.phi_rate(t, q - e, v)) / 2e-2 for e in step], axis=1)


@pytest.mark.parametrize("c", [2e3, 2e3 * (0.66 + 0.75j)], ids=["real", "complex"])
@pytest.mark.parametrize("damped", [True, False], ids=["damped", "undamped"])
@pytest.mark.parametrize("kind", ["motor between", "motor to ground", "clamp between", "revolute"], indirect=True)
def test_the_border_is_that_of_the_whole_matrix(scenes, kind, damped, c):
    """With motors, a mass at a point and damping; the rows hold to round-off although the factor is in single precision.

    The same if the border is that of another right-hand side.
    """
    model, random = scenes.jointed(kind, material=DAMPED if damped else {}).build(), np.random.default_rng(2)
    n, m, t, zero, dtype = model.n, model.m, 0.1, np.zeros(model.n), type(c)
    q, v, lam = 1e-3 * random.standard_normal(n), random.standard_normal(n), random.standard_normal(m)
    r2, r3, r4 = (x * random.standard_normal(k) * dtype(c / abs(c)) for k, x in ((n, 1.0), (m, 1e-6), (m, 1e-3)))
    M, B, H = model.mass(q).toarray(), model.phi_q(t, q).toarray(), rates_q(model, t, q, v)
    C = model.force_v(t, q, zero).toarray() if damped else np.zeros((n, n))
    S, none = model.tangent(t, q, zero, zero, lam, 0.0, 0.0, 1.0).toarray() + c * C + c * c * M, np.zeros((m, m))
    matrix = np.block([[S, B.T, (c * M + C) @ B.T], [B, none, none], [H + c * B, none, B @ B.T]])
    exact = np.split(np.linalg.solve(matrix, np.concatenate([r2, r3, r4])), [n, n + m])

    step = SceneStepMatrix(model)
    step.factor(t, q, zero, zero, lam, c * c, c)
    more = mass_columns(model, step.corotated, C / c if damped else None)
    found = np.empty((n // 2, 2), dtype), np.empty(m, dtype), np.empty(m, dtype)
    where = model.arrays.links, step.corotated, more, step.workspace, stabilised_workspace(model, dtype), model.drives(t), model.rotation(q)
    sides = r2.reshape(-1, 2), r3, r4
    others = [x[::-1].copy() for x in sides]
    for anew in (True, False):
        if not anew:
            assert bordered(*where, model.dz(q), model.dz(v), lam, c, True, *others, *found)
        assert bordered(*where, model.dz(q), model.dz(v), lam, c, anew, *sides, *found)
        dq, dlam, dmu = found[0].ravel(), *found[1:]
        for one, other in zip((dq, dlam, dmu), exact):
            assert np.abs(one - other).max() < 2e-4 * np.abs(other).max()
        assert np.abs(B @ dq - r3).max() < 1e-11 * np.abs(dq).max()
        rate = (H + c * B) @ dq + B @ (B.T @ dmu) - r4
        assert np.abs(rate).max() < 1e-11 * abs(c) * np.abs(dq).max()
