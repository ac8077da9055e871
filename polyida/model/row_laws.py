"""Rows that are no equations phi = 0 but have a law, unilateral contact or dry friction; and models in which only some rows are equations.

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
from polyida.model import Model
from polyida.validation import is_number, is_whole, named_keywords

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
        """whole: the model with all rows. rows: numbers of those that are equations."""
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

    def spread(self, lam, width):
        """Return lam (..., m) of the kept rows as multipliers of all rows of the whole model, zero elsewhere."""
        result = np.zeros((*np.shape(lam)[:-1], self.whole.m))
        result[..., self.kept] = lam
        return result

    def potentials(self, q, v=None):
        """Return (potential of loads, strain energy) of the whole model, J; v is passed on if it is given."""
        return self.whole.potentials(q) if v is None else self.whole.potentials(q, v)

    def potential(self, q):
        """Return the potential energy of the whole model at q, J: loads and strain."""
        return float(sum(self.whole.potentials(q)))

    def mass(self, q):
        """Return M of the whole model, (n, n); dense for a small scene."""
        return self.whole.small_mass() if self.small else self.whole.mass(q)

    def force(self, t, q, v):
        """Return the force g of the whole model, (n,)."""
        return self.whole.force(t, q, v)

    def residual(self, t, q, v, a, lam):
        """Return `r = M a + g + phi_q^T lam`, (n,), with lam of the kept rows alone."""
        return self.whole.residual(t, q, v, a, self.spread(lam, self.whole.m))

    def reaction_q(self, t, q, lam):
        """Return d(phi_q^T lam)/dq, (n, n), with lam of the kept rows alone."""
        return self.whole.reaction_q(t, q, self.spread(lam, self.whole.m))

    def tangent(self, t, q, v, a, lam, c_m, c_v, c_q):
        """Return `c_m M + c_v dr/dv + c_q dr/dq` of the kept rows, (n, n); dense for a small scene."""
        if not self.small:
            return self.whole.tangent(t, q, v, a, self.spread(lam, self.whole.m), c_m, c_v, c_q)
        rates = c_v * dense(self.force_v(t, q, v)) if c_v and self.needs.velocity_forces else 0.0
        return c_m * self.mass(q) + rates + (c_q * self.whole.small_tangent(t, q, v, self.spread(lam, self.whole.m)) if c_q else 0.0)

    def phi(self, t, q):
        """Return phi of the kept rows, (m,)."""
        return self.whole.phi(t, q)[self.kept]

    def phi_q(self, t, q):
        """Return phi_q of the kept rows, (m, n)."""
        return self.phi_q_of_whole(t, q)[self.kept]

    def phi_q_of_whole(self, t, q):
        """phi_q of the whole model, with all rows, dense for a small scene."""
        return (self.whole.small_phi_q if self.small else self.whole.phi_q)(t, q)

    def phi_t(self, t, q):
        """Return phi_t of the kept rows, (m,)."""
        return self.whole.phi_t(t, q)[self.kept]

    def phi_rate(self, t, q, v):
        """Return `phi_q v + phi_t` of the kept rows, (m,)."""
        return self.whole.phi_rate(t, q, v)[self.kept]

    def phi_bias(self, t, q, v):
        """Return phi_bias of the kept rows, (m,)."""
        return self.whole.phi_bias(t, q, v)[self.kept]

    def constraint_name(self, row):
        """Return the name of a kept row for messages."""
        return self.whole.constraint_name(int(self.kept[row]))


def pressing(model, laws):
    """(m, laws): 1 for the rows of a model that press the rows with these laws, else 0."""
    result = np.zeros((model.m, len(laws)))
    for k, law in enumerate(laws):
        result[list(law.on), k] = 1.0
    return result


class Slipping:
    """Mixed into a model in which rows of friction slip: each acts with `lam = sign (c + mu |lam_on|)`.

    On a contact it is `sign (c - mu lam_on)`, which is smooth where the contact begins to pull, so that its end can be located. origin: the model
    with all rows, of which `columns` are equations. slips: (RowLaw, sign of its rate) each.
    """

    def use_slips(self, origin, slips):
        """Set the model of all rows and its slips, and the numbers of their laws that forces need."""
        self.origin, self.slips, contacts = origin, slips, [law.row for law in origin.row_laws if law.is_contact]
        self.on_contact = [len(law.on) == 1 and law.on[0] in contacts for law, _ in slips]
        self.rubbing = [law.row for law, _ in slips]
        self.constant, self.slope = np.array([(sign * law.constant, sign * law.mu) for law, sign in slips]).T
        self.presses = pressing(origin, [law for law, _ in slips])
        self.last_masses = None  # its SlippingMasses are asked for several times at one position

    def pressures(self, lam, presses):
        """(|lam_on| (k,) of the slips, its slopes by lam (k, m)) at lam (m,); signed on a contact. presses (m, k): 1 if a row presses."""
        sizes = np.where(self.on_contact, 1.0, np.sqrt(lam**2 @ presses))
        shares = np.where(self.on_contact, -1.0, lam[:, None] / np.where(sizes > 0.0, sizes, 1.0)) * presses
        return np.where(self.on_contact, -(lam @ presses), sizes), shares.T

    def spread(self, lam, width):
        """Return multipliers of all rows of `origin`, (..., m), with the friction of the rows that slip."""
        return self.forces_of_all(lam)

    def forces_of_all(self, lam):
        """lam of all rows of `origin`, (..., m), from lam of its equations; friction that slips has its force, other rows are zero."""
        result = np.zeros((*np.shape(lam)[:-1], self.origin.m))
        result[..., self.columns] = lam
        pressures = np.where(self.on_contact, -(result @ self.presses), np.sqrt(result**2 @ self.presses))
        result[..., self.rubbing] = self.constant + self.slope * pressures
        return result

    def columns_of_forces(self, t, q, lam):
        """The rows of phi_q, with the friction that grows with their multipliers."""
        B = dense(self.origin.phi_q(t, q))
        shares = self.slope[:, None] * self.pressures(self.forces_of_all(lam), self.presses)[1]
        return B[self.columns] + shares[:, self.columns].T @ B[self.rubbing]

    def mass_system(self, t, q):
        """Return the SlippingMasses at (t, q); the last one is kept, as it is asked for several times."""
        if self.last_masses is None or self.last_masses.t != t or not np.array_equal(self.last_masses.q, q):
            self.last_masses = SlippingMasses(self, super().mass_system(t, q), t, q)
        return self.last_masses

    def uniqueness(self, state, lam):
        """What is positive while the friction has a unique force at a state if rows press in the direction of lam, 1 where friction is small.

        It is the determinant of its matrix. Rows of equations may also press in the other direction. If their force has no solution there, it
        ends where they do not press any more, and the share of lam that presses without friction may be the smaller number.
        """
        masses = self.mass_system(state.t, state.q)
        least = masses.determinant(lam)
        if all(self.on_contact) or masses.determinant(-lam) > 0.0:
            return least
        return min([least, *self._along(self._consistent(state, masses.system), lam)])

    def contraction(self, t, q):
        """The most by which friction answers a change of itself, through what presses it; below 1 its force is unique in any direction."""
        masses = self.mass_system(t, q)
        sizes = np.sqrt(masses.presses.T @ masses.Y**2).sum(axis=1)
        return float((np.abs(self.slope) * sizes).max(initial=0.0))

    def _consistent(self, state, masses):
        """Consistent multipliers at a state, of a system of masses with or without friction."""
        return masses.solve(self.force(state.t, state.q, state.v), self.phi_bias(state.t, state.q, state.v))[1]

    def _along(self, lam, other):
        """The parts of lam along others, for each of the rows that press."""
        on = [np.isin(self.columns, law.on) for law, _ in self.slips]
        return [float(lam[rows] @ other[rows] / square) for rows in on if (square := other[rows] @ other[rows])]

    def agrees(self, state):
        """True if the rows that press do so in the direction of the consistent forces at a state."""
        return min(self._along(self._consistent(state, self.mass_system(state.t, state.q)), state.lam), default=1.0) > 0.0

    def pressed(self, state, lam):
        """True if all rows that press do so in the direction of lam at a state, too, or would if friction were small."""
        return min(self._along(self._consistent(state, self.mass_system(state.t, state.q).system), lam), default=1.0) > 0.0

    def rubbing_rows(self, t, q):
        """The rows of phi_q of the friction that slips, (k, n)."""
        origin = self.origin
        return origin.phi_q_rows(t, q, self.rubbing) if origin.is_scene else dense(origin.phi_q(t, q)[self.rubbing])

    def singular(self):
        """The SingularSystem of friction without a unique force."""
        names = ", ".join(dict.fromkeys(repr(law.name) for law, _ in self.slips))
        why = "its friction has no unique force, and only time stepping, polyida.NonsmoothAlpha(h=...), goes on"
        return SingularSystem(f"the matrix of the slip of {names} is singular: {why}")


class Slips(Slipping, WithRows):
    """A model of which only some rows of phi are equations, and in which rows of friction slip."""

    def __init__(self, whole, rows, slips):
        """Take the model with all rows, the numbers of its equations, and (its RowLaw, sign of its rate) of each friction that slips."""
        super().__init__(whole, rows)
        self.use_slips(whole, slips)

    def force(self, t, q, v):
        """Return g with the constant part of the friction that slips, (n,)."""
        force = self.whole.force(t, q, v)
        for law, sign in self.slips:
            if law.constant:
                force = force + sign * law.constant * dense(self.phi_q_of_whole(t, q)[[law.row]])[0]
        return force


class SlippingMasses:
    """The system of M and phi_q with friction that is proportional to the multipliers, `f = sign mu |lam_on|`, lam linear in f: Newton's method.

    system: the same without friction.
    """

    def __init__(self, model, system, t, q):
        """Take the system without friction at (t, q), and solve it for unit forces along each row that slips."""
        self.model, self.system, self.t, self.q = model, system, t, np.array(q)
        rows, self.presses = model.rubbing_rows(t, q), model.presses[model.columns]
        self.X, self.Y = system.solve(rows.T, np.zeros((model.m, len(rows))))

    def slope(self, shares):
        """d(f - mu |lam_on|)/df at lam = dlam + Y f; shares: slopes of |lam_on| by lam."""
        return np.eye(len(shares)) - self.model.slope[:, None] * (shares @ self.Y)

    def determinant(self, lam):
        """Determinant of `slope` at multipliers lam (m,)."""
        return float(np.linalg.det(self.slope(self.model.pressures(lam, self.presses)[1])))

    def solve(self, r, phi):
        """(dq, dlam). Raises SingularSystem if friction alone could hold the motion: no unique force."""
        dq, dlam = self.system.solve(r, phi)
        f = np.zeros(len(self.model.slope))
        for _ in range(MOST):
            lam = dlam + self.Y @ f
            sizes, shares = self.model.pressures(lam, self.presses)
            error = f - self.model.slope * sizes
            if np.abs(error).max() <= 1e-14 * max(np.abs(f).max(), np.abs(f - error).max()):
                return dq + self.X @ f, lam
            try:
                f = f - np.linalg.solve(self.slope(shares), error)
            except np.linalg.LinAlgError:
                break
        if not r.any():  # a projection of positions or velocities, which needs no friction
            return dq, dlam
        raise self.model.singular()
