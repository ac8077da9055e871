"""Rows that are no equations phi = 0: unilateral contact, dry friction and velocity rows; and models in which only some rows are equations.

Velocity rows `psi(t, q, v) = W(t, q) v + w(t, q) = 0` of a user's model are added to phi as rows that are not its derivatives. Other rows have
a law:

| law | closing equation | at an impact, with the impulse Lam |
|---|---|---|
| contact | `0 <= -lam, phi >= 0, lam phi = 0` | `0 <= -Lam, rate + e rate_before >= 0`, their product 0 |
| friction | `|lam| <= c + mu |lam_on|`; sticks: rate = 0; slips: `lam = sign(rate) (c + mu |lam_on|)` | the same with Lam |

r is that of all rows. Moreau, in Nonsmooth Mechanics and Applications (1988) 1-82; Acary, Brogliato, Numerical Methods for Nonsmooth Dynamical
Systems (2008).
"""

from dataclasses import dataclass, replace

import numpy as np

from polyida.errors import InputError
from polyida.linear.lu import SingularSystem, dense
from polyida.model import Model, differences
from polyida.validation import is_number, is_whole, named_keywords, reals

TAKEN = (  # attributes and functions with defaults that a model of some rows takes from the whole one
    "extent", "reference", "free_fall", "flexible", "uniform_units", "state_columns", "state_units", "state_start", "state_speed", "named_profiles",
    "motor_profiles", "path_profiles", "force_q", "force_v", "mass_a_q", "initial_velocity", "rejection_reason", "kinks", "samples", "sampled",
)  # fmt: skip
MOST = 30  # iterations for the force of friction that depends on multipliers


@named_keywords
@dataclass(frozen=True)
class RowLaw:
    """The law of a row of phi or psi, in place of the equation: contact if restitution is a number, else dry friction.

    Contact: `0 <= -lam`, `phi >= 0`, `lam phi = 0`. Friction: `|lam| <= constant + mu |lam_on|`, with equality where the row slips. For
    `row_laws` of users' models, as in `(pi.RowLaw(0, restitution=0.8), pi.RowLaw(1, mu=0.3, on=(0,)))`.

    Parameters
    ----------
    row : int
        Number of the row; those of psi are behind those of phi.
    name : str
        In messages and in `run.events`.
    restitution : float, optional
        e in [0, 1] of impacts: `phi' = -e phi'` of before.
    mu : float
        Friction coefficient, mu >= 0.
    constant : float
        Friction without pressure, >= 0.
    on : tuple of int
        Rows that press; |lam_on| is the root of the sum of their squares.
    """

    row: int
    name: str = ""
    restitution: float | None = None
    mu: float = 0.0
    constant: float = 0.0
    on: tuple[int, ...] = ()

    @property
    def is_contact(self) -> bool:
        """True for contact, False for friction."""
        return self.restitution is not None


def require_laws(name, laws, m, velocity_rows):
    """The laws of a user's model as a tuple, with names. Raises InputError."""
    rows = set()
    if not isinstance(laws, (tuple, list)):
        raise InputError(f"{name}: row_laws = {laws!r:.60} must be a tuple of polyida.RowLaw")
    for number, law in enumerate(laws):
        what = f"{name}: row_laws[{number}]"
        if not isinstance(law, RowLaw):
            raise InputError(f"{what} = {law!r:.100} must be a polyida.RowLaw")
        for row in (law.row, *law.on):
            if not (is_whole(row, 0) and row < m):
                raise InputError(f"{what}: {row!r} is no row; there are {m} rows of phi and psi, counted from 0")
        if law.row in rows:
            raise InputError(f"{what}: row {law.row} has two laws")
        rows.add(law.row)
        if law.is_contact and not (is_number(law.restitution) and 0.0 <= law.restitution <= 1.0):
            raise InputError(f"{what}: restitution = {law.restitution!r:.60} must be a number in [0, 1]")
        for key in ("mu", "constant"):
            if not (is_number(getattr(law, key)) and getattr(law, key) >= 0.0):
                raise InputError(f"{what}: {key} = {getattr(law, key)!r:.60} must be a number of at least 0")
        if not law.is_contact and law.row not in velocity_rows:
            raise InputError(
                f"{what}: row {law.row} of friction must be a row of psi, its slip velocity; rows of psi are behind those of phi"
            )
        if law.is_contact and law.row in velocity_rows:
            raise InputError(f"{what}: row {law.row} of contact must be a row of phi, its gap, not of psi")
        if law.mu and not law.on:
            raise InputError(f"{what}: mu = {law.mu:g} needs the rows that press, for example on=(0,)")
    return tuple(replace(law, name=law.name or f"row {law.row}") for law in laws)


