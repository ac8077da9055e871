"""Velocity rows `psi(t, q, v) = W(t, q) v + w(t, q) = 0` of a user's model as rows behind those of phi."""

import numpy as np

from polyida.errors import InputError
from polyida.linear.lu import dense
from polyida.model import Model, differences
from polyida.model.functions import writes
from polyida.validation import is_whole, reals

WITHOUT_ROWS = {  # functions of a user that are not asked beside velocity rows: they know nothing of these
    "phi", "phi_q", "phi_t", "phi_rate", "phi_bias", "phi_rate_q", "phi_bias_q", "phi_p", "reaction_q", "psi", "psi_v",
    "increments", "mass_system", "step_matrix", "constraint_name",
}  # fmt: skip


class VelocityRows:
    """phi of a user's model and behind it psi: in the rows of psi phi = 0, phi_q = W, phi_t = w, phi_rate = psi.

    holonomic, count: numbers of rows of phi and of psi. functions: {name: function} of all rows. Raises InputError for wrong numbers, and if
    the class gives no psi.
    """

    def __init__(self, user):
        """user: a model with p > 0 velocity rows."""
        self.user, name = user, type(user).__name__
        if not (is_whole(user.p) and is_whole(getattr(user, "m", None), 0)):
            raise InputError(f"{name}: m = {getattr(user, 'm', None)!r} and p = {user.p!r} must be whole numbers of at least 0")
        if type(user).psi is Model.psi:
            raise InputError(f"{name}: p = {user.p} velocity rows, but its class gives no psi(t, q, v)")
        self.holonomic, self.count = int(user.m), int(user.p)
        self.functions = {name: getattr(self, name) for name in ("phi", "phi_q", "phi_t", "phi_rate", "phi_bias")}

    def psi_at(self, t, q, v):
        """psi, (p,). Raises InputError for another shape."""
        values = reals(self.user.psi(t, q, v))
        if values is None or values.shape != (self.count,):
            shape = getattr(values, "shape", "none")
            raise InputError(f"{type(self.user).__name__}.psi must return an array of shape {(self.count,)}, not {shape}")
        return values

    def phi(self, t, q):
        """phi of the user, and zeros for the velocity rows, (m + p,)."""
        return np.append(self.user.phi(t, q), np.zeros(self.count))

    def phi_q(self, t, q):
        """phi_q and W, (m + p, n); W by psi_v, or by values of psi, which is linear in v."""
        if writes(self.user, "psi_v"):
            W = dense(self.user.psi_v(t, q))
        else:
            still = self.psi_at(t, q, np.zeros(self.user.n))
            W = np.array([self.psi_at(t, q, v) - still for v in np.eye(self.user.n)]).T
        return np.vstack([dense(self.user.phi_q(t, q)), W])

    def phi_t(self, t, q):
        """phi_t of the user, and w = psi at v = 0, (m + p,)."""
        return np.append(self.user.phi_t(t, q), self.psi_at(t, q, np.zeros(self.user.n)))

    def phi_rate(self, t, q, v):
        """The rate of phi, and psi, (m + p,)."""
        return np.append(self.user.phi_rate(t, q, v), self.psi_at(t, q, v))

    def phi_bias(self, t, q, v):
        """phi_bias, and the rate of psi at constant v, (m + p,)."""
        along = lambda s: self.psi_at(t + s, q + s * v, v)  # noqa: E731
        bias = differences.along(along, differences.reach_along(q, v), self.user._smooth(t))
        return np.append(self.user.phi_bias(t, q, v), bias)

    def constraint_name(self, row):
        """Name of a row in messages: the user's, or "psi[0]" of the first row of psi."""
        return self.user.constraint_name(row) if row < self.holonomic else f"psi[{row - self.holonomic}]"
