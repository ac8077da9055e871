"""The forms in which IDA solves a model: its constraint rows and unknowns.

Unknowns y = (q, v, multipliers); equations

    q' - v + B^T mu = 0,   M v' + g + B^T lam = 0,   c(t, q, v, v') = 0,   B = phi_q

| form | c | mu | multipliers |
|---|---|---|---|
| ggl2 | phi and phi' | yes | lam, mu |
| ggl1 | phi and phi' | yes | their integrals: lam = L', mu = N' |
| index2 | phi' | no | lam |
| index1 | phi'' | no | lam |
| baumgarte | phi'' + 2 w phi' + w^2 phi | no | lam |
| index3 | phi | no | lam |

A velocity row psi is a row with phi = 0, phi' = psi and B = W. The forms with mu have psi(t, q, q')/cj in place of phi, so that mu keeps the
form of the others, cj as in newton.py; index3 has no equation for it.

Sources: Gear, Gupta, Leimkuhler 1985 (ggl2); Gear 1988 and Anantharaman, Hiller 1991 (ggl1); Baumgarte 1972.
"""

from copy import copy
from dataclasses import dataclass
from functools import partial

import numpy as np

from polyida.integrate.state import State, Stretch
from polyida.linear.lu import dense

# constants of compiled code
INSTANT = 1  # of a model's table: the stage of the step that begins at instant 0

UNTESTED = 1e50  # absolute tolerance of multipliers, which are not in the error estimate: far above the forces of any scene


@dataclass(frozen=True)
class Form:
    """rows: orders of the derivatives of phi that are constraint rows; combined: their sum is one row, Baumgarte's."""

    rows: tuple
    stabilised: bool = False
    integrated: bool = False
    combined: bool = False


FORMS = {
    "ggl2": Form((0, 1), stabilised=True),
    "ggl1": Form((0, 1), stabilised=True, integrated=True),
    "index2": Form((1,)),
    "index1": Form((2,)),
    "baumgarte": Form((0, 1, 2), combined=True),
    "index3": Form((0,)),
}


class System:
    """A model in one form.

    baumgarte_rate: w of Baumgarte, 1/s. levels (k, 3): weights of phi, phi' and phi'' in each of k blocks of m rows. limits: interval to which
    t is clamped, so that a smooth piece evaluates its own side of a kink. exact: True if factors in single precision are too inexact.
    """

    exact = False

    def __init__(self, model, form, baumgarte_rate=0.0):
        """Set the weights of phi, phi' and phi'' in the rows of a form, by its name in FORMS."""
        self.model, self.form, self.limits = model, FORMS[form], (-np.inf, np.inf)
        weights = [[baumgarte_rate**2, 2.0 * baumgarte_rate, 1.0]]
        self.levels = np.array(weights) if self.form.combined else np.eye(3)[list(self.form.rows)]
        self.size = 2 * model.n + len(self.levels) * model.m

    def split(self, y, yp):
        """q, v, a, lam, mu (None without) as views of y and y', (size,) or (k, size)."""
        n, m = self.model.n, self.model.m
        multipliers = (yp if self.form.integrated else y)[..., 2 * n :]
        mu = multipliers[..., m:] if self.form.stabilised else None
        return y[..., :n], y[..., n : 2 * n], yp[..., n : 2 * n], multipliers[..., :m], mu

    def pack(self, state):
        """(y, y') at a consistent State."""
        y, yp = np.zeros((2, self.size))
        q, v, a, lam, _ = self.split(y, yp)
        q[:], v[:], a[:], lam[:], yp[: self.model.n] = state.q, state.v, state.a, state.lam, state.v
        return y, yp

    def tolerances(self, atol_q, atol_v, speed=0.0):
        """Absolute tolerances of y, (size,), from those of q and v; integrals of first-order states are not tested.

        speed: of the model, which those of v are for; 0 if they are given for each entry.
        """
        n, states, atol = self.model.n, self.model.state_columns, np.full(self.size, UNTESTED)
        atol[:n], atol[n : 2 * n] = atol_q, atol_v
        atol[self.model.hidden] = UNTESTED
        if speed:
            atol[n + states] *= self.model.state_speed / speed
        return atol

    def clamp(self, t):
        """The time t, or the nearest of `limits` if it is outside."""
        return min(max(t, self.limits[0]), self.limits[1])

    def at(self, t, y, yp):
        """(t, q, v, a, lam) for the model, in arrays of their own."""
        return self.clamp(t), *self.split(y.copy(), yp.copy())[:4]

    def rejection_reason(self, t, q):
        """Why the model rejects (t, q), or None."""
        return self.model.rejection_reason(self.clamp(t), q)

    @property
    def holds_phi(self):
        """True if phi itself is a row."""
        return 0 in self.form.rows and not self.form.combined

    @property
    def rows_vary(self):
        """True if phi_q depends on t or q."""
        needs = self.model.needs
        return self.model.m > 0 and (needs.driven or needs.phi_q_varies)

    def drift(self, t, q, allowed):
        """Message of the constraint whose drift from phi = 0, in q, is more than `allowed`; None without drift or if phi is a row."""
        if not self.model.m or self.holds_phi:
            return None
        t, model = self.clamp(t), self.model
        distances = np.abs(model.phi(t, q)) / np.linalg.norm(dense(model.phi_q(t, q)), axis=1)
        worst = int(distances.argmax())
        return None if distances[worst] <= allowed else f"{model.constraint_name(worst)} has drifted apart by {distances[worst]:.2g}"


class AcceptedStates(Stretch):
    """Accepted states of a System at the times t (k,), from rows y and y' (k, size); a run can go on from each of them.

    work: for each state the counts of the work up to it, except the steps; within: function of the end of a step and t, as of State, or None. mu,
    zero but for truncation, is in the memory.
    """

    def __init__(self, system, memory, work, t, y, yp, within=None):
        """Split y and y' into q, v, a, lam and mu."""
        *state, mu = (None if x is None else np.ascontiguousarray(x) for x in system.split(y, yp))
        super().__init__(t, *state)
        self._memory, self._mu, self._work, self._within = memory, mu, work, within

    @property
    def spent(self):
        """The counts at the last state."""
        return self._work[-1]

    def _state(self, k):
        """The State number k, with its mu in the memory if the form has mu."""
        memory = self._memory if self._mu is None else {"mu": self._mu[k]} | self._memory
        t, within = float(self.t[k]), self._within and partial(self._within, self.t[k])
        return State(t, self.q[k], self.v[k], self.a[k], self.lam[k], dict(memory), within=within)

    def part(self, first, end, every=1):
        """The states from number `first` to before `end`, or each `every`-th of them."""
        part, at = copy(self), slice(first, end, every)
        part._last = self.last if end >= len(self) and every == 1 else None
        for name in ("t", "q", "v", "a", "lam", "_mu", "_work"):
            setattr(part, name, None if getattr(self, name) is None else getattr(self, name)[at])
        return part
