"""The forms in which IDA solves a model: the constraint rows beside the equations of motion, and the unknowns.

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

Sources: Gear, Gupta, Leimkuhler 1985 (ggl2); Gear 1988 and Anantharaman, Hiller 1991 (ggl1); Baumgarte 1972.
"""

from copy import copy
from dataclasses import dataclass

import numpy as np

from polyida.integrate.state import State, Stretch
from polyida.linear.lu import dense

UNTESTED = 1e9  # absolute tolerance of what carries no error estimate, as multipliers: far above any size of theirs


@dataclass(frozen=True)
class Form:
    """Data of a form. `rows`: which derivatives of phi are constraint rows; `combined`: as one, Baumgarte's sum."""

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
    """A model in one form: its constraint rows, and the way from a State to (y, y') and back.

    rate: w of Baumgarte. levels (k, 3): what phi, phi' and phi'' count for in each of k blocks of m rows. limits: t is held to this range, so
    that at a kink a smooth piece sees its own side.
    """

    def __init__(self, model, form, rate):
        self.model, self.form = model, FORMS[form]
        self.limits = (-np.inf, np.inf)
        self.levels = np.array([[rate**2, 2.0 * rate, 1.0]]) if self.form.combined else np.eye(3)[list(self.form.rows)]
        self.size = 2 * model.n + len(self.levels) * model.m

    def split(self, y, yp):
        """q, v, a, lam, mu (None without) as views of y and y', (size,) or (k, size)."""
        n, m = self.model.n, self.model.m
        multipliers = (yp if self.form.integrated else y)[..., 2 * n :]
        mu = multipliers[..., m:] if self.form.stabilised else None
        return y[..., :n], y[..., n : 2 * n], yp[..., n : 2 * n], multipliers[..., :m], mu

    def pack(self, state):
        """(y, y') at a consistent State."""
        n, m = self.model.n, self.model.m
        y, yp = np.zeros(self.size), np.zeros(self.size)
        y[:n], y[n : 2 * n], yp[:n], yp[n : 2 * n] = state.q, state.v, state.v, state.a
        (yp if self.form.integrated else y)[2 * n : 2 * n + m] = state.lam
        return y, yp

    def tolerances(self, atol_q, atol_v):
        """Absolute tolerances of y, (size,), from those of q and v."""
        n, atol = self.model.n, np.empty(self.size)
        atol[:n], atol[n : 2 * n], atol[2 * n :] = atol_q, atol_v, UNTESTED
        return atol

    def rejection_reason(self, t, q):
        """Why the model cannot stand at an accepted (t, q), or None."""
        return self.model.rejection_reason(self.clamp(t), q)

    @property
    def holds_phi(self):
        """Whether phi itself is a row."""
        return 0 in self.form.rows and not self.form.combined

    def opened(self, t, q, allowed):
        """What has drifted from phi = 0 by more than `allowed`, in q, at (t, q), or None; of a form that holds phi nothing has."""
        if not self.model.m or self.holds_phi:
            return None
        t, model = self.clamp(t), self.model
        apart = np.abs(model.phi(t, q)) / np.linalg.norm(dense(model.phi_q(t, q)), axis=1)
        worst = int(apart.argmax())
        return None if apart[worst] <= allowed else f"{model.constraint_name(worst)} has drifted apart by {apart[worst]:.2g}"

    def clamp(self, t):
        """t held to `limits`."""
        return min(max(t, self.limits[0]), self.limits[1])

    def at(self, t, y, yp):
        """(t, q, v, a, lam) for the model."""
        return self.clamp(t), *self.split(y.copy(), yp.copy())[:4]

    @property
    def rows_vary(self):
        """Whether phi_q does, in rows of phi and its first derivative; those of the second cost too much to be made anew."""
        needs = self.model.needs
        return self.model.m > 0 and (needs.driven or needs.phi_q_varies) and max(self.form.rows) < 2


class Accepted(Stretch):
    """Accepted states of a System at the times t (k,), from rows y and y' (k, size); each has the memory that a run goes on from.

    work: for each state the counts of the work done up to it, but for the steps. mu, zero but for truncation, is in that memory.
    """

    def __init__(self, system, memory, work, t, y, yp):
        *state, mu = (None if x is None else np.ascontiguousarray(x) for x in system.split(y, yp))
        super().__init__(t, *state)
        self._memory, self._mu, self._work = memory, mu, work

    @property
    def spent(self):
        """The counts at the last state."""
        return self._work[-1]

    @property
    def last(self):
        """The last State."""
        self._last = self._last or self._state(len(self) - 1)
        return self._last

    def state(self, k):
        """The State number k, counted from 0."""
        return self.last if k == len(self) - 1 else self._state(k)

    def _state(self, k):
        memory = self._memory if self._mu is None else {"mu": self._mu[k]} | self._memory
        return State(float(self.t[k]), self.q[k], self.v[k], self.a[k], self.lam[k], dict(memory))

    def part(self, first, end, every=1):
        """The same of the states from number `first` to before `end`, or of each `every`-th of them."""
        made, at = copy(self), slice(first, end, every)
        made._last = self.last if end >= len(self) and every == 1 else None
        for name in ("t", "q", "v", "a", "lam", "_mu", "_work"):
            setattr(made, name, None if getattr(self, name) is None else getattr(self, name)[at])
        return made
