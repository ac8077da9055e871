"""Condition numbers of the iteration matrices of generalized-alpha and IDA, exact, and what they do to linear solves.

An unscaled matrix reaches condition numbers of 1e35, far beyond what its own singular values tell in double precision.
Its inverse is therefore taken from the scaled matrix, which is harmless, `A^-1 = D_R (D_L A D_R)^-1 D_L`, and cond(A) =
|A| |A^-1| in the 2-norm.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from polyida.integrate.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida_forms import System
from polyida.integrate.solve import solve
from polyida.integrate.start import consistent_state, mass_system
from polyida.linear.condition import condition_number
from polyida.linear.kkt import SCALINGS, Scaling, assemble, scaling_factors
from polyida.model import Model, Needs
from polyida.problems import plates

ALPHA_UNKNOWNS = {"q": -4, "v": -3, "a": -2}  # beside lam: slope of the raw condition number in h
ALPHA_SCALINGS = {"none": -4, "rows only": -2, "multipliers only": -2, "bottasso": 0, "physical": 0}
IDA_SLOPES = {"index3": -3, "ggl2": -2, "index2": -2, "ggl1": -1, "index1": -1, "baumgarte": -1}


MODULI = {"soft": 5e7, "steel": 2e11, "stiffest": 1e12}  # Pa; 10 mm thick: up to 1e10 N/m


class Scaled(NamedTuple):
    """A raw matrix, (N, N), with the row and column factors, (N,), that make it harmless."""

    raw: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    @property
    def matrix(self):
        """The scaled matrix."""
        return self.rows[:, None] * self.raw * self.columns

    def condition(self):
        """cond(raw) in the 2-norm, right also far beyond 1e16."""
        inverse = self.columns[:, None] * np.linalg.inv(self.matrix) * self.rows
        return float(np.linalg.norm(self.raw, 2) * np.linalg.norm(inverse, 2))


class Springs(Model):
    """Two point masses of 1 kg on a rod each, the second hanging from the first; every coordinate on a spring of
    `stiffness`, N/m.

    A model whose stiffness has one size: what the physical scaling divides by is all there is.
    """

    n, m = 4, 2
    needs = Needs(mass_varies=False, velocity_forces=False, driven=False)
    rest = np.array([1.0, 0.0, 2.0, 0.0])

    def __init__(self, stiffness):
        self.stiffness = float(stiffness)

    def mass(self, q):
        return np.eye(4)

    def force(self, t, q, v):
        return self.stiffness * (q - self.rest) + np.array([0.0, 9.81, 0.0, 9.81])

    def force_q(self, t, q, v):
        return self.stiffness * np.eye(4)

    def phi(self, t, q):
        apart = q[2:] - q[:2]
        return np.array([q[:2] @ q[:2] - 1, apart @ apart - 1]) / 2

    def phi_q(self, t, q):
        apart = q[2:] - q[:2]
        return np.array([[q[0], q[1], 0.0, 0.0], [-apart[0], -apart[1], apart[0], apart[1]]])


@lru_cache(maxsize=4)
def state_of(plates, cells):
    """(model, State) on its way: "soft", "steel" or "stiffest" plates, or point masses on "springs" of 1e10 N/m."""
    if plates == "springs":
        model = Springs(1e10)
        turned = np.array([0.8, -0.6, 1.6, -1.2])
        return model, consistent_state(model, 0.0, turned, np.array([0.6, 0.8, 1.2, 1.6]))
    return moving(MODULI[plates], cells)


def moving(modulus, cells, time=0.3):
    """(model, State) of the driven double plate of Young's modulus `modulus`, Pa, on its way at `time`."""
    rubber = plates.RUBBER
    material = plates.Material(E=modulus, nu=rubber.nu, rho=rubber.rho)
    model = plates.double_plate_motors(cells=cells, material=material).build()
    run = solve(model, time, GeneralizedAlpha(h=1e-3, rho_inf=0.5), every=10**9)
    return model, freed(model, time, run.q[-1], run.v[-1])


def freed(model, t, q, v):
    """The consistent State nearest to (q, v) at t: generalized-alpha leaves phi' of the size of its error."""
    rate = model.phi_q(t, q) @ v + model.phi_t(t, q)
    return consistent_state(model, t, q, v + mass_system(model, t, q).solve(np.zeros(model.n), rate)[0])


def fastest(model, state):
    """Largest angular frequency at a state, 1/s: h far below its inverse is the limit of small steps."""
    from scipy.linalg import eigh

    s = state
    stiffness = dense(model.tangent(s.t, s.q, s.v, s.a, s.lam, 0.0, 0.0, 1.0))
    size = model.n
    return float(
        np.sqrt(eigh(stiffness, dense(model.mass(s.q)), eigvals_only=True, subset_by_index=[size - 1, size - 1])[0])
    )


