"""What the compiled steps of generalized-alpha work on: the method's numbers, its memory, the state on trial."""

from typing import NamedTuple

import numpy as np

from polyida.compiled import pack

RATE, AGE, SIZE, CHANGE, AHEAD, BEHIND, MOVED, ERROR, SINCE = range(9)
MARKS = 9
PATIENCE = 6  # steps with a small error before the step grows


@pack
class Method(NamedTuple):
    """Numbers of the method at one h.

    least, most, share: Newton may leave `share` of the change of q'' in the step, within least and most of q'', over
    to_a. extent: of the coordinates, m, whose round-off is that of phi. incremental: carry phi by increments. control:
    |C| h^2 of the local error (0: fixed steps), of which atol + rtol |q| is allowed; grow: the error below which the
    step is too short.
    """

    h: float
    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    to_a: float
    to_v: float
    least: float
    most: float
    share: float
    extent: float
    incremental: bool
    max_iterations: int
    control: float
    rtol: float
    atol: float
    grow: float


@pack
class Memory(NamedTuple):
    """What goes from step to step: states in place, phi and rate = phi_q v + phi_t as they are carried, and `marks`.

    change, earlier: of q'' in the last step and in the one before. weights: of coordinates in the local error.
    RATE: contraction of Newton; AGE of it in steps; SIZE of q'' and CHANGE of it in a step; AHEAD, BEHIND: of change and
    earlier in the prediction; MOVED: the last |dq| of an iteration to go on with (0: a new step); ERROR: largest local
    error of the last SINCE steps.
    """

    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    a_alg: np.ndarray
    change: np.ndarray
    earlier: np.ndarray
    weights: np.ndarray
    lam: np.ndarray
    phi: np.ndarray
    rate: np.ndarray
    marks: np.ndarray


@pack
class Trial(NamedTuple):
    """The state that Newton works on, `u = u_0 + (h v_0 + dd)`, and scratch.

    Of the points: start, vx, ax: dz, velocity and algorithmic acceleration at the last state, dx: A dd, dv: change of
    velocity.
    """

    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    dd: np.ndarray
    r: np.ndarray
    phi: np.ndarray
    rate: np.ndarray
    rotation: np.ndarray
    dz: np.ndarray
    forces: np.ndarray
    start: np.ndarray
    vx: np.ndarray
    ax: np.ndarray
    dx: np.ndarray
    dv: np.ndarray
    dq: np.ndarray
    dlam: np.ndarray


def trial(n_nodes, n_points, m):
    """A Trial of a scene's size."""
    shapes = dict.fromkeys(("lam", "phi", "rate", "dlam"), m)
    shapes |= dict.fromkeys(("dz", "forces", "start", "vx", "ax", "dx", "dv"), (n_points, 2))
    return Trial(*(np.zeros(shapes.get(name, (n_nodes, 2))) for name in Trial._fields))
