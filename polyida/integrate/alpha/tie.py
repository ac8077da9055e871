"""The stabilised form in compiled code: positions on phi = 0 and velocities on `phi_q v + phi_t = 0` at once.

`q_1 = q_0 + h v_0 + h^2 ((1/2 - beta) a_0 + beta a_1) - M^-1 phi_q^T eta`: eta takes up the local error of q along the
constraints, so that v, with Newmark's formula in a, need not (Gear, Gupta, Leimkuhler 1985; Arnold, Cardona, Bruels
2015). In one Newton step, with dq = x + y, x what v and a follow and `y = -M^-1 phi_q^T eta`,
`S x + phi_q^T dlam = -r`, `phi_q x = -rate/gamma'`, `phi_q y = -(phi - rate/gamma')`: x is the usual solve, y costs
the points' columns of M^-1. All that eta has added in a step is turned with phi_q in each iteration, so that at last it is along M^-1 phi_q^T of
the step's end, whatever the way of Newton's method there.
"""

from polyida.assembly.rows import joints
from polyida.assembly.rows.tie import project, velocity_rate
from polyida.compiled import part
from polyida.integrate.alpha.step import DD, Q, V, pairs


@part
def part_constraints(s, drives, dz, v, phi, t, to_v):
    """phi becomes rate/gamma', for the solve of x; t.bias what is left for y, phi - rate/gamma'."""
    velocity_rate(s, drives, dz, v, t)
    for k in range(phi.shape[0]):
        share = t.rate[k] / to_v
        t.bias[k] = phi[k] - share
        phi[k] = share


@part
def slip(s, p, y, x, t):
    """Add y to the step, in t.slip with that of the iterations before."""
    past, now, dd = y.past, x.now, pairs(x.now[DD])
    joints.point_values(s, t.slip, t.vz)
    for k in range(t.bias.shape[0]):
        t.bias[k] -= joints.along(s, t.slopes, k, t.vz)
    for i in range(dd.shape[0]):
        for e in range(2):
            dd[i, e] -= t.slip[i, e]
            t.slip[i, e] = 0.0
    good = project(s, t, t.bias, t.slip)
    for i in range(dd.shape[0]):
        for e in range(2):
            dd[i, e] += t.slip[i, e]
    for i in range(now.shape[1]):
        now[Q, i] = past[Q, i] + (p.h * past[V, i] + now[DD, i])
    return good


@part
def settle(s, drives, dz, v, rate, t):
    """Take what the tolerance left of the velocity constraint's violation out of v (nodes, 2); rate is zero then."""
    velocity_rate(s, drives, dz, v, t)
    rate[:] = 0.0
    return project(s, t, t.rate, v)
