"""The statuses of the rows with laws at a time of an event-driven run, and the model that they make.

Rows of closed contacts and rows that stick are equations of the mode; rows that slip are forces of it. Each row has a function that is not
negative while its status lasts:

    open contact       its gap phi
    closed contact     its pressure -lam
    row that sticks    c(lam) - |lam|, c: the bound of friction
    row that slips     its rate in the direction of slip

Closed and sticking rows may depend on each other, as those of a rigid block on two feet. Independent ones are the equations then. Their forces
are shared by all of them: of the forces with the same accelerations those of least norm, rows measured in `sqrt(G_ii)`. A row that reaches its
bound leaves the others to themselves, and has no function while they hold it.

Rows at rest may depend on equations alone, as the friction of a guide along which a motor moves a body. They carry no force, and have no function.
"""

from typing import Any, NamedTuple

import numpy as np

from polyida.integrate.nonsmooth.cone import CLOSED, SLIPS_DOWN, SLIPS_UP, STICKS
from polyida.integrate.nonsmooth.contacts import FIXED, TOUCH
from polyida.integrate.start import on_velocity
from polyida.integrate.state import Stretch
from polyida.model.row_laws import Slips, pressing
from polyida.run.quiet_steps import CERTAIN

DEPENDENT = 1e-10  # of G_ii: rows that depend on others
NONE = np.zeros(0, np.int64)
SIGNS = {SLIPS_UP: 1.0, SLIPS_DOWN: -1.0}


class Kept(NamedTuple):
    """A vector that was computed at a State, and is asked for again at the same one."""

    state: Any = None
    value: Any = None


