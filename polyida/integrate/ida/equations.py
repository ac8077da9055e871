"""IDA's equations F(t, y, y') = 0 and their Newton corrections J^-1 F: one compiled driver for the tables of all models.

J = dF/dy + cj dF/dy'. With y = (q, v, lam, mu), mu only if the form has it:

    |  cj I     -I               B^T |  |dq  |   |r1|     q' - v + B^T mu
    |  K      cj M + C   B^T         |  |dv  | = |r2|     M v' + g + B^T lam
    |  P         Q                   |  |dlam|   |rc|     the form's constraint rows c(t, q, v, v')
                                        |dmu |            P = c_q,  Q = c_v + cj c_a

The first row gives dv; the rest is

    |  S       B^T   D B^T | |dq  |   |r2 + D r1|     S = K + cj D,  D = cj M + C
    |  P + cj Q      Q B^T | |dlam| = |rc + Q r1|
                             |dmu |

the system of a real mode of Radau IIA with c = cj and D = 1 for mu (polyida.system), solved by the same entries of the tables.

`equations` evaluates F in an Iterate, and `correction` then J^-1 F.
"""

from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, NOT_FINITE
from polyida.integrate.ida.forms import INSTANT
from polyida.jit import entry, pack, part
from polyida.linear.dense import put
from polyida.system import CONSTRAINTS, MATRICES
from polyida.system import instant as ask
from polyida.system.dense import finite

# constants of compiled code
INTEGRATED, BENDS = range(2)  # of Iterate.flags; BENDS: phi is a row and not linear
SLOT = 0  # of the matrices


@pack
class Iterate(NamedTuple):
    """An iterate of a form with k blocks of m constraint rows, F there, and its correction."""

    levels: np.ndarray  # (k, 3) weights of phi, phi' and phi'' in each block
    flags: np.ndarray  # (2,) INTEGRATED, BENDS
    velocity_rows: np.ndarray  # their numbers
    c: np.ndarray  # (3,) cj as SELECT takes it
    q: np.ndarray  # (n,) q, v, a, lam and mu of the iterate
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray  # (m,)
    mu: np.ndarray
    first: np.ndarray  # (n,) r1
    r: np.ndarray  # (n,) r2
    rows: np.ndarray  # (2, m) rc
    phi: np.ndarray  # (m,)
    derivative: np.ndarray  # (m,) workspace, as all up to the correction
    vector: np.ndarray  # (n,)
    force: np.ndarray  # (n,)
    rates: np.ndarray  # (2, m)
    dq: np.ndarray  # (n,) the correction of q
    multipliers: np.ndarray  # (2, m) those of lam and mu


@entry
def equations(functions, workspace, iterate, unknowns, rates):
    """Fill F at (y, y'), the unknowns and their rates: `first`, r and rows of the iterate. Returns a status."""
    model, velocity_rows = (functions, workspace), iterate.velocity_rows
    m, blocks = iterate.lam.shape[0], iterate.levels.shape[0]
    take_iterate(iterate, unknowns, rates)
    status = DONE
    if m and (has_order(iterate, 1) or has_order(iterate, 2)):
        status = ask.reaction(model, INSTANT, iterate.q, iterate.mu, iterate.first, 0)
    if status == DONE:
        status = ask.residual(model, INSTANT, iterate.q, iterate.v, iterate.a, iterate.lam, iterate.r, iterate.phi)
    for block in range(blocks):
        for k in range(m):
            iterate.rows[block, k] = iterate.levels[block, 0] * iterate.phi[k]
    if status == DONE and m and has_order(iterate, 1):
        status = ask.rate(model, INSTANT, iterate.q, iterate.v, iterate.derivative, 1)
        add_derivative(iterate, 1)
    if status == DONE and velocity_rows.shape[0] and blocks == 2:
        put(1.0, rates[: iterate.q.shape[0]], iterate.vector)
        status = ask.rate(model, INSTANT, iterate.q, iterate.vector, iterate.derivative, 0)
        for i in range(velocity_rows.shape[0]):
            iterate.rows[0, velocity_rows[i]] = iterate.derivative[velocity_rows[i]]
    if status == DONE and m and has_order(iterate, 2):
        status = ask.bias(model, INSTANT, iterate.q, iterate.v, iterate.a, iterate.derivative)
        add_derivative(iterate, 2)
    is_finite = finite(iterate.r) and finite(iterate.rows[0]) and finite(iterate.rows[1])
    return NOT_FINITE if status == DONE and not is_finite else status


