"""Tables of models whose functions or matrices are in Python: callbacks that keep an exception for the caller."""

from functools import partial

import numpy as np

from polyida import system as of
from polyida.errors import DONE, REASONS, SINGULAR, InputError
from polyida.integrate.discontinuities import inner_side
from polyida.integrate.radau.matrices import Rows
from polyida.integrate.start import consistent_acceleration
from polyida.linear.lu import SingularSystem, dense
from polyida.system import dense_slots
from polyida.system.dense import INNER
from polyida.system.own import DenseTable, PythonTable, small_own


class Stages:
    """Attributes and methods that all tables of Radau IIA share; defaults for tables that get the times step by step."""

    lifts = True  # whether G = B D^-1 has the D of `weigh`; else D = 1
    renewal = 20.0  # iterations that cost as much as new factors
    prepared, single = False, False  # whether a stretch's instants are known before, whether the matrices of one slot are at hand only

    def begin(self, engine, state, control, ends):
        """The instant at which a stretch begins."""
        return 0

    def end_reason(self, ended, engine, control):
        """(status, reason) for a status of the driver."""
        return REASONS[ended]


class PythonStages(Stages, PythonTable):
    """The table of any model and its matrices, `kind(model, modes, h, made_at)`; each entry is a callback.

    lift (n,): the diagonal of D^-1. B: phi_q of the stages where REACTION was asked last. A stretch has one step, because matrices that are made
    within it are counted at its end.
    """

    most = 1

    def __init__(self, model, tableau, tied, kind):
        """Take the tableau; tied: True if there is mu; kind: function that makes the Matrices of a slot."""
        self.tableau, self.tied, self.kind, self.lift, self.slots, self.reason = tableau, tied, kind, np.ones(model.n), {}, ""
        self.stages, self.B = tableau.stages, [None] * tableau.stages
        super().__init__(model, model.has_constraint_increments)

    def _entries(self):
        """{number of an entry: method} of the table, with those of Radau IIA's stages and modes."""
        entries = super()._entries() | {of.PREPARE: self._prepare, of.REACTION: self._reaction}
        entries |= {of.REAL: self._real, of.PAIR: self._pair, of.INERTIA: self._inertia, of.ACCELERATION: self._acceleration}
        return entries | {of.ROWS: self._rows, of.SELECT: self._select}

    def set_lift(self, lift):
        """Set lift (n,), the diagonal of D^-1: the weights of B^T mu in the stages' `q' - v + D^-1 B^T mu = 0`."""
        self.lift = lift

    def evaluate_constants(self, t, q):
        """No effect: every call evaluates the model."""

    def make(self, slot, h, made_at, counts):
        """Make the matrices of a slot. Raises SingularSystem."""
        self.slots[slot] = matrices = self.kind(self.model, self.tableau.modes, h, made_at)
        matrices.make()
        self.counts, counts.backend = counts, matrices.backend

    def end_reason(self, ended, engine, control):
        """(status, reason) for a status of the driver."""
        status, reason = super().end_reason(ended, engine, control)
        return status, self.reason if ended == SINGULAR and self.reason else reason

    def _prepare(self, first, times, *_):
        """The entry PREPARE: read h, t and the times of the instants at an address, and set them from number `first` on."""
        self.h, self.t, *at = self._array(times, 3 + self.stages)
        self.times[first : first + len(at)] = np.array(at)[:, None]

    def _spans(self, instant):
        """(t, time of the stage, times beside both inside the step, length) of each stage of a step."""
        begin = inner_side(self.model, self.t, -self.h)
        ends = self.times[instant + 1 : instant + 1 + self.stages, INNER].tolist()
        return [(self.t, t, (begin, t), step) for t, step in zip(ends, self.tableau.c * self.h)]

    def _reaction(self, instant, q, mu, dv, known, *_):
        """Add D^-1 B^T mu to dv; known: B is that of the rows of the middle stage."""
        model, k, dv = self.model, self._stage(instant), self._array(dv, self.model.n)
        if known:
            dv += self.factored.rows.G.T @ self._array(mu, model.m)
            return
        self.B[k] = dense(model.phi_q(*self._state(instant, q)))
        dv += self.lift * (self.B[k].T @ self._array(mu, model.m))

    def _rate(self, instant, q, v, rate, known, *_):
        """Write `phi_q v + phi_t`; known: B is that of the last REACTION of this stage."""
        model = self.model
        if known:  # PROJECT does not follow
            of_t = model.phi_t(*self._state(instant, q))
            self._array(rate, model.m)[:] = self.B[self._stage(instant)] @ self._array(v, model.n).copy() + of_t
        else:
            super()._rate(instant, q, v, rate, known)

    def _project(self, *arguments):
        """The entry PROJECT: the projection of PythonTable; the status is SINGULAR if constraints depend on each other."""
        return self._tried(partial(super()._project, *arguments), InputError, np.linalg.LinAlgError)

    def _rows(self, instant, q, v, a, *_):
        """Make the rows of the middle stage and border the factors with them, unless the border is the same as before."""
        needs, matrices = self.model.needs, self.factored
        if matrices.borders is None or needs.phi_q_varies or needs.driven or matrices.rows_turn:
            at = *self._state(instant, q), self._array(v, self.model.n).copy()
            return self._tried(lambda: matrices.surround(self._made_rows(*at, a), at[1], self.counts))
        return DONE

    def _made_rows(self, t, q, v, a):
        """The Rows of the constraints at a state, with the lam of the matrices; a has no influence."""
        return Rows(self.model, t, q, v, self.factored.lam, self.lift if self.tied else None)

    def _tried(self, act, *errors):
        """SINGULAR for an error of these classes, or SingularSystem, whose reason is kept."""
        try:
            act()
        except (SingularSystem, *errors) as error:
            self.reason = str(error)
            return SINGULAR
        return DONE

    def _real(self, instant, *arguments):
        """The entry REAL: write dq and the multipliers of the real mode, the first one."""
        return self._correct(0, float, *arguments)

    def _pair(self, instant, *arguments):
        """The entry PAIR: write dq and the multipliers of the complex mode, the last one."""
        return self._correct(len(self.tableau.modes) - 1, complex, *arguments)

    def _correct(self, mode, kind, r, closing, lam, dq, multipliers, _):
        """Write dq and multipliers of a mode; kind: float or complex, the type of its arrays."""
        n, m = self.model.n, self.model.m
        r, dq, closing, multipliers = (
            self._array(at, size * (1 + (kind is complex))).view(kind)
            for at, size in ((r, n), (dq, n), (closing, 2 * m), (multipliers, 2 * m))
        )

        def solve():
            """Solve for the corrections, and write them to the arrays at the addresses."""
            tied = m if self.tied else 0
            corrections = self.factored.corrections(mode, r.copy(), closing[:m].copy(), closing[m : m + tied].copy())
            dq[:], multipliers[:m], multipliers[m : m + tied] = corrections

        return self._tried(solve)

    def _inertia(self, instant, v, a, r, p, q, rows):
        """Write r = `C v + M a`, and at their addresses, unless these are 0, p = `M v` and the constraint rows times v."""
        n, m = self.model.n, self.model.m
        v, a, matrices = self._array(v, n).copy(), self._array(a, n).copy(), self.factored
        self._array(r, n)[:] = matrices.inertia(v, a)
        if p:
            self._array(p, n)[:] = matrices.M @ v
        if rows:
            blocks = [matrices.rows.on_v @ v, matrices.rows.B @ v] if m else [np.zeros(0)]
            self._array(rows, 2 * m)[:] = np.concatenate(blocks)[: 2 * m]

    def _acceleration(self, instant, q, v, a, lam, *_):
        """Write a and lam that are consistent with q and v; the status says if constraints depend on each other."""
        model = self.model
        try:
            accelerations = consistent_acceleration(model, *self._state(instant, q), self._array(v, model.n).copy())
        except (InputError, np.linalg.LinAlgError):  # constraints that have become dependent, where the run is about to end
            return SINGULAR
        self._array(a, model.n)[:], self._array(lam, model.m)[:] = accelerations
        return DONE

    def _select(self, slot, *_):
        """The entry SELECT: take the matrices in a slot for the next corrections."""
        self.factored = self.slots[slot]


