"""What a step of generalized-alpha resolves of a motion: `F = (M + gamma h C + beta h^2 K)^-1 M`, constraints kept.

F is 1/(1 + beta h^2 omega^2) for a mode without damping, 1/(1 + gamma h d) for one of nothing but damping. What a start
makes of q'' and q''' is right for modes with h omega < 1 and far too much beyond: noise of 1e-4 J became 20 J in one step
with rho_inf = 0. `2 F - F^2` of q'' and `F^2` of q''' leave of what no step resolves as much as the step can bear; of a
smooth motion they take h^4 omega^4 of q'' and h^2 omega^2 of q''' (with damping h^2 d^2 and h d), below the order of both.
"""

import numpy as np

from polyida.assembly import equilibrium as kernels
from polyida.assembly.damping import symmetric_blocks
from polyida.integrate.state import StepFailure
from polyida.linear import corotated
from polyida.linear.factor import NotFactorable
from polyida.linear.kkt import KKT, SingularSystem


def resolution(settings, model, state, h):
    """The function x -> F x, (n,), with phi_q F x = phi_q x. Raises StepFailure where F does not exist."""
    c = settings.coefficients
    c_m, c_v = 1 / (c.beta * h * h), c.gamma / (c.beta * h)
    mass, border = model.mass(state.q), model.phi_q(state.t, state.q)
    try:
        solve = (_by_points if settings.by_points(model) else _whole)(settings, model, state, c_m, c_v)
    except (NotFactorable, SingularSystem) as error:
        raise StepFailure("singular", f"the start's M + gamma h C + beta h^2 K: {error}", state.t) from None
    return lambda x: solve(-c_m * (mass @ x), -(border @ x))


def _whole(settings, model, state, c_m, c_v):
    """(r, phi) -> dq by the whole saddle-point matrix."""
    matrix = model.tangent(state.t, state.q, state.v, state.a, state.lam, c_m, c_v, 1.0)
    kkt = KKT(matrix, model.phi_q(state.t, state.q))
    return lambda r, phi: kkt.solve(r, phi)[0]


def _by_points(settings, model, state, c_m, c_v):
    """The same by the plates' factor and the points of a scene."""
    nodes, points, links = (model.n_nodes, 2), (model.n_points, 2), model.arrays.links
    u, drives, lam, dlam = state.q.reshape(nodes), model.drives(state.t), state.lam, np.empty(model.m)
    r, rotation, dz, forces = (np.empty(shape) for shape in (nodes, nodes, points, points))
    kernels.equilibrium(model.arrays, drives, u, np.zeros(nodes), lam, r, dlam, rotation, dz, forces)
    system, _ = corotated.corotated(model, symmetric_blocks(model, u, c_m, c_v), rotation, settings.linear)
    room = corotated.room(model, system)

    def solve(r, phi):
        dq, where = np.empty(nodes), (links, system, room, drives, rotation, dz, lam)
        if not corotated.solve(*where, r.reshape(nodes), phi, c_m, dq, dlam):
            raise StepFailure("singular", "the constraints' system is singular", state.t)
        return dq.ravel()

    return solve
