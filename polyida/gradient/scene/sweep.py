"""The backward sweep of generalized-alpha on a compiled scene; what it solves is in `gradient/plain.py`."""

import numpy as np

from polyida.assembly.rows.increments import drive_table
from polyida.gradient.plain import Sent
from polyida.gradient.scene import steps
from polyida.gradient.scene.products import arrays_of, scratch
from polyida.integrate.state import Counts
from polyida.integrate.stepping.ended import DONE, SINGULAR
from polyida.linear.lu import SingularSystem

ENOUGH = 1e-10  # of |w|: the error at which refinement ends
MOST = 12  # corrections of a step with one factor


class SceneSweep:
    """Steps of h on a compiled scene, backward. counts: what the solves took."""

    def __init__(self, model, settings, h):
        c = settings.coefficients
        self.model, self.counts, self.settings = model, Counts(), settings
        self.method = steps.Method(h, c.alpha_m, c.alpha_f, c.beta, c.gamma, *c.rates(h), ENOUGH, MOST)
        self.arrays, self.products = arrays_of(model), scratch(model)
        self.damp = np.zeros(0) if model.damped else None
        self.memory, self.trial = steps.empty(model.n, model.m)
        self.system = None

    def back(self, t, q, v, a, lam, slopes, sent):
        """(Sent to the state before, w (count, n), mu, kappa (count, m)) of steps that ended at these frames, in order of time.

        slopes: the objective's own in these frames; sent: what the step after the last sends.
        """
        self.memory.sent[:] = sent
        w, mu = np.empty_like(q), np.empty_like(lam)
        frames = self._frames(q, v, lam, slopes)
        drives = drive_table(self.model, t, (t[0], t[-1]))
        done, fresh = len(t), False
        while done:
            if self.system is None:
                k, fresh = done - 1, True
                self._factor(t[k], q[k], v[k], a[k], lam[k])
            before, (done, ended) = done, self._steps(drives, frames, done, w, mu)
            fresh = fresh and done == before
            if ended != DONE:
                if fresh or ended == SINGULAR:
                    raise SingularSystem("the constraints' system is singular")
                self.system = None
        return Sent(*self.memory.sent.copy()), w, mu, np.zeros_like(mu)

    def _frames(self, q, v, lam, slopes):
        given = [q, v, lam, slopes.q, slopes.v, slopes.a, slopes.lam]
        sizes = [self.model.n] * 3 + [self.model.m]
        none = [np.zeros((0, size)) for size in sizes]
        given[3:] = [empty if part is None else part for part, empty in zip(given[3:], none)]
        return steps.Frames(*(np.ascontiguousarray(part, float) for part in given))

    def _factor(self, t, q, v, a, lam):
        method, self.system = self.method, self.settings.step_matrix(self.model)
        self.system.factor(t, q.copy(), v.copy(), a.copy(), lam.copy(), method.to_a, method.to_v)
        self.counts.factorizations += 1
        self.counts.solves += self.system.solves
        self.counts.backend = self.system.backend
        self.memory.marks[steps.CONTRACTION], self.memory.marks[steps.AGE] = 1.0, steps.FRESHEN

    def _steps(self, drives, frames, last, w, mu):
        marks = self.memory.marks
        marks[steps.SOLVES] = 0.0
        found = steps.stretch(
            self.arrays,
            self.system.corotated,
            self.system.room,
            self.method,
            self.damp,
            self.model.laws,
            drives,
            frames,
            last,
            self.products,
            self.memory,
            self.trial,
            w,
            mu,
        )
        self.counts.solves += int(marks[steps.SOLVES])
        return found
