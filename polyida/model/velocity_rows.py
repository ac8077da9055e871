"""Users' models with velocity rows `psi(t, q, v) = W(t, q) v + w(t, q) = 0`: psi is added to phi as rows that are not its derivatives."""

from dataclasses import replace

import numpy as np

from polyida.errors import InputError
from polyida.linear.lu import dense
from polyida.model import Model, differences
from polyida.validation import is_whole, reals

OF_ROWS = ("phi", "phi_q", "phi_t", "phi_rate", "phi_bias", "phi_rate_q", "phi_bias_q", "phi_p", "reaction_q", "psi", "psi_v", "p")
NOT_TAKEN = (*OF_ROWS, "needs", "by_numba", "increments", "has_constraint_increments", "mass_system", "step_matrix", "constraint_name")


def with_velocity_rows(user):
    """The model of a user with the rows of psi behind those of phi, in a class of the same name. Raises InputError for wrong sizes."""
    name = type(user).__name__
    if not (is_whole(user.p) and is_whole(getattr(user, "m", None), 0)):
        raise InputError(f"{name}: m = {getattr(user, 'm', None)!r} and p = {user.p!r} must be whole numbers of at least 0")
    if type(user).psi is Model.psi:
        raise InputError(f"{name}: p = {user.p} velocity rows, but its class gives no psi(t, q, v)")
    return type(name, (WithVelocityRows,), {})(user)


class WithVelocityRows(Model):
    """A user's model with m + p rows: in those of psi phi = 0, phi_q = W, phi_t = w, phi_rate = psi. Its other functions are the user's."""

    def __init__(self, user):
        self.own, self.n, self.own_m = user, user.n, int(user.m)
        self.m, self.velocity_rows = self.own_m + int(user.p), np.arange(self.own_m, self.own_m + int(user.p))
        self.needs = replace(user.needs, phi_q_varies=True)
        for name, default in vars(Model).items():
            of_user = getattr(type(user), name) is not default or name in vars(user)
            if of_user and not (name.startswith("_") or name in NOT_TAKEN or isinstance(default, property)):
                setattr(self, name, getattr(user, name))

    def __getattr__(self, name):
        """Further attributes of the user's model."""
        if name == "own":
            raise AttributeError(name)
        return getattr(self.own, name)

    @property
    def switching(self):
        return self.own.switching

    def psi_at(self, t, q, v):
        """psi, (p,). Raises InputError for another shape."""
        values = reals(self.own.psi(t, q, v))
        if values is None or values.shape != self.velocity_rows.shape:
            shape = getattr(values, "shape", "none")
            raise InputError(f"{type(self).__name__}.psi must return an array of shape {self.velocity_rows.shape}, not {shape}")
        return values

    def phi(self, t, q):
        return np.append(self.own.phi(t, q), np.zeros(len(self.velocity_rows)))

    def phi_q(self, t, q):
        if type(self.own).psi_v is not Model.psi_v:
            W = dense(self.own.psi_v(t, q))
        else:  # psi is linear in v
            still = self.psi_at(t, q, np.zeros(self.n))
            W = np.array([self.psi_at(t, q, v) - still for v in np.eye(self.n)]).T
        return np.vstack([dense(self.own.phi_q(t, q)), W])

    def phi_t(self, t, q):
        return np.append(self.own.phi_t(t, q), self.psi_at(t, q, np.zeros(self.n)))

    def phi_rate(self, t, q, v):
        return np.append(self.own.phi_rate(t, q, v), self.psi_at(t, q, v))

    def phi_bias(self, t, q, v):
        reach = differences.reach_along(q, v)
        return np.append(self.own.phi_bias(t, q, v), differences.along(lambda s: self.psi_at(t + s, q + s * v, v), reach, self._smooth(t)))

    def constraint_name(self, row):
        return self.own.constraint_name(row) if row < self.own_m else f"psi[{row - self.own_m}]"
