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

COPIED = (  # attributes that a model of some rows has from the whole one, because Model has defaults of them
    "extent", "reference", "free_fall", "flexible", "uniform_units", "state_columns", "state_units", "state_start", "state_speed",
    "named_profiles", "motor_profiles", "path_profiles",
)  # fmt: skip
INDEPENDENT_OF_ROWS = (  # functions of Model, taken from the whole model
    "force_q", "force_v", "mass_a_q", "initial_velocity", "rejection_reason", "kinks", "samples", "sampled",
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
    """Return what violates phi = 0 and the gaps' phi >= 0, (m,): phi of all rows, of gaps its negative part."""
    gaps = [law.row for law in model.row_laws if law.is_contact]
    if gaps:
        values = np.array(values)
        values[gaps] = np.minimum(values[gaps], 0.0)
    return values


class WithRows(Model):
    """A model of which only some rows of phi are equations; the others are left out.

    whole: the model with all rows. kept (m,): the numbers of the rows that are equations. small: True if matrices are dense, of a small scene.
    """

    checked = True

    def __init__(self, whole, rows):
        """whole: the model with all rows. rows: numbers of those that are equations."""
        self.whole = whole
        self.kept = np.asarray(rows, np.int64)
        self.columns = self.kept
        self.n = whole.n
        self.m = len(self.kept)
        self.k = whole.k
        self.needs = whole.needs
        self.velocity_rows = np.flatnonzero(np.isin(self.kept, whole.velocity_rows))
        self.small = whole.is_scene and whole.small
        for name in (*COPIED, *INDEPENDENT_OF_ROWS):
            setattr(self, name, getattr(whole, name))

    def __getattr__(self, name):
        """Any other attribute is that of the whole model."""
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
    """Mixed into a model in which rows of friction slip: their forces follow from the multipliers of the rows that press.

    Friction of slip i of k is `f_i = s_i (c_i + mu_i |lam_on,i|)`, s_i the sign of the slip rate. On a contact it is `s_i (c_i - mu_i lam_on,i)`,
    which is smooth where the contact begins to pull, so that its end can be located. The multipliers of the equations are
    `lam = lam_0 + Y f`, lam_0 those without friction, so that f solves `f - s mu |lam_0 + Y f| = s c`. The solution is unique while the
    determinant of `D = I - s mu (d|lam_on|/dlam) Y` is positive.
    """

    def use_slips(self, origin, slips):
        """Set the model of all rows and its slips, and the numbers of their laws that forces need."""
        self.origin = origin  # the model with all rows, of which `columns` are equations
        self.slips = slips  # [(RowLaw, sign of its rate)]
        contacts = [law.row for law in origin.row_laws if law.is_contact]
        # (k,): True if a contact presses
        self.on_contact = [len(law.on) == 1 and law.on[0] in contacts for law, _ in slips]
        self.slipping_rows = [law.row for law, _ in slips]  # (k,), numbers among the rows of origin
        # s c and s mu, (k,) each
        self.signed_constant, self.signed_mu = np.array([(sign * law.constant, sign * law.mu) for law, sign in slips]).T
        self.presses = pressing(origin, [law for law, _ in slips])  # (rows of origin, k), 1 for the rows that press a slip
        self.last_masses = None  # the last SlippingMasses: several are asked for at one position

    def pressures(self, lam, presses):
        """(|lam_on| (k,) of the slips, its slopes by lam (k, m)) at multipliers, (m,); those of a contact have signs.

        presses (m, k): 1 for the rows that press a slip, as of `pressing`.
        """
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
        result[..., self.slipping_rows] = self.signed_constant + self.signed_mu * pressures
        return result

    def columns_of_forces(self, t, q, lam):
        """Return (dr/dlam)^T, (m, n): the rows of phi_q, with the friction that grows with their multipliers."""
        B = dense(self.origin.phi_q(t, q))
        shares = self.signed_mu[:, None] * self.pressures(self.forces_of_all(lam), self.presses)[1]
        return B[self.columns] + shares[:, self.columns].T @ B[self.slipping_rows]

    def mass_system(self, t, q):
        """Return the SlippingMasses at (t, q); the last one is kept, as it is asked for several times."""
        if self.last_masses is None or self.last_masses.t != t or not np.array_equal(self.last_masses.q, q):
            self.last_masses = SlippingMasses(self, super().mass_system(t, q), t, q)
        return self.last_masses

    def uniqueness(self, state, lam):
        """Return det D at the multipliers lam (m,), at the position of a state; it is positive while the friction has a unique force.

        If the rows that press are not all contacts and det D at -lam is not positive, return the smallest of that and, of each slip,
        `lam_0 . lam / (lam . lam)` on the rows that press: the share of lam that presses without friction.
        """
        masses = self.mass_system(state.t, state.q)
        least = masses.determinant(lam)
        if all(self.on_contact) or masses.determinant(-lam) > 0.0:
            return least
        return min([least, *self._shares(self._consistent(state, masses.system), lam)])

    def contraction(self, t, q):
        """Return max_i |mu_i| sum_j |Y_on(i),j|, the largest change of friction that a unit change of friction causes through what presses.

        Below 1 the force is unique for any direction of lam.
        """
        masses = self.mass_system(t, q)
        sizes = np.sqrt(masses.presses.T @ masses.Y**2).sum(axis=1)
        return float((np.abs(self.signed_mu) * sizes).max(initial=0.0))

    def _consistent(self, state, masses):
        """Consistent multipliers at a state, (m,), of a system of masses with or without friction."""
        return masses.solve(self.force(state.t, state.q, state.v), self.phi_bias(state.t, state.q, state.v))[1]

    def _shares(self, lam, other):
        """For each slip `lam . other / (other . other)` on the rows that press it; slips with other = 0 there are left out."""
        on = [np.isin(self.columns, law.on) for law, _ in self.slips]
        return [float(lam[rows] @ other[rows] / square) for rows in on if (square := other[rows] @ other[rows])]

    def press_direction_is_consistent(self, state):
        """True if state.lam and the consistent multipliers at the state have a positive scalar product on the rows that press each slip."""
        consistent = self._consistent(state, self.mass_system(state.t, state.q))
        return min(self._shares(consistent, state.lam), default=1.0) > 0.0

    def would_press_without_friction(self, state, lam):
        """True if lam and the multipliers without friction at the state have a positive scalar product on the rows that press each slip."""
        without_friction = self._consistent(state, self.mass_system(state.t, state.q).system)
        return min(self._shares(without_friction, lam), default=1.0) > 0.0

    def rubbing_rows(self, t, q):
        """The rows of phi_q of the friction that slips, (k, n)."""
        origin = self.origin
        return origin.phi_q_rows(t, q, self.slipping_rows) if origin.is_scene else dense(origin.phi_q(t, q)[self.slipping_rows])

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
    """The system of M and B = phi_q in which friction of the k slips is proportional to what presses, `f = s mu |lam_on|`.

    system: the same without friction. presses (m, k): of the equations, as of `pressing`. X (n, k), Y (m, k): accelerations and multipliers
    that unit friction of each slip causes; so lam = dlam + Y f.
    """

    def __init__(self, model, system, t, q):
        """Take the system without friction of a Slipping model at (t, q)."""
        self.model = model
        self.system = system
        self.t = t
        self.q = np.array(q)
        self.presses = model.presses[model.columns]
        rows = model.rubbing_rows(t, q)
        self.X, self.Y = system.solve(rows.T, np.zeros((model.m, len(rows))))

    def slope(self, shares):
        """Return D = d(f - s mu |lam_on|)/df, (k, k). shares (k, m): slopes of |lam_on| by lam."""
        return np.eye(len(shares)) - self.model.signed_mu[:, None] * (shares @ self.Y)

    def determinant(self, lam):
        """Return the determinant of D at multipliers lam (m,)."""
        return float(np.linalg.det(self.slope(self.model.pressures(lam, self.presses)[1])))

    def solve(self, r, phi):
        """Solve `M dq + B^T dlam + friction = -r`, `B dq = -phi` by Newton's method on f; return (dq, dlam).

        Raises SingularSystem if friction alone could hold the motion: no unique force.
        """
        dq, dlam = self.system.solve(r, phi)
        f = np.zeros(len(self.model.signed_mu))
        for _ in range(MOST):
            lam = dlam + self.Y @ f
            sizes, shares = self.model.pressures(lam, self.presses)
            error = f - self.model.signed_mu * sizes
            if np.abs(error).max() <= 1e-14 * max(np.abs(f).max(), np.abs(f - error).max()):
                return dq + self.X @ f, lam
            try:
                f = f - np.linalg.solve(self.slope(shares), error)
            except np.linalg.LinAlgError:
                break
        if not r.any():  # a projection of positions or velocities, which needs no friction
            return dq, dlam
        raise self.model.singular()