@part
def take_iterate(iterate, unknowns, rates):
    """Set q, v, a, lam and mu of the iterate from the unknowns y and their rates y', and `first` to q' - v."""
    n, m = iterate.q.shape[0], iterate.lam.shape[0]
    multipliers = rates if iterate.flags[INTEGRATED] else unknowns
    for i in range(n):
        iterate.q[i], iterate.v[i], iterate.a[i] = unknowns[i], unknowns[n + i], rates[n + i]
        iterate.first[i] = rates[i] - unknowns[n + i]
    for k in range(m):
        iterate.lam[k] = multipliers[2 * n + k]
        iterate.mu[k] = multipliers[2 * n + m + k] if iterate.levels.shape[0] == 2 else 0.0


@part
def has_order(iterate, order):
    """True if the derivative of phi of that order is in the rows."""
    return iterate.levels[0, order] != 0.0 or iterate.levels[iterate.levels.shape[0] - 1, order] != 0.0


@part
def add_derivative(iterate, order):
    """Add iterate.derivative, that of phi of an order, to the blocks of rows with the weights of the levels."""
    for block in range(iterate.levels.shape[0]):
        for k in range(iterate.derivative.shape[0]):
            iterate.rows[block, k] += iterate.levels[block, order] * iterate.derivative[k]


@part
def renew_matrices(model, iterate, cj, anew, fresh):
    """Make or select the matrices of this iterate if `anew`, and compute its rows if `fresh`. Returns a status."""
    status, made = DONE, anew and ask.provides(model, MATRICES)
    if made:
        status = ask.matrices(model, INSTANT, iterate.q, iterate.v, iterate.a, iterate.lam, SLOT, None)
    if anew:
        iterate.c[0] = cj
        ask.select(model, SLOT, iterate.c)
    if status == DONE and fresh:
        known = 0 if made else 1  # matrices may be made with differences of phi_q, so that B is not that of the last residual
        status = ask.rows(model, INSTANT, iterate.q, iterate.v, iterate.a, known)
    return status


@part
def right_side(model, iterate, cj):
    """Make r and rows those of the system in (dq, dlam, dmu): the first block row of J is eliminated. Returns a status."""
    for i in range(iterate.q.shape[0]):
        iterate.vector[i] = cj * iterate.first[i]
    status = ask.inertia(model, INSTANT, iterate.first, iterate.vector, iterate.force, None, iterate.q, iterate.rates)
    for i in range(iterate.q.shape[0]):
        iterate.r[i] += iterate.force[i]
    for i in range(iterate.velocity_rows.shape[0] if iterate.levels.shape[0] == 2 else 0):
        iterate.rows[0, iterate.velocity_rows[i]] /= cj
    for block in range(iterate.levels.shape[0]):
        for k in range(iterate.lam.shape[0]):
            iterate.rows[block, k] += iterate.rates[block, k]
    return status


@part
def solve(model, iterate):
    """Fill dq and multipliers, the correction from r and rows. Returns a status."""
    return ask.solve_real(model, INSTANT, iterate.r, iterate.rows, iterate.lam, iterate.dq, iterate.multipliers)


@part
def solve_again(model, iterate):
    """Solve again with phi at the corrected q added to its rows, so that the curvature of phi is removed too. Returns a status."""
    for i in range(iterate.q.shape[0]):
        iterate.vector[i] = iterate.q[i] + iterate.dq[i]
    status = ask.constraints(model, INSTANT, iterate.vector, None, None, iterate.derivative, iterate.phi)
    for k in range(iterate.lam.shape[0]):
        iterate.rows[0, k] += iterate.derivative[k]
    return solve(model, iterate) if status == DONE else status


@entry
def correction(functions, workspace, iterate, cj, anew, fresh, out):
    """out = J^-1 F behind `equations`; anew: with the matrices of this iterate; fresh: with its rows. Returns a status."""
    model, n, m = (functions, workspace), iterate.q.shape[0], iterate.lam.shape[0]
    tied = iterate.levels.shape[0] == 2
    status = renew_matrices(model, iterate, cj, anew, fresh)
    if status == DONE:
        status = right_side(model, iterate, cj)
    if status == DONE:
        status = solve(model, iterate)
    if status == DONE and iterate.flags[BENDS] and ask.provides(model, CONSTRAINTS):
        status = solve_again(model, iterate)
    if status != DONE:
        return status
    for i in range(n):
        out[i] = -iterate.dq[i]
        iterate.vector[i] = iterate.first[i] + cj * iterate.dq[i]
    if tied and m:
        status = ask.reaction(model, INSTANT, iterate.q, iterate.multipliers[1], iterate.vector, 1)
    for i in range(n):
        out[n + i] = -iterate.vector[i]
    for k in range(2 * m if tied else m):
        change = iterate.multipliers[k // m, k % m]
        out[2 * n + k] = -change / cj if iterate.flags[INTEGRATED] else -change
    return status
