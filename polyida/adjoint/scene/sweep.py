"""The backward sweep of generalized-alpha on a compiled scene; what it solves is in `adjoint/alpha/plain.py`."""

import numpy as np

from polyida.adjoint.alpha.plain import PlainSweep, Sent, Swept
from polyida.adjoint.scene import steps
from polyida.adjoint.scene.products import arrays_of, scratch
from polyida.assembly.rows.increments import drive_table
from polyida.errors import DONE
from polyida.linear.cholesky.team import Helpers
from polyida.machine import threads
from polyida.objective.slopes import Slopes
from polyida.system import scene as tables

SHARE = 1e-2  # of what Newton leaves, over what it is compared with, that refinement leaves of w
LEAST = 1e-11  # of |w|: no less
MOST = 12  # corrections of a step with one factor


class SceneSweep:
    """Steps of h on a compiled scene, backward. counts: what counts its work."""

    def __init__(self, model, settings, h, counts):
        c, (_, most, _) = settings.coefficients, settings.newton_tolerance(0.0)
        self.model, self.settings, self.counts = model, settings, counts
        self.method = steps.Method(h, c.alpha_m, c.alpha_f, c.beta, c.gamma, *c.rates(h), max(LEAST, SHARE * most), MOST)
        self.arrays, self.products = arrays_of(model), scratch(model)
        self.viscosity = model.arrays.plates.body_viscosity if model.damped else None
        self.memory, self.trial = steps.empty(model.n, model.m)
        self.system, self.before = None, np.inf
        self.helpers = Helpers(threads() if model.n >= tables.SHARED else 1)

    def back(self, t, q, v, a, lam, slopes, sent, keep=None):
        """The Swept of steps that ended at these frames, in order of time, (count, .) each.

        slopes: the objective's own in these frames; sent: what the step after the last sends. keep: where to write y and z, (count, n)
        each, or None.
        """
        if abs(t[-1] - self.before) > 0.5 * self.method.h:
            steps.forget(self.memory)
        self.memory.sent[:], self.before = sent, t[0] - self.method.h
        found = steps.Found(np.empty_like(q), np.empty_like(lam), *(keep or np.empty((2, 0, self.model.n))))
        frames, drives = self._frames(q, v, lam, slopes), drive_table(self.model, t, (t[0], t[-1]))
        done, fresh = len(t), False
        while done:
            if self.system is None:
                self._factor(*(x[done - 1] for x in (t, q, v, a, lam)))
                fresh = True
            last, (done, ended) = done, self._steps(drives, frames, done, found)
            if ended != DONE:
                if fresh and done == last:
                    done = self._directly(done - 1, (t, q, v, a, lam), slopes, found)
                self.system, fresh = None, False
        return Swept(Sent(*self.memory.sent.copy()), found.w, found.mu)

    def _directly(self, k, frames, slopes, found):
        """Step k by the plain sweep, which does not need a factor that contracts. Returns k."""
        here, sent = slice(k, k + 1), Sent(*self.memory.sent.copy())
        own = Slopes(**{name: None if (part := getattr(slopes, name)) is None else part[here] for name in ("q", "v", "a", "lam")})
        keep = (found.y[here], found.z[here]) if len(found.y) else None
        swept = PlainSweep(self.model, self.settings, self.method.h, self.counts).back(*(x[here] for x in frames), own, sent, keep)
        self.memory.sent[:], found.w[k], found.mu[k] = swept.sent, swept.w[0], swept.mu[0]
        steps.forget(self.memory)
        return k

    def _frames(self, q, v, lam, slopes):
        n, m = self.model.n, self.model.m
        own = ((slopes.q, n), (slopes.v, n), (slopes.a, n), (slopes.lam, m))
        given = [q, v, lam, *(np.zeros((0, size)) if part is None else part for part, size in own)]
        return steps.Frames(*(np.ascontiguousarray(part, float) for part in given))

    def _factor(self, t, q, v, a, lam):
        method, self.system = self.method, self.settings.step_matrix(self.model)
        self.system.factor(t, q.copy(), v.copy(), a.copy(), lam.copy(), method.to_a, method.to_v)
        self.counts.factorizations += 1
        self.counts.solves += self.system.solves
        self.counts.backend = self.system.backend
        self.memory.marks[steps.CONTRACTION], self.memory.marks[steps.AGE] = 1.0, steps.FRESHEN

    def _steps(self, drives, frames, last, found):
        marks, given = self.memory.marks, (self.products, self.memory, self.trial, found)
        marks[steps.SOLVES] = 0.0
        with self.helpers.at_work(self.system.corotated.factor, self.system.room) as room:
            result = steps.stretch(
                self.arrays, self.system.corotated, room, self.method, self.viscosity, self.model.laws, drives, frames, last, *given
            )
        self.counts.solves += int(marks[steps.SOLVES])
        return result
