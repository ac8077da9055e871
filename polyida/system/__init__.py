"""A model as a table of C functions: a driver calls them by their addresses and is compiled once for every model.

Each has the signature `int64 f(int64 model, int64 instant, int64 x 6)`: the address of the model's workspace, the number of one of the
instants that were prepared, and addresses of contiguous float64 arrays. It returns how it ended (REASONS). A driver asks for some of the
entries; where 0 is allowed, it says so.

| entry | arguments | what it does |
|---|---|---|
| RESIDUAL | q, v, a, lam, r, phi | r and phi |
| HOLD | q, v, times | take up the state that a step begins from; times: as of PREPARE |
| CLOSE | q, dd, dv, phi, rate | phi and rate at q; where they are carried, from those at the step's start and q's and v's increments |
| FACTOR | q, v, a, lam, c | S = c[0] M + c[1] dr/dv + dr/dq there; 0 where the caller of the driver makes it |
| SOLVE | q, lam, r, phi, dq, dlam | `S dq + B^T dlam = -r`, `B dq = -phi`, with S as factored, B of the last RESIDUAL |
| RATE | q, v, rate, known | `phi_q v + phi_t`; known: at the q of the last REACTION of this stage |
| PROJECT | rows, x, anew | B x falls by rows, and the change of x has the least M-norm; anew: from x = 0 to `B x = B x_before - rows`; B of the last RATE |
| ACCEPT | q | whether the model accepts a state |
| ACCELERATION | q, v, a, lam | a and lam that are consistent with q and v; 0, like KINETIC, where they are made when they are asked for |
| MIDDLE | states, lam, r, phi | r in the middle of a step by the energy-momentum method, phi at its end; states: q_0, q_1, q, v, a of the middle |
| KINETIC | v, energy | `v^T M v` |

The other entries are for the s stages of Radau IIA; the instant of a step's beginning is a multiple of s + 1, those of its stages follow.

| entry | arguments | what it does |
|---|---|---|
| PREPARE | times | take (h, t and times of the instants, s + 1) of a step; 0 where all steps of a stretch are known before |
| REACTION | q, mu, dv, known | dv += D^-1 B^T mu; known: B is that of ROWS |
| ROWS | q, v, a, known | take the constraints' rows of the middle stage; a is read if phi'' is a row; known: B is that of the last RESIDUAL |
| TURN | r, back | turn the residuals (s, n) into the frame of the middle stage, or corrections back; 0 where there are no frames |
| REAL, PAIR | r, rows, lam, dq, multipliers | the correction of a mode, radau/step.py; rows and multipliers (2, m), lam (m,) of the middle stage |
| OFF | v, a, r, p, q, rows | r = C v + M a, p = M v, of where the factors were made or, in a scene, at q; rows: of ROWS, on v; p and rows may be 0 |
| MATRICES | q, v, a, lam, slot | K, C and M of a state, kept under a number; 0 where the caller of the driver makes them |
| SELECT | slot, c | go on with those of a number; c: of the real mode, real and imaginary part of the complex one, 0 if there is none |

IDA calls those of one stage, with c = cj in the real mode and D = 1; in some of its forms phi'' is a row.

| entry | arguments | what it does |
|---|---|---|
| BIAS | q, v, a, found | `phi_q a + phi_bias`, the second derivative of phi; B is that of the last REACTION |

The backward sweep of generalized-alpha has tables of its own (adjoint/tables.py) with one entry.

| entry | arguments | what it does |
|---|---|---|
| ADJOINT | right, below, bar, w, mu, found | solve the adjoint of the step that ends at this instant (adjoint/alpha.py) |
"""

from numba import types

from polyida import jit
from polyida.jit.user_functions import ARGUMENTS

INSTANTS = 1024  # that are prepared at once, at most: of small models steps take less than 1 ms in hundreds, what is between them 0.1 ms
STEPS = 256  # the same of steps of Radau IIA
# constants of compiled code
RESIDUAL, HOLD, CLOSE, FACTOR, SOLVE, RATE, PROJECT, ACCEPT, ACCELERATION, MIDDLE, KINETIC = range(11)
PREPARE, REACTION, ROWS, TURN, REAL, PAIR, OFF, MATRICES, SELECT, ADJOINT, BIAS = range(11, 22)
ENTRIES = 22


def c_address(function, kind):
    """The address of an entry `f(workspace, instant, 6 addresses)` for workspaces of a type, as a C function."""
    return jit.c_address(function, types.int64(kind, *[types.int64] * (ARGUMENTS - 1)))