class DenseStages(Stages, DenseTable):
    """The table of a small model. levels (k, 3): factors of phi, phi' and phi'' in each of k blocks of constraint rows."""

    entries = (
        of.RESIDUAL, of.PREPARE, of.BEGIN, of.REACTION, of.CONSTRAINTS, of.RATE, of.BIAS, of.PROJECT, of.ACCEPT, of.ROWS, of.REAL, of.PAIR,
        of.INERTIA, of.ACCELERATION, of.MATRICES, of.SELECT,
    )  # fmt: skip

    def __init__(self, model, tableau, levels):
        """Take the stages of the tableau and the levels of the rows, and fill the table's functions."""
        self.stages, self.levels = tableau.stages, levels
        super().__init__(model)
        self.serve()

    def stand(self, t):
        """Set the time of all instants."""
        self.w.times[:] = t

    def set_lift(self, lift):
        """Set the diagonal of D^-1."""
        self.w.slots.D[:] = lift

    def make(self, slot, h, made_at, counts):
        """Compute K, C and M of a slot."""
        n = self.model.n
        self.evaluate_constants(float(made_at[0]), made_at[1 : 1 + n])
        self.times[0] = made_at[0]
        q, v, a, lam = (np.ascontiguousarray(x) for x in np.split(made_at[1:], np.cumsum([n] * 3)))
        ended = dense_slots.matrices(self.w, 0, q, v, a, lam, slot)
        self.raise_error()
        if ended != DONE:
            raise SingularSystem(REASONS[ended][1])


def table_of(model, linear, tableau, tied, kind):
    """The table of a model. linear: the setting of the integrator; kind: class of its matrices unless compiled code makes them."""
    if linear == "kkt" or not small_own(model):
        return PythonStages(model, tableau, tied, kind)
    return DenseStages(model, tableau, np.eye(1 + tied, 3))