def alpha_blocks(model, state, h, rho_inf=0.9):
    """(S, B, beta h^2) of generalized-alpha's Newton matrix at a state."""
    c = GeneralizedAlpha(h=h, rho_inf=rho_inf).coefficients
    to_a, to_v = (1 - c.alpha_m) / (c.beta * h * h * (1 - c.alpha_f)), c.gamma / (c.beta * h)
    s = state
    tangent = model.tangent(s.t, s.q, s.v, s.a, s.lam, to_a, to_v, 1.0)
    return tangent, model.phi_q(s.t, s.q), c.beta * h * h


def alpha_condition(model, state, h, unknown="q", scaling="none"):
    """Condition number of generalized-alpha's matrix for the unknowns (dq, dv or da; dlam), at a scaling or one half of
    Bottasso's.
    """
    if scaling in SCALINGS:
        return condition_number(model, GeneralizedAlpha(h=h), state, scaling=scaling, unknown=unknown, exact=True)
    tangent, B, step_square = alpha_blocks(model, state, h)
    physical, given = (
        scaling_factors("physical", step_square, tangent),
        Scaling(*alpha_factors(scaling, step_square, tangent)),
    )
    rows = np.concatenate([np.full(model.n, physical.row / given.row), np.ones(model.m)])
    columns = np.concatenate([np.ones(model.n), np.full(model.m, physical.column / given.column)])
    return Scaled(dense(assemble(tangent, B, given)), rows, columns).condition()


def alpha_factors(scaling, step_square, tangent):
    """(row, column) factors of a scaling, the two halves of Bottasso's included."""
    halves = {"rows only": (step_square, 1.0), "multipliers only": (1.0, 1.0 / step_square)}
    if scaling in halves:
        return halves[scaling]
    factors = scaling_factors(scaling, step_square, tangent)
    return factors.row, factors.column


def ida_matrix(model, state, h, form, rate=10.0):
    """IDA's whole matrix `J = dF/dy + cj dF/dy'` of a form, as Scaled, with cj = 1/h (BDF of order 1).

    Its factors: dv by cj, dlam by s, dmu by cj; the rows of q' by 1/cj, of r by 1/s, of the k-th derivative of phi by
    1/cj^k; s is the mean of the diagonal of S = K + cj C + cj^2 M. Integrated multipliers by another 1/cj.
    """
    cj, system = 1.0 / h, System(model, form, rate)
    blocks = system.blocks(state.t, *system.pack(state))
    S = system.iteration_matrix(state.t, *system.pack(state), cj)
    n, m, kinds = model.n, model.m, system.form
    size = float(np.mean(np.abs(S.diagonal())))
    rows = [np.full(n, 1 / cj), np.full(n, 1 / size)]
    rows += [np.full(m, cj ** -max(kinds.rows))] if kinds.combined else [np.full(m, cj**-order) for order in kinds.rows]
    unit = 1 / cj if kinds.integrated else 1.0
    columns = [np.ones(n), np.full(n, cj), np.full(m, size * unit)] + (
        [np.full(m, cj * unit)] if kinds.stabilised else []
    )
    return Scaled(ida_dense(blocks, S, cj), np.concatenate(rows), np.concatenate(columns))


def ida_dense(blocks, S, cj):
    """J of the Blocks as a dense matrix; K is what S = K + cj C + cj^2 M leaves."""
    n, m = blocks.n, blocks.m
    M, C = dense(blocks.M), 0.0 if blocks.C is None else dense(blocks.C)
    damping = cj * M + C
    unit = cj if blocks.integrated else 1.0
    multipliers = (2 if blocks.stabilised else 1) * m
    J = np.zeros((2 * n + multipliers, 2 * n + multipliers))
    J[:n, :n], J[:n, n : 2 * n] = cj * np.eye(n), -np.eye(n)
    J[n : 2 * n, :n], J[n : 2 * n, n : 2 * n] = dense(S) - cj * damping, damping
    J[n : 2 * n, 2 * n : 2 * n + m] = unit * blocks.B.T
    if blocks.stabilised:
        J[:n, 2 * n + m :] = unit * blocks.B.T
    J[2 * n :, :n], J[2 * n :, n : 2 * n] = blocks.P, blocks.Q0 + cj * blocks.Q1
    return J


def inherent_condition(model, state, h):
    """cond of S on the motions that the constraints leave free: what the plates have of their own, in any coordinates
    of index 1.
    """
    from scipy.linalg import null_space

    tangent, B, _ = alpha_blocks(model, state, h)
    free = null_space(dense(B))
    values = np.linalg.svd(free.T @ dense(tangent) @ free, compute_uv=False)
    return float(values[0] / values[-1])


def dense(matrix):
    """The matrix as a dense array."""
    return matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix, float)
