"""The saddle-point system: scalings, condition numbers, what is singular and what is redundant."""

import numpy as np
import pytest
from scipy.sparse import csc_array

import polyida as pi
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT, SCALINGS, assemble, require_independent, scaling_size


def system(h=1e-3, stiffness=1e5, n=8, m=3, seed=0):
    """(S, B, beta h^2) of a chain of masses and springs on random constraints, rho_inf = 0.9."""
    random = np.random.default_rng(seed)
    c = pi.GeneralizedAlpha(h=h).coefficients
    springs = stiffness * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    S = (1 - c.alpha_m) / (c.beta * h * h * (1 - c.alpha_f)) * np.eye(n) + springs
    return S, random.standard_normal((m, n)), c.beta * h * h


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("sparse", [False, True])
def test_solves_the_system_in_every_scaling(scaling, sparse):
    S, B, step = system()
    r, phi = np.random.default_rng(1).standard_normal(8), np.random.default_rng(2).standard_normal(3)
    S_given, B_given = (csc_array(S), csc_array(B)) if sparse else (S, B)
    dq, dlam = KKT(S_given, B_given, scaling_size(scaling, step, S_given)).solve(r, phi)
    assert np.allclose(S @ dq + B.T @ dlam, -r, atol=1e-9) and np.allclose(B @ dq, -phi, atol=1e-9)


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("sparse", [False, True])
def test_solves_the_adjoint_of_the_same_factor(scaling, sparse):
    S, B, step = system()
    S = S + 0.1 * np.triu(S)
    r, phi = np.random.default_rng(1).standard_normal(8), np.random.default_rng(2).standard_normal(3)
    S_given, B_given = (csc_array(S), csc_array(B)) if sparse else (S, B)
    w, mu = KKT(S_given, B_given, scaling_size(scaling, step, S_given)).solve(r, phi, transposed=True)
    assert np.allclose(S.T @ w + B.T @ mu, -r, atol=1e-9) and np.allclose(B @ w, -phi, atol=1e-9)


def condition(scaling, h, stiffness):
    S, B, step = system(h, stiffness)
    return np.linalg.cond(assemble(S, B, scaling_size(scaling, step, S)))


@pytest.mark.parametrize("matrix", [np.zeros((2, 2)), np.diag([1.0, 0.0]), np.diag([1.0, np.nan])])
@pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore::scipy.linalg.LinAlgWarning")
def test_singular(matrix):
    for given in (matrix, csc_array(matrix)):
        with pytest.raises(SingularSystem):
            KKT(given, np.zeros((0, 2)) if given is matrix else csc_array((0, 2)))


def test_dependent_rows_are_named():
    class Named(pi.Model):
        n, m = 3, 4

        def constraint_name(self, row):
            return "abcd"[row]

        def mass(self, q):
            return np.eye(3)

    names = Named()
    require_independent(names, np.eye(3)[:2], np.zeros(3))
    with pytest.raises(pi.InputError, match=r"b, d are redundant"):
        require_independent(names, np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0, -2.0, 0]]), np.zeros(3))
    with pytest.raises(pi.InputError, match=r"constraints c: .*zeros"):
        require_independent(names, np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 0]]), np.zeros(3))