def require_no_laws(part, model, why):
    """Raise InputError, naming the parts, for a model with rows of contact or friction."""
    if model.row_laws:
        names = ", ".join(dict.fromkeys(repr(law.name) for law in model.row_laws))
        raise InputError(f"{part}: contact and friction of {names} are no equations; {why}")


def violation(model, values):
    """(m,) of what violates phi = 0 and the gaps' phi >= 0, from phi of all rows."""
    gaps = [law.row for law in model.row_laws if law.is_contact]
    if gaps:
        values = np.array(values)
        values[gaps] = np.minimum(values[gaps], 0.0)
    return values


class WithRows(Model):
    """A model of which only some rows of phi are equations; the others are left out."""

    checked = True

    def __init__(self, whole, rows):
        self.whole, self.kept = whole, np.asarray(rows, np.int64)
        self.n, self.m, self.k, self.needs = whole.n, len(self.kept), whole.k, whole.needs
        self.velocity_rows = np.flatnonzero(np.isin(self.kept, whole.velocity_rows))
        self.columns, self.small = self.kept, whole.is_scene and whole.small  # small: True if matrices are dense
        for name in TAKEN:
            setattr(self, name, getattr(whole, name))

    def __getattr__(self, name):
        """Further attributes of the whole model."""
        if name == "whole":
            raise AttributeError(name)
        return getattr(self.whole, name)

    def _all(self, lam):
        result = np.zeros(self.whole.m)
        result[self.kept] = lam
        return result

    def spread(self, lam, width):
        return self._all(lam)

    def potentials(self, q, v=None):
        return self.whole.potentials(q) if v is None else self.whole.potentials(q, v)

    def potential(self, q):
        return float(sum(self.whole.potentials(q)))

    def mass(self, q):
        return self.whole.small_mass() if self.small else self.whole.mass(q)

    def force(self, t, q, v):
        return self.whole.force(t, q, v)

    def residual(self, t, q, v, a, lam):
        return self.whole.residual(t, q, v, a, self._all(lam))

    def reaction_q(self, t, q, lam):
        return self.whole.reaction_q(t, q, self._all(lam))

    def tangent(self, t, q, v, a, lam, c_m, c_v, c_q):
        if not self.small:
            return self.whole.tangent(t, q, v, a, self._all(lam), c_m, c_v, c_q)
        rates = c_v * dense(self.force_v(t, q, v)) if c_v and self.needs.velocity_forces else 0.0
        return c_m * self.mass(q) + rates + (c_q * self.whole.small_tangent(t, q, v, self._all(lam)) if c_q else 0.0)

    def phi(self, t, q):
        return self.whole.phi(t, q)[self.kept]

    def phi_q(self, t, q):
        return self.phi_q_of_whole(t, q)[self.kept]

    def phi_q_of_whole(self, t, q):
        """phi_q with all rows."""
        return (self.whole.small_phi_q if self.small else self.whole.phi_q)(t, q)

    def phi_t(self, t, q):
        return self.whole.phi_t(t, q)[self.kept]

    def phi_rate(self, t, q, v):
        return self.whole.phi_rate(t, q, v)[self.kept]

    def phi_bias(self, t, q, v):
        return self.whole.phi_bias(t, q, v)[self.kept]

    def constraint_name(self, row):
        return self.whole.constraint_name(int(self.kept[row]))


