"""IDA's equations and their Newton correction, by the functions of a model's table: one compiled driver for every model.

IDA asks for `J d = -F`, J = dF/dy + cj dF/dy'. With y = (q, v, lam, mu) and mu only where the form has it:

    |  cj I     -I               B^T |  |dq  |   |r1|     q' - v + B^T mu
    |  K      cj M + C   B^T         |  |dv  | = |r2|     M v' + g + B^T lam
    |  P         Q                   |  |dlam|   |rc|     the form's constraint rows c(t, q, v, v')
                                        |dmu |            P = c_q,  Q = c_v + cj c_a

The first row gives dv; what remains is

    |  S       B^T   D B^T | |dq  |   |r2 + D r1|     S = K + cj D,  D = cj M + C
    |  P + cj Q      Q B^T | |dlam| = |rc + Q r1|
                             |dmu |

the system of a real mode of Radau IIA with c = cj and unit weights of mu (polyida.system), and so the same entries of the tables.
"""

from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, NOT_FINITE
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import address, call
from polyida.system import BIAS, CLOSE, MATRICES, OFF, RATE, REACTION, REAL, RESIDUAL, ROWS, SELECT
from polyida.system.dense import finite

# constants of compiled code
INTEGRATED, BENDS = range(2)  # of Iterate.flags; BENDS: phi is a row and not linear
SLOT = 0  # the one whose matrices are used
INSTANT = 1  # the stage of the step that begins at instant 0


@pack
class Iterate(NamedTuple):
    """An iterate of a form with k blocks of m constraint rows, and the correction of it.

    levels (k, 3): what phi, phi' and phi'' count for in each block; c (3,): cj as SELECT takes it. q, v, a, lam, mu: of the iterate; first, r (n,),
    closing (2, m): F; phi, level (m,), moved, force (n,), rates (2, m): scratch; dq, multipliers (2, m): the correction.
    """

    levels: np.ndarray
    flags: np.ndarray
    c: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    mu: np.ndarray
    first: np.ndarray
    r: np.ndarray
    closing: np.ndarray
    phi: np.ndarray
    level: np.ndarray
    moved: np.ndarray
    force: np.ndarray
    rates: np.ndarray
    dq: np.ndarray
    multipliers: np.ndarray


def iterate(system, bends):
    """Room for a System (integrate/ida/forms.py)."""
    n, m = system.model.n, system.model.m
    shapes = (3,), (n,), (n,), (n,), (m,), (m,), (n,), (n,), (2, m), (m,), (m,), (n,), (n,), (2, m), (n,), (2, m)
    return Iterate(system.levels, np.array([system.form.integrated, bends], np.int64), *map(np.zeros, shapes))


@entry
def equations(functions, model, z, y, yp):
    """F at (y, y'). Returns how it ended."""
    n, m, ended = z.q.shape[0], z.lam.shape[0], DONE
    multipliers = yp if z.flags[INTEGRATED] else y
    for i in range(n):
        z.q[i], z.v[i], z.a[i], z.first[i] = y[i], y[n + i], yp[n + i], yp[i] - y[n + i]
    for k in range(m):
        z.lam[k] = multipliers[2 * n + k]
        z.mu[k] = multipliers[2 * n + m + k] if z.levels.shape[0] == 2 else 0.0
    if m and (wanted(z, 1) or wanted(z, 2)):
        ended = call(functions[REACTION], model, INSTANT, address(z.q), address(z.mu), address(z.first), 0, 0, 0)
    if ended == DONE:
        places = address(z.q), address(z.v), address(z.a), address(z.lam), address(z.r), address(z.phi)
        ended = call(functions[RESIDUAL], model, INSTANT, places[0], places[1], places[2], places[3], places[4], places[5])
    for level in range(z.levels.shape[0]):
        for k in range(m):
            z.closing[level, k] = z.levels[level, 0] * z.phi[k]
    if ended == DONE and m and wanted(z, 1):
        ended = call(functions[RATE], model, INSTANT, address(z.q), address(z.v), address(z.level), 1, 0, 0)
        add(z, 1)
    if ended == DONE and m and wanted(z, 2):
        ended = call(functions[BIAS], model, INSTANT, address(z.q), address(z.v), address(z.a), address(z.level), 0, 0)
        add(z, 2)
    return NOT_FINITE if ended == DONE and not (finite(z.r) and finite(z.closing[0]) and finite(z.closing[1])) else ended


@part
def wanted(z, order):
    """Whether a derivative of phi is in the rows."""
    return z.levels[0, order] != 0.0 or z.levels[z.levels.shape[0] - 1, order] != 0.0


@part
def add(z, order):
    """Add z.level, a derivative of phi, to the rows."""
    for level in range(z.levels.shape[0]):
        for k in range(z.level.shape[0]):
            z.closing[level, k] += z.levels[level, order] * z.level[k]


@entry
def correction(functions, model, z, cj, anew, fresh, out):
    """out = J^-1 F behind `equations`; anew: with the matrices of this iterate; fresh: with its rows. Returns how it ended."""
    n, m, ended, tied = z.q.shape[0], z.lam.shape[0], DONE, z.levels.shape[0] == 2
    made = anew and functions[MATRICES] != 0  # with differences of phi_q, perhaps, and so no B at hand
    if made:
        ended = call(functions[MATRICES], model, INSTANT, address(z.q), address(z.v), address(z.a), address(z.lam), SLOT, 0)
    if anew and functions[SELECT]:
        z.c[0] = cj
        call(functions[SELECT], model, SLOT, address(z.c), 0, 0, 0, 0, 0)
    if ended == DONE and fresh:
        ended = call(functions[ROWS], model, INSTANT, address(z.q), address(z.v), address(z.a), 0 if made else 1, 0, 0)
    for i in range(n):
        z.moved[i] = cj * z.first[i]
    if ended == DONE:
        places = address(z.first), address(z.moved), address(z.force), address(z.q), address(z.rates)
        ended = call(functions[OFF], model, INSTANT, places[0], places[1], places[2], 0, places[3], places[4])
    for i in range(n):
        z.r[i] += z.force[i]
    for level in range(z.levels.shape[0]):
        for k in range(m):
            z.closing[level, k] += z.rates[level, k]
    if ended == DONE:
        ended = solve(functions, model, z)
    if ended == DONE and z.flags[BENDS] and functions[CLOSE]:
        for i in range(n):
            z.moved[i] = z.q[i] + z.dq[i]
        ended = call(functions[CLOSE], model, INSTANT, address(z.moved), 0, 0, address(z.level), address(z.phi), 0)
        for k in range(m):
            z.closing[0, k] += z.level[k]
        if ended == DONE:
            ended = solve(functions, model, z)
    if ended != DONE:
        return ended
    for i in range(n):
        out[i], z.moved[i] = -z.dq[i], z.first[i] + cj * z.dq[i]
    if tied and m:
        ended = call(functions[REACTION], model, INSTANT, address(z.q), address(z.multipliers) + 8 * m, address(z.moved), 1, 0, 0)
    for i in range(n):
        out[n + i] = -z.moved[i]
    for k in range(2 * m if tied else m):
        found = z.multipliers[k // m, k % m]
        out[2 * n + k] = -found / cj if z.flags[INTEGRATED] else -found
    return ended


@part
def solve(functions, model, z):
    """The correction from z.r and z.closing."""
    places = address(z.r), address(z.closing), address(z.lam), address(z.dq), address(z.multipliers)
    return call(functions[REAL], model, INSTANT, places[0], places[1], places[2], places[3], places[4], 0)
