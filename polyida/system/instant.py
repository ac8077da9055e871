"""What a compiled driver may ask a model at one instant: one function for each entry of the model's table (polyida.system).

`model` is the pair (functions, workspace): the addresses of the table's functions and that of the model's arrays. `instant` is the number of
one of the prepared instants, or of the first one of a step. Functions fill the arrays behind the state, and return a status (errors.REASONS)
unless they say otherwise.
"""

from polyida import system as table
from polyida.jit import part
from polyida.jit.intrinsics import call


@part
def provides(model, entry):
    """True if the model's table has the entry with this number."""
    functions, _ = model
    return functions[entry] != 0


@part
def begin(model, instant, q, v, times):
    """Store the state at which a step begins; times: as of `prepare`, or None."""
    functions, workspace = model
    return call(functions[table.BEGIN], (workspace, instant, q, v, times))


@part
def residual(model, instant, q, v, a, lam, residual, phi):
    """Fill residual = `M a + g + B^T lam`, and phi."""
    functions, workspace = model
    return call(functions[table.RESIDUAL], (workspace, instant, q, v, a, lam, residual, phi))


@part
def constraints(model, instant, q, dq, dv, phi, rate):
    """Fill phi and its rate at q; by increments, from those at the step's beginning, which they hold, and the changes dq - h v_0 and dv."""
    functions, workspace = model
    return call(functions[table.CONSTRAINTS], (workspace, instant, q, dq, dv, phi, rate))


@part
def rate(model, instant, q, v, out, known):
    """out = B v + phi_t; known: True if B is that of the last `reaction` of this stage."""
    functions, workspace = model
    return call(functions[table.RATE], (workspace, instant, q, v, out, known))


@part
def bias(model, instant, q, v, a, out):
    """out = B a + phi_bias, the second derivative of phi; B is that of the last `reaction`."""
    functions, workspace = model
    return call(functions[table.BIAS], (workspace, instant, q, v, a, out))


@part
def project(model, instant, rows, vector, from_zero):
    """Change a vector x by the least M-norm so that B x falls by rows; from_zero: x becomes the least one with `B x = B x_before - rows`. B: of `rate`."""
    functions, workspace = model
    return call(functions[table.PROJECT], (workspace, instant, rows, vector, from_zero))


@part
def accept(model, instant, q):
    """Status of q: accepted (DONE) or rejected, and why."""
    functions, workspace = model
    return call(functions[table.ACCEPT], (workspace, instant, q))


@part
def acceleration(model, instant, q, v, a, lam):
    """Fill a and lam that are consistent with q and v."""
    functions, workspace = model
    return call(functions[table.ACCELERATION], (workspace, instant, q, v, a, lam))


@part
def factor(model, instant, q, v, a, lam, numbers):
    """Make the step matrix S = numbers[0] M + numbers[1] C + K at a state."""
    functions, workspace = model
    return call(functions[table.FACTOR], (workspace, instant, q, v, a, lam, numbers))


@part
def solve(model, instant, q, lam, residual, phi, dq, dlam):
    """Fill dq and dlam: `S dq + B^T dlam = -residual`, `B dq = -phi`, with S as it was made and B of the last `residual`."""
    functions, workspace = model
    return call(functions[table.SOLVE], (workspace, instant, q, lam, residual, phi, dq, dlam))


@part
def middle(model, instant, states, lam, residual, phi):
    """Fill the residual in the middle of a step of the energy-momentum method, and phi at its end; states: q_0, q_1, and q, v, a of the middle."""
    functions, workspace = model
    return call(functions[table.MIDDLE], (workspace, instant, states, lam, residual, phi))


@part
def begin_strains(model, instant, past, numbers):
    """Begin a step without strains among the unknowns; past: rows q, v, a, a_alg and more; numbers: TO_A to ALG_OF_END of assembly/condensation.py."""
    functions, workspace = model
    return call(functions[table.STRAINS], (workspace, instant, past, 0, 0, numbers))


@part
def end_strains(model, instant, past, now, state, numbers):
    """Fill the strains of the step's end in the rows of state, past ones or others; now: q at the end, past and numbers: as of `begin_strains`."""
    functions, workspace = model
    return call(functions[table.STRAINS], (workspace, instant, past, now, state, numbers))


@part
def prepare(model, instant, times):
    """Take (h, t and the times of the instants) of a step of Radau IIA."""
    functions, workspace = model
    return call(functions[table.PREPARE], (workspace, instant, times))


@part
def reaction(model, instant, q, mu, dv, known):
    """dv += D^-1 B^T mu; known: True if B is that of the last `rows`."""
    functions, workspace = model
    return call(functions[table.REACTION], (workspace, instant, q, mu, dv, known))


@part
def rows(model, instant, q, v, a, known):
    """Compute B and its slopes for the corrections of a step; a: None, or where phi'' is a row. known: True if B is that of `residual`."""
    functions, workspace = model
    return call(functions[table.ROWS], (workspace, instant, q, v, a, known))


@part
def turn(model, instant, residuals, back):
    """Rotate the residuals of the stages into the frame of the middle stage, or corrections back; nothing without frames. No status."""
    functions, workspace = model
    if functions[table.TURN]:
        call(functions[table.TURN], (workspace, instant, residuals, back))


@part
def solve_real(model, instant, residual, closing, lam, dq, multipliers):
    """The correction of the real mode; closing: phi and phi' as rows, lam: that of the middle stage."""
    functions, workspace = model
    return call(functions[table.REAL], (workspace, instant, residual, closing, lam, dq, multipliers))


@part
def solve_pair(model, instant, residual, closing, lam, dq, multipliers):
    """The correction of the complex mode; closing: phi and phi' as rows, lam: that of the middle stage."""
    functions, workspace = model
    return call(functions[table.PAIR], (workspace, instant, residual, closing, lam, dq, multipliers))


@part
def inertia(model, instant, v, a, force, momentum, q, closing):
    """Fill force = `C v + M a`, momentum = `M v` unless it is None, and closing (2, m), unless it is None.

    closing: the blocks of constraint rows of `rows` times v, or B v in place of a second block that is not there.
    """
    functions, workspace = model
    return call(functions[table.INERTIA], (workspace, instant, v, a, force, momentum, q, closing))


@part
def matrices(model, instant, q, v, a, lam, slot, eigenvalues):
    """Make K, C and M of a state, or the factors for the eigenvalues (3,) of both modes; store them under the number of a slot."""
    functions, workspace = model
    return call(functions[table.MATRICES], (workspace, instant, q, v, a, lam, slot, eigenvalues))


@part
def select(model, slot, eigenvalues):
    """Use the matrices of a slot. No status.

    eigenvalues (3,): c of the real mode, real and imaginary part of that of the complex one, 0 without one.
    """
    functions, workspace = model
    if functions[table.SELECT]:
        call(functions[table.SELECT], (workspace, slot, eigenvalues))


@part
def adjoint(model, step, right, below, bar, solution, multipliers, products):
    """Solve the adjoint of a step: fill solution and multipliers, and products of the table's transposed matrices with it (adjoint/tables.py)."""
    functions, workspace = model
    return call(functions[table.ADJOINT], (workspace, step, right, below, bar, solution, multipliers, products))