class Slips(WithRows):
    """The same, with rows of friction that slip: each acts with `lam = sign (c + mu |lam_on|)`. slips: (RowLaw, sign of its rate) each.

    On a contact it is `sign (c - mu lam_on)`, which is smooth where the contact begins to pull, so that its end can be located.
    """

    def __init__(self, whole, rows, slips):
        super().__init__(whole, rows)
        self.slips, contacts = slips, [law.row for law in whole.row_laws if law.is_contact]
        self.on_contact = [len(law.on) == 1 and law.on[0] in contacts for law, _ in slips]

    def pressures(self, lam, rows):
        """(|lam_on| of each slip, its slopes by lam_on) at multipliers of which `rows` press, a list each; those of a contact have signs."""
        for on, on_contact in zip(rows, self.on_contact):
            size = np.linalg.norm(lam[on])
            if on_contact:
                yield -lam[on].sum(), -np.ones(len(on))
            else:
                yield size, lam[on] / size if size else np.zeros(len(on))

    def _all(self, lam):
        result = super()._all(lam)
        pressures = self.pressures(result, [list(law.on) for law, _ in self.slips])
        for (law, sign), (pressure, _) in zip(self.slips, pressures):
            result[law.row] = sign * (law.constant + law.mu * pressure)
        return result

    def force(self, t, q, v):
        force = self.whole.force(t, q, v)
        for law, sign in self.slips:
            if law.constant:
                force = force + sign * law.constant * dense(self.phi_q_of_whole(t, q)[[law.row]])[0]
        return force

    def columns_of_forces(self, t, q, lam):
        """The rows of phi_q, with the friction that grows with their multipliers."""
        B, forces = dense(self.phi_q_of_whole(t, q)), self._all(lam)
        columns = B[self.kept]
        pressures = self.pressures(forces, [list(law.on) for law, _ in self.slips])
        for (law, sign), (_, slopes) in zip(self.slips, pressures):
            shares = np.zeros(self.whole.m)
            shares[list(law.on)] = slopes
            columns = columns + sign * law.mu * shares[self.kept][:, None] * B[law.row]
        return columns

    def uniqueness(self, state, lam):
        """What is positive while the friction has a unique force at a state if rows press in the direction of lam, 1 where friction is small.

        It is the determinant of its matrix. Rows of equations may also press in the other direction. If their force has no solution there, it
        ends where they do not press any more, and the share of lam that presses without friction may be the smaller number.
        """
        masses = SlippingMasses(self, state.t, state.q)
        least = float(np.linalg.det(masses.slope(lam)))
        if all(self.on_contact) or np.linalg.det(masses.slope(-lam)) > 0.0:
            return least
        return min([least, *self._along(self._consistent(state, masses.system), lam)])

    def _consistent(self, state, masses):
        """Consistent multipliers at a state, of a system of masses with or without friction."""
        return masses.solve(self.whole.force(state.t, state.q, state.v), self.phi_bias(state.t, state.q, state.v))[1]

    def _along(self, lam, other):
        """The parts of lam along others, for each of the rows that press."""
        on = [np.isin(self.kept, law.on) for law, _ in self.slips]
        return [float(lam[rows] @ other[rows] / square) for rows in on if (square := other[rows] @ other[rows])]

    def agrees(self, state):
        """True if the rows that press do so in the direction of the consistent forces at a state."""
        return min(self._along(self._consistent(state, self.mass_system(state.t, state.q)), state.lam), default=1.0) > 0.0

    def pressed(self, state, lam):
        """True if all rows that press do so in the direction of lam at a state, too, or would if friction were small."""
        return min(self._along(self._consistent(state, super().mass_system(state.t, state.q)), lam), default=1.0) > 0.0

    def singular(self):
        """The SingularSystem of friction without a unique force."""
        names = ", ".join(dict.fromkeys(repr(law.name) for law, _ in self.slips))
        why = "its friction has no unique force, and only time stepping, polyida.NonsmoothAlpha(h=...), goes on"
        return SingularSystem(f"the matrix of the slip of {names} is singular: {why}")

    def mass_system(self, t, q):
        return SlippingMasses(self, t, q)


class SlippingMasses:
    """The system of M and phi_q with friction that is proportional to the multipliers, `f = sign mu |lam_on|`, lam linear in f: Newton's method."""

    def __init__(self, model, t, q):
        self.model, self.system = model, super(Slips, model).mass_system(t, q)
        rows, none = dense(model.phi_q_of_whole(t, q)[[law.row for law, _ in model.slips]]), np.zeros(model.m)
        solved = [self.system.solve(row, none) for row in rows]
        self.X, self.Y = (np.array(part).T for part in zip(*solved))
        place = {int(row): k for k, row in enumerate(model.kept)}
        self.on = [[place[row] for row in law.on if row in place] for law, _ in model.slips]
        self.mu = np.array([sign * law.mu for law, sign in model.slips])

    def slope(self, lam):
        """d(f - mu |lam_on|)/df at lam = dlam + Y f."""
        slopes = [slope @ self.Y[on] for on, (_, slope) in zip(self.on, self.model.pressures(lam, self.on))]
        return np.eye(len(self.on)) - self.mu[:, None] * np.array(slopes)

    def solve(self, r, phi):
        """(dq, dlam). Raises SingularSystem if friction alone could hold the motion: no unique force."""
        dq, dlam = self.system.solve(r, phi)
        f = np.zeros(len(self.on))
        for _ in range(MOST):
            lam = dlam + self.Y @ f
            error = f - self.mu * np.array([size for size, _ in self.model.pressures(lam, self.on)])
            if np.abs(error).max() <= 1e-14 * max(np.abs(f).max(), np.abs(f - error).max()):
                return dq + self.X @ f, lam
            try:
                f = f - np.linalg.solve(self.slope(lam), error)
            except np.linalg.LinAlgError:
                break
        if not r.any():  # a projection of positions or velocities, which needs no friction
            return dq, dlam
        raise self.model.singular()


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
