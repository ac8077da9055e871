"""What phi of a scene gains in a step, from its drives and from what the step adds to the places of its points."""

import numpy as np

from polyida.assembly.rows import joints

EPS = np.finfo(float).eps
NODES, WEIGHTS = (0.5 * x for x in np.polynomial.legendre.leggauss(4))  # on [-1/2, 1/2]


def drive_table(model, times, ends):
    """Values and two derivatives of every profile at the times, (times, profiles, 3).

    ends: the first and the last time, or one beside it within the steps where there is a kink: loads and all derivatives are of
    that side. What drives phi is continuous.
    """
    table = np.empty((len(times), len(model.profiles), 3))
    if not table.size:
        return table
    driving = _driving(model)
    inner = np.array(times)
    inner[[0, -1]] = ends
    for k, profile in enumerate(model.profiles):
        for order, at in enumerate((times if k in driving else inner, inner, inner)):
            table[:, k, order] = profile.over(at, order)
    return table


def _driving(model):
    """The profiles that drive rows of phi."""
    return {*model.motor_profiles.tolist(), *model.path_profiles.tolist()}


def gain_table(model, times, drives, h):
    """What every profile gains in each step of size h, (steps, profiles, 3): value, value - h rate, rate."""
    return _gains(model, times[:-1], times[1:], drives[:-1], drives[1:], np.full(len(times) - 1, h))


def stage_tables(model, starts, times, edge, h):
    """(drives (k, s + 1, profiles, 3) at the starts (k,) of steps and the times (k, s) of their stages, gains (k, s, profiles, 3) between).

    h (s,): how much later the stages are; edge: the first of the starts, or beside it within the steps where there is a kink.
    """
    at = np.column_stack([starts, times])
    drives = drive_table(model, at.ravel(), (edge, at[-1, -1])).reshape(*at.shape, -1, 3)
    before, after = np.broadcast_to(drives[:, :1], drives[:, 1:].shape), drives[:, 1:]
    flat = (-1, *drives.shape[2:])
    gains = _gains(model, np.repeat(starts, len(h)), times.ravel(), before.reshape(flat), after.reshape(flat), np.tile(h, len(starts)))
    return drives, gains.reshape(after.shape)


def _gains(model, begin, times, before, after, h):
    """Differences; of what drives phi, where the integrals of its second derivative are the same to round-off, those, which are sharper."""
    gains = np.empty(before.shape)
    if not gains.size:
        return gains
    gains[:, :, 0], gains[:, :, 2] = after[:, :, 0] - before[:, :, 0], after[:, :, 1] - before[:, :, 1]
    gains[:, :, 1] = gains[:, :, 0] - h[:, None] * before[:, :, 1]
    for k in _driving(model):
        ends = after[:, k]
        size = np.abs(before[:, k, :2]) + np.abs(ends[:, :2]) + np.abs(times[:, None] * ends[:, 1:])
        lost = np.flatnonzero((np.abs(gains[:, k, ::2]) < 1e-5 * size).any(axis=1))
        if lost.size:
            _sharpen(model.profiles[k], begin[lost], h[lost], before[lost, k, 1], gains[:, k], lost, size[lost])
    return gains


def _sharpen(profile, begin, h, rate, gains, rows, size):
    at = begin[:, None] + h[:, None] * (0.5 + NODES)
    second = profile.over(at, 2)
    change, ahead = h * _sum(second, WEIGHTS), h * h * _sum(second, WEIGHTS * (0.5 - NODES))
    whole = h * rate + ahead
    apart = np.abs(np.stack([whole - gains[rows, 0], change - gains[rows, 2]], axis=1))
    same = (apart <= 16 * EPS * size).all(axis=1)
    gains[rows[same]] = np.stack([whole, ahead, change], axis=1)[same]


def _sum(rows, weights):
    """The weighted sum of each row, the same whatever rows are beside it, which a product of matrices does not promise."""
    return sum(rows[:, k] * weight for k, weight in enumerate(weights))


class Increments:
    """What phi and rate = phi_q v + phi_t of a scene gain in one step of h from (q, v) at t0 to t1, for any dd and dv.

    ends: as of `drive_table`.
    """

    def __init__(self, model, t0, t1, ends, h, q, v):
        times = np.array([t0, t1])
        drives = drive_table(model, times, ends)
        self.model, self.h, self.drives = model, h, drives[0]
        self.gain = gain_table(model, times, drives, h)[0]
        self.dz, self.vz = model.dz(q), model.dz(v)

    def __call__(self, dd, dv, phi, rate):
        """(phi, rate), (m,) each, behind the step, where q moves by h v + dd and v by dv, from those before it."""
        phi, rate, model = phi.copy(), rate.copy(), self.model
        start, step = (self.drives, self.gain, self.h, self.dz, self.vz), (model.dz(dd), model.dz(dv))
        joints.joint_change(model.arrays.links, *start, *step, phi, rate)
        return phi, rate