class Statuses:
    """The statuses of the rows with laws, and what follows from them: the mode, forces and functions of the rows.

    Numbers and masks are of the rows with laws, in the order of `row_laws`. whole: the model of all rows. contacts: its Contacts. compiled:
    False if friction that slips is to be in Python.
    """

    def __init__(self, whole, contacts, compiled):
        """Begin with all rows free. `set` follows before anything else is asked."""
        count = len(whole.row_laws)
        self.whole = whole
        self.contacts = contacts
        self.compiled = compiled
        self.pressing = pressing(whole, whole.row_laws)  # for the norms of pressures: lam^2 @ pressing
        self.modes = {}  # {(rows that are equations, slips): model}, as they were needed
        self.status = np.zeros(count, np.int64)  # OPEN or free: 0, CLOSED, STICKS, SLIPS_UP or SLIPS_DOWN
        self.mode = whole  # the model of the statuses
        self.equations = whole  # the model with the equations of the mode alone
        self.shared = NONE  # numbers of the rows that share their forces
        self.watched = NONE  # numbers of the rows at rest that equations hold, and may begin to move
        self.without_function = np.zeros(count, bool)  # True for rows at rest that other rows hold
        self.fixed = np.zeros(count, bool)  # True for rows that slip and that equations alone move
        self.forget()

    def forget(self):
        """Forget what was computed at the last state."""
        self._forces = Kept()  # lam of all rows
        self._rates = Kept()  # of the rows, see `rates_by_equations`
        self._functions = Kept()  # of the rows

    def set(self, status, t, q, v):
        """Set the statuses, (rows with laws,), at a state: the model, the rows that share forces, and those that the equations hold."""
        laws = self.whole.row_laws
        self.status = status
        self.forget()
        self.fixed = self._moved_by_equations_alone(t, q)
        self.shared = self.watched = NONE
        self.without_function = np.zeros(len(laws), bool)
        slips = [(law, SIGNS[s]) for law, s in zip(laws, status) if s in SIGNS and (law.mu or law.constant)]
        equal = np.where(self.contacts.contact, status == CLOSED, status == STICKS)
        kept = self._split_dependent(t, q, v, equal, {row for law, _ in slips for row in law.on})
        rows = np.sort(np.concatenate([self.contacts.equations, self.contacts.rows[kept]]))
        self.mode = self._model_of(t, q, rows, slips)
        self.equations = self.whole.with_rows(rows) if len(self.watched) or slips else self.mode

    def _moved_by_equations_alone(self, t, q):
        """True for the rows that slip and that equations alone move: they have no mobility G_ii."""
        fixed = np.zeros(len(self.status), bool)
        sliding = np.flatnonzero(self.status >= SLIPS_UP)
        if len(sliding) and self.contacts.turning:
            G, mobility, _ = self.contacts.mobilities(t, q, sliding)
            fixed[sliding] = G.diagonal() <= FIXED * mobility
        return fixed

    def _split_dependent(self, t, q, v, equal, pressed_by_slips):
        """Numbers of independent rows among those that are equal to zero, a mask; sets `shared`, `watched` and `without_function`.

        pressed_by_slips: set of the rows of the model that press friction that slips; they do not share their forces.
        """
        resting = self._resting(t, q, v)
        if not len(resting) or (len(resting) == 1 and equal[resting[0]]):
            return np.flatnonzero(equal)
        G, mobility, _ = self.contacts.mobilities(t, q, resting)
        size = np.where(G.diagonal() <= FIXED * mobility, np.inf, np.maximum(G.diagonal(), DEPENDENT * mobility))
        kept, held = _independent(G, equal[resting], size)
        kept, held = resting[kept], resting[held]
        self.watched = held[~self.fixed[held]]
        self.without_function[self.watched] = True
        if (self.without_function & equal).any():
            laws = self.whole.row_laws
            self.shared = np.array([k for k in resting if equal[k] and laws[k].row not in pressed_by_slips], np.int64)
            self.without_function[self.shared] = False
        return kept

    def _resting(self, t, q, v):
        """Numbers of the rows without a rate or a gap: contacts, and friction that a closed contact or a constant presses."""
        contacts = self.contacts
        rates, gaps = self.whole.phi_rate(t, q, v)[contacts.rows], contacts.gaps(t, q)
        pressed = contacts.contact | contacts.active(self.status == CLOSED)
        touches = gaps <= TOUCH * (self.whole.extent or 1.0)
        return np.flatnonzero((np.abs(rates) <= contacts.still(v)) & touches & pressed)

    def _model_of(self, t, q, rows, slips):
        """The model in which `rows` are equations; slips: [(law, sign)] of the rows that slip. One model for each pair is kept."""
        key = rows.tobytes(), tuple((law.row, sign) for law, sign in slips)
        if key not in self.modes:
            self.modes[key] = self._slipping(t, q, rows, slips) if slips else self.whole.with_rows(rows)
        return self.modes[key]

    def _slipping(self, t, q, rows, slips):
        """The model in which these rows are equations and others slip, `slips`; in compiled code unless friction nearly holds by itself at (t, q)."""
        plain = Slips(self.whole, rows, slips)
        if not (self.whole.is_scene and self.compiled) or plain.contraction(t, q) >= CERTAIN:
            return plain
        from polyida.assembly.slipping import SlippingScene

        return SlippingScene.of(self.whole, rows, slips)

    def all_forces(self, state):
        """Multipliers lam of all rows, closed or not, at a state of the mode, (m,). Dependent rows share their forces: those of least norm."""
        if self._forces.state is not state:
            lam = self.mode.spread(state.lam, self.whole.m)
            if len(self.shared):
                contacts, rows = self.contacts, self.contacts.rows[self.shared]
                G, _, Y = contacts.mobilities(state.t, state.q, self.shared)
                size, p = 1.0 / np.sqrt(G.diagonal()), -lam[rows]
                scaled = size[:, None] * G * size
                least = size * np.linalg.lstsq(scaled, size * (G @ p), rcond=DEPENDENT)[0]
                lam[rows] = -least
                lam[contacts.equations] += Y @ (least - p)
            self._forces = Kept(state, lam)
        return self._forces.value

    def rates_by_equations(self, state):
        """Rates of the rows at a state of a step, of velocities that satisfy the equations, (rows with laws,)."""
        if self._rates.state is not state:
            v = on_velocity(self.equations, state.t, state.q, state.v)
            self._rates = Kept(state, self.whole.phi_rate(state.t, state.q, v)[self.contacts.rows])
        return self._rates.value

    def functions_at(self, state):
        """The functions of the rows at a state of the mode, (rows with laws,); those of fixed rows by velocities that satisfy the equations."""
        if self._functions.state is not state:
            values = self.functions(Stretch.of(state), self.all_forces(state)[None])[0]
            for k in np.flatnonzero(self.fixed & ~self.without_function):
                values[k] = SIGNS[self.status[k]] * self.rates_by_equations(state)[k]
            self._functions = Kept(state, values)
        return self._functions.value

    def functions(self, stretch, lam):
        """The functions of the rows at the ends of a stretch, (k, rows with laws); lam: of all rows, (k, m). A row without one has 1."""
        contacts, status = self.contacts, self.status
        phi, rates = self.whole.phi_of_frames(stretch.t, stretch.q, stretch.v)
        phi, rates, own = phi[:, contacts.rows], rates[:, contacts.rows], lam[:, contacts.rows]
        slips = status >= SLIPS_UP
        sticks = status == STICKS
        closed = contacts.contact & (status == CLOSED)
        opened = contacts.contact & ~closed
        bound = contacts.constant + contacts.mu * np.sqrt(lam**2 @ self.pressing)
        result = np.ones((len(lam), len(status)))
        result[:, slips] = (np.where(status == SLIPS_UP, 1.0, -1.0) * rates)[:, slips]
        result[:, sticks] = (bound - np.abs(own))[:, sticks]
        result[:, closed] = -own[:, closed]
        result[:, opened] = phi[:, opened]
        return np.where(self.without_function, 1.0, result)


def _independent(G, equal, size):
    """(numbers of independent rows among those with `equal`, numbers of the other rows that depend on them), by their Gram matrix G.

    size: of the diagonal. Rows that depend on the first ones are found by Cholesky's elimination with pivots.
    """
    rest, kept = G.copy(), []
    while True:
        left = np.where(equal, rest.diagonal() / size, 0.0)
        left[kept] = 0.0
        k = int(np.argmax(left))
        if left[k] <= DEPENDENT:
            dependent = np.flatnonzero(rest.diagonal() / size <= DEPENDENT)
            return np.array(kept, np.int64), np.setdiff1d(dependent, kept)
        kept.append(k)
        rest = rest - np.outer(rest[:, k], rest[k]) / rest[k, k]
