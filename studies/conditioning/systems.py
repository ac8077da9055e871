"""Condition numbers of the iteration matrices of generalized-alpha, IDA and Radau IIA on soft and stiff plates, and theoretical values."""

from functools import lru_cache

import numpy as np

from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import consistent_state
from polyida.linear.lu import condition, dense, scaled
from polyida.linear.saddle import SCALINGS, assemble, scaling_size
from polyida.model import Model, Needs
from polyida.problems import plates
from polyida.run.solve import solve
from polyida.study.conditions import condition_number

ALPHA_UNKNOWNS = {"q": -4, "v": -3, "a": -2}  # beside lam: slope of the raw condition number in h
ALPHA_SCALINGS = {"none": -4, "rows only": -2, "multipliers only": -2, "bottasso": 0, "physical": 0}
IDA_SLOPES = {"index3": -3, "ggl2": -2, "index2": -2, "ggl1": -1, "index1": -1, "baumgarte": -1}
RADAU_SLOPES = {"index3": -3, "ggl": -2}

MODULI = {"soft": 5e7, "steel": 2e11, "stiffest": 1e12}  # Pa; 10 mm thick: up to 1e10 N/m


class Springs(Model):
    """Two point masses of 1 kg on rods, the second below the first; every coordinate has a spring of `stiffness`, N/m.

    The stiffness has a single size, so that the physical scaling removes all of it.
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
    """(model, State) in motion: "soft", "steel" or "stiffest" plates, or point masses on "springs" of 1e10 N/m."""
    if plates == "springs":
        model = Springs(1e10)
        turned = np.array([0.8, -0.6, 1.6, -1.2])
        return model, consistent_state(model, 0.0, turned, np.array([0.6, 0.8, 1.2, 1.6]))
    return moving(MODULI[plates], cells)


def moving(modulus, cells, time=0.3):
    """(model, State) of the driven double plate with Young's modulus `modulus`, Pa, at `time`."""
    rubber = plates.RUBBER
    material = plates.Material(E=modulus, nu=rubber.nu, rho=rubber.rho)
    model = plates.double_plate_motors(cells=cells, material=material).build()
    run = solve(model, time, GeneralizedAlpha(h=1e-3, rho_inf=0.5), every=10**9)
    return model, freed(model, time, run.q[-1], run.v[-1])


def freed(model, t, q, v):
    """The consistent State nearest to (q, v) at t: phi' of generalized-alpha has the size of its error."""
    rate = model.phi_q(t, q) @ v + model.phi_t(t, q)
    return consistent_state(model, t, q, v + model.mass_system(t, q).solve(np.zeros(model.n), rate)[0])


def fastest(model, state):
    """Largest angular frequency at a state, 1/s; small steps are much shorter than its inverse."""
    from scipy.linalg import eigh

    s = state
    stiffness = dense(model.tangent(s.t, s.q, s.v, s.a, s.lam, 0.0, 0.0, 1.0))
    size = model.n
    return float(np.sqrt(eigh(stiffness, dense(model.mass(s.q)), eigvals_only=True, subset_by_index=[size - 1, size - 1])[0]))


def alpha_blocks(model, state, h, rho_inf=0.9):
    """(S, B, beta h^2) of generalized-alpha's Newton matrix at a state."""
    c = GeneralizedAlpha(h=h, rho_inf=rho_inf).coefficients
    to_a, to_v = c.rates(h)
    s = state
    tangent = model.tangent(s.t, s.q, s.v, s.a, s.lam, to_a, to_v, 1.0)
    return tangent, model.phi_q(s.t, s.q), c.beta * h * h


def alpha_condition(model, state, h, unknown="q", scaling="none"):
    """Condition number of generalized-alpha's matrix for the unknowns (dq, dv or da; dlam), at a scaling or one half of
    Bottasso's.
    """
    if scaling in SCALINGS:
        return condition_number(model, GeneralizedAlpha(h=h), state, scaling, unknown, exact=True)
    tangent, B, step_square = alpha_blocks(model, state, h)
    return condition(scaled(assemble(tangent, B), *alpha_factors(scaling, step_square, tangent, len(state.lam))), exact=True)


def alpha_factors(scaling, step_square, tangent, m):
    """Factors (of rows, of columns), (n + m,) each, of a scaling, the two halves of Bottasso's included."""
    halves = {"rows only": (step_square, 1.0), "multipliers only": (1.0, 1.0 / step_square)}
    row, column = halves.get(scaling) or (1.0 / (size := scaling_size(scaling, step_square, tangent)), size)
    return np.repeat([row, 1.0], (tangent.shape[0], m)), np.repeat([1.0, column], (tangent.shape[0], m))


def ida_condition(model, state, h, form, scaling="none"):
    """Condition number of IDA's whole matrix of a form, with cj = 1/h (BDF of order 1)."""
    return condition_number(model, IDA(form=form), state, scaling, h=h, exact=True)


def radau_condition(model, state, h, form, mode, scaling="none"):
    """Condition number of the whole matrix of Radau IIA of order 5, of a form and a mode, "real" or "complex"."""
    return condition_number(model, RadauIIA(h=h, form=form), state, scaling, mode=mode, exact=True)


def inherent_condition(model, state, h):
    """Condition number of S on the motions that satisfy the constraints: that of the plates, in any coordinates of index 1."""
    from scipy.linalg import null_space

    tangent, B, _ = alpha_blocks(model, state, h)
    free = null_space(dense(B))
    values = np.linalg.svd(free.T @ dense(tangent) @ free, compute_uv=False)
    return float(values[0] / values[-1])
