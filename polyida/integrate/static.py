"""Static equilibrium: `g(t, q, 0) + phi_q^T lam = 0`, `phi(t, q) = 0`, by Newton's method along a growing load."""

import numpy as np

from polyida.errors import InputError
from polyida.integrate.state import State, StepFailure
from polyida.linear.kkt import KKT, SingularSystem, require_independent, scaling_factors


def static(model, t=0.0, q0=None, steps=1, tolerance=1e-10, max_iterations=50):
    """The State at rest in equilibrium at time t.

    The load grows in `steps` equal parts: part s solves `g(q) + phi_q^T lam = (1 - s) g(0)`, g(0) being the load at q = 0.
    Converged where |dq| <= tolerance max(1, |q|) (largest entries). Raises InputError for a wrong setting and for redundant
    constraints, StepFailure where Newton does not converge or the structure can move freely.
    """
    if not (isinstance(steps, (int, np.integer)) and steps >= 1):
        raise InputError(f"static: steps = {steps!r} must be a whole number of at least 1")
    q = np.zeros(model.n) if q0 is None else np.array(q0, float)
    if model.m:
        require_independent(model, model.phi_q(t, q))
    rest, load, lam = np.zeros(model.n), model.force(t, np.zeros(model.n), np.zeros(model.n)), np.zeros(model.m)
    for part in range(1, steps + 1):
        q, lam = _newton(model, t, q, lam, (1 - part / steps) * load, tolerance, max_iterations)
    return State(float(t), q, rest.copy(), rest.copy(), lam)


def _newton(model, t, q, lam, offset, tolerance, max_iterations):
    still = np.zeros(model.n)
    for iteration in range(max_iterations):
        r, phi = model.residual(t, q, still, still, lam) - offset, model.phi(t, q)
        if not (np.isfinite(r).all() and np.isfinite(phi).all()):
            raise StepFailure("not finite", "r or phi is not finite; use more load steps", t, iteration=iteration)
        matrix = model.tangent(t, q, still, still, lam, 0.0, 0.0, 1.0)
        try:
            dq, dlam = KKT(matrix, model.phi_q(t, q), scaling_factors("physical", 1.0, matrix)).solve(r, phi)
        except SingularSystem:
            raise StepFailure("singular", "the structure can move freely: hold it by joints or a clamp", t) from None
        q, lam = q + dq, lam + dlam
        moved = np.abs(dq).max()
        if moved <= tolerance * max(1.0, np.abs(q).max()):
            return q, lam
    raise StepFailure("newton", "static equilibrium not found; use more load steps", t, iterations=max_iterations, moved=float(moved))
