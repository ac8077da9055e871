"""A model as a table of C functions for the stages of Radau IIA, with the signature of system/table.py.

The instant of a step's beginning is a multiple of s + 1, those of its s stages follow.

| entry | arguments | what it does |
|---|---|---|
| PREPARE | times | takes (h, t and times of the instants, s + 1) of a step; 0 where all steps of a stretch are known before |
| HOLD | q, v, times | takes up the state that a step begins from, and h |
| REACTION | q, mu, dv | dv += D^-1 B^T mu |
| RESIDUAL | q, v, a, lam, r, phi | r and phi |
| CLOSE | q, e, dv, phi, rate | phi and, where it is carried, rate, from those at the step's beginning and what q - h v_0 and v have gained |
| RATE | q, v, rate, known | `B v + phi_t`; known: at the q of the last REACTION of this stage |
| PROJECT | rows, x, 0 | B x falls by rows, and the change of x has the least M-norm; B of the last RATE |
| ACCEPT | q | whether the model accepts a state |
| ROWS | q, v | takes the constraints' rows of the middle stage |
| TURN | r, back | turns the residuals (s, n) into the frame of the middle stage, or corrections back; 0 where there are no frames |
| REAL, PAIR | r, rows, lam, dq, multipliers | the correction of a mode, radau/step.py; rows and multipliers (2, m), lam (m,) of the middle stage |
| OFF | v, a, r, p, q | r = C v + M a and p = M v, of where the factors were made, or, in a scene, at q |
| ACCELERATION | q, v, a, lam | `[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`; 0 where it is made when it is asked for |
| FACTOR | q, v, a, lam, slot | K, C and M of a state, kept under a number; 0 where the caller of the driver makes them |
| SELECT | slot, c | goes on with those of a number; c: of the real mode, real and imaginary part of the complex one |
"""

from polyida.linear.lu import KEPT

# constants of compiled code
PREPARE, HOLD, REACTION, RESIDUAL, CLOSE, RATE, PROJECT, ACCEPT, ROWS, TURN, REAL, PAIR, OFF, ACCELERATION, FACTOR, SELECT = range(16)
ENTRIES = 16
SLOTS = KEPT
STEPS = 64  # of a stretch, at most
