"""Constraints carried along by their increments: `phi_{n+1} = phi_n + D`, and with them `rate = phi_q v + phi_t`.

phi taken from positions has a round-off of eps |q|, which a step divides by beta h^2: at h = 1e-9 accelerations are
noise. What a step adds is known to a round-off of its own size; and since its first-order part is h rate, to one of
h^2 q'' where rate is carried too.
"""

import numpy as np

from polyida.assembly import joints
from polyida.integrate.kinks import at_kink, beside

EPS = np.finfo(float).eps
NODES, WEIGHTS = (0.5 * x for x in np.polynomial.legendre.leggauss(4))  # on [-1/2, 1/2]


def drive_table(model, times, h):
    """Values and two derivatives of every profile at the times, (times, profiles, 3).

    At a kink at either end loads and all derivatives are those of the inner side. A motor's angle is continuous.
    """
    links = model.arrays.links
    motors = set(links.product_drive.tolist())
    table = np.empty((len(times), len(model.profiles), 3))
    if not table.size:
        return table
    inner = np.array(times)
    inner[0], inner[-1] = inner_side(model, times[0], -h), inner_side(model, times[-1], h)
    for k, profile in enumerate(model.profiles):
        value = (profile.value, times if k in motors else inner)
        for column, (function, at) in enumerate((value, (profile.d1, inner), (profile.d2, inner))):
            table[:, k, column] = function(at) if profile.formula else [function(t) for t in at]
    return table


def inner_side(model, t, h):
    """t, or next to it where there is a kink: before it where a step of h > 0 ends there."""
    return beside(t, -h) if at_kink(model, t) else t


def gain_table(model, times, drives, h):
    """What every profile gains in each step of size h, (steps, profiles, 3): value, value - h rate, rate.

    Differences; of a motor, where the integrals of its second derivative are the same to round-off, those, which are
    sharper.
    """
    links, before, after = model.arrays.links, drives[:-1], drives[1:]
    gains = np.empty(before.shape)
    gains[:, :, 0], gains[:, :, 2] = after[:, :, 0] - before[:, :, 0], after[:, :, 1] - before[:, :, 1]
    gains[:, :, 1] = gains[:, :, 0] - h * before[:, :, 1]
    for k in np.unique(links.product_drive[links.product_drive >= 0]):
        t, ends = times[1:], after[:, k]
        size = np.abs(before[:, k, :2]) + np.abs(ends[:, :2]) + np.abs(t[:, None] * ends[:, 1:])
        lost = np.flatnonzero((np.abs(gains[:, k, ::2]) < 1e-5 * size).any(axis=1))
        if lost.size:
            _sharpen(model.profiles[k], times[:-1][lost], h, before[lost, k, 1], gains[:, k], lost, size[lost])
    return gains


def _sharpen(profile, begin, h, rate, gains, rows, size):
    at = begin[:, None] + h * (0.5 + NODES)
    second = profile.d2(at) if profile.formula else np.array([[profile.d2(t) for t in row] for row in at])
    second = np.broadcast_to(second, at.shape)
    change, ahead = h * (second @ WEIGHTS), h * h * (second @ (WEIGHTS * (0.5 - NODES)))
    whole = h * rate + ahead
    apart = np.abs(np.stack([whole - gains[rows, 0], change - gains[rows, 2]], axis=1))
    same = (apart <= 16 * EPS * size).all(axis=1)
    gains[rows[same]] = np.stack([whole, ahead, change], axis=1)[same]


def start_values(model, state, t=None):
    """(phi, rate) at the start of a run: as the state carries them, or evaluated, and zero for mere round-off.

    t: the time for rate, to one side of a kink.
    """
    if "phi" in state.memory and "rate" in state.memory:
        return np.array(state.memory["phi"], float), np.array(state.memory["rate"], float)
    phi = np.array(model.phi(state.t, state.q), float)
    phi = np.where(np.abs(phi) > 64 * EPS * extent(model, state.q), phi, 0.0)
    return phi, velocity_rate(model, state.t if t is None else t, state.q, state.v)


def velocity_rate(model, t, q, v):
    """phi_q v + phi_t, zero where it is nothing but round-off."""
    if not model.m:
        return np.zeros(0)
    phi_t, phi_q = model.phi_t(t, q), model.phi_q(t, q)
    rate = phi_q @ v + phi_t
    size = abs(phi_q.copy()) @ np.abs(v) + np.abs(phi_t)  # abs sorts a sparse matrix in place
    return np.where(np.abs(rate) > 64 * EPS * size, rate, 0.0)


def extent(model, q):
    """Size of the numbers that phi is made of, m: displacements, and distances within the model, wherever it lies."""
    return (model.extent or 1.0) + float(np.abs(q).max(initial=0.0))


class Carried:
    """phi and rate of a scene over one step, for the plain path: for any dd, with `q_1 = q_0 + h v_0 + dd`."""

    def __init__(self, model, t0, t1, h, state, phi, rate):
        times = np.array([t0, t1])
        drives = drive_table(model, times, h)
        self.model, self.h, self.phi, self.rate, self.drives = model, h, phi, rate, drives[0]
        self.gain = gain_table(model, times, drives, h)[0]
        self.dz, self.vz = model.dz(state.q), model.dz(state.v)

    def __call__(self, dd, dv):
        """(phi, rate) at the end of the step, velocities changed by dv."""
        phi, rate, model = self.phi.copy(), self.rate.copy(), self.model
        start, step = (self.drives, self.gain, self.h, self.dz, self.vz), (model.dz(dd), model.dz(dv))
        joints.joint_change(model.arrays.links, *start, *step, phi, rate)
        return phi, rate
