"""A model as a table of C functions. Drivers call them by address, and are compiled once for all models.

Each function has the signature `int64 f(int64 workspace, int64 instant, int64 x 6)`: the address of the model's workspace, the number of one of the
prepared instants, and six values: addresses of contiguous float64 arrays, 0 for one that is not asked for; `known`, `from_zero` and `back` are
flags, `slot` is a number. SELECT takes a slot and ADJOINT a step in place of the instant, PREPARE and TURN
the first instant of a step. It returns a status (errors.REASONS). A driver needs some of the entries only.

| entry | arguments | action |
|---|---|---|
| RESIDUAL | q, v, a, lam, residual, phi | r = M a + g + B^T lam, and phi |
| BEGIN | q, v, times | store the state at which a step begins; times: as of PREPARE |
| CONSTRAINTS | q, dq, dv, phi, rate | phi and rate at q; of tables by increments: from those at the step's start, which phi and rate hold, and the changes dq - h v_0 and dv |
| FACTOR | q, v, a, lam, c | S = c[0] M + c[1] dr/dv + dr/dq; no entry (address 0) if the caller of the driver computes it |
| SOLVE | q, lam, residual, phi, dq, dlam | `S dq + B^T dlam = -residual`, `B dq = -phi`, with S as factored, B of the last RESIDUAL |
| RATE | q, v, rate, known | `phi_q v + phi_t`; known: True if B is that of the last REACTION of this stage |
| PROJECT | rows, x, from_zero | change x by the least M-norm, so that B x falls by rows; from_zero: x becomes the least x with `B x = B x_before - rows`; B of the last RATE |
| ACCEPT | q | status of a state: accepted or rejected |
| ACCELERATION | q, v, a, lam | a and lam that are consistent with q and v; no entry (address 0) if they are computed when they are asked for |
| MIDDLE | states, lam, residual, phi | the residual in the middle of a step of the energy-momentum method, phi at its end; states: q_0, q_1, q, v, a of the middle |
| STRAINS | past, now, state, numbers | state = 0: begin a step whose unknowns are without strains (assembly/condensation.py), else end it: fill the rows of the strains in state |

Further entries serve the s stages of Radau IIA. D is the diagonal of M over its mean, or 1: in scenes and in models of uniform units. The instant of a step's beginning is a multiple of s + 1; those of its stages follow.

| entry | arguments | action |
|---|---|---|
| PREPARE | times | take (h, t and times of the instants, s + 1) of a step; no entry (address 0) if all steps of a stretch are known before |
| REACTION | q, mu, dv, known | dv += D^-1 B^T mu; known: True if B is that of ROWS |
| ROWS | q, v, a, known | compute the rows of the middle stage; a is read if phi'' is a row; known: True if B is that of the last RESIDUAL |
| TURN | residuals, back | rotate the residuals (s, n) into the frame of the middle stage, or corrections back; 0 without frames |
| REAL, PAIR | residual, closing, lam, dq, multipliers | the correction of a mode, radau/step.py; closing and multipliers (2, m), lam (m,) of the middle stage |
| INERTIA | v, a, force, momentum, q, closing | force = C v + M a and momentum = M v, at the state of the factors or, in a scene, at q; closing (2, m): the rows of ROWS times v, or B v in place of a second block that is not there; momentum and closing may be 0 |
| MATRICES | q, v, a, lam, slot, eigenvalues | compute K, C and M of a state, or the factors with eigenvalues as of SELECT, stored under a number; no entry (address 0) if the caller of the driver computes them |
| SELECT | slot, eigenvalues | use those of a number; eigenvalues: c of the real mode, real and imaginary part of the complex one, 0 without one |

IDA uses the entries of one stage, with c = cj in the real mode and D = 1; in some of its forms phi'' is a row.

| entry | arguments | action |
|---|---|---|
| BIAS | q, v, a, out | `phi_q a + phi_bias`, the second derivative of phi; B is that of the last REACTION |

The functions of a scene are compiled once for all scenes: what one lacks has arrays of size 0. Kernels of force elements, of damping and of
viscoelastic plates (assembly/optional.py), and of elastic bodies of few coordinates (assembly/reduced_kernels.py), are called by addresses of their
own and compiled for the scenes that have such parts.

The backward sweeps of generalized-alpha and Radau IIA have their own tables (adjoint/tables.py) with one entry.

| entry | arguments | action |
|---|---|---|
| ADJOINT | right, below, bar, solution, multipliers, out | solve the adjoint of a step (adjoint/alpha_sweep.py, adjoint/radau_sweep.py) |
"""

# most instants that are prepared together: small models take less than 1 ms for hundreds of steps, and 0.1 ms between stretches
INSTANTS = 1024
STEPS = 256  # most steps of Radau IIA that are prepared together
# constants of compiled code
RESIDUAL, BEGIN, CONSTRAINTS, FACTOR, SOLVE, RATE, PROJECT, ACCEPT, ACCELERATION, MIDDLE = range(10)
PREPARE, REACTION, ROWS, TURN, REAL, PAIR, INERTIA, MATRICES, SELECT, ADJOINT, BIAS, STRAINS = range(10, 22)
ENTRIES = 22
