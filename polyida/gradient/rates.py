"""Vector-Jacobian products of the constraints' rates, of any model: of `psi = phi_q v + phi_t` and of phi_bias, from phi_q and its slope."""

import numpy as np

from polyida.model.differences import along, around


def pulled_rate(model, t, q, v, kappa):
    """psi_q^T kappa, (n,): `(B^T kappa)_q^T v + (B_t)^T kappa`. By v it is B^T kappa."""
    found = model.reaction_q(t, q, kappa).T @ v if model.needs.phi_q_varies else np.zeros(model.n)
    if not model.needs.driven:
        return found
    return found + along(lambda s: model.phi_q(t + s, q).T @ kappa, room=smooth(model, t))


def pulled_bias(model, t, q, v, nu):
    """(bias_q^T nu, bias_v^T nu), each (n,): `bias = d/ds psi(t + s, q + s v, v)` at s = 0, and `bias_v = 2 psi_q`."""
    if not (model.needs.driven or model.needs.phi_q_varies):
        return np.zeros((2, model.n))
    reach = min(1.0, (1.0 + np.abs(q).max(initial=0)) / (1e-300 + np.abs(v).max(initial=0)))
    onward = along(lambda s: pulled_rate(model, t + s, q + s * v, v, nu), reach, smooth(model, t))
    return onward, 2.0 * pulled_rate(model, t, q, v, nu)


def smooth(model, t):
    """The range of s around 0 in which t + s meets no kink."""
    return around(model.kinks(t - 1.0, t + 1.0), t)
