"""The factored step matrices of a step of any model, one for each mode of the tableau, and what its systems need around them."""

from functools import partial

import numpy as np

from polyida.linear.lu import LU
from polyida.linear.step_matrix import Border


class Matrices:
    """S of every mode for steps of h, made when first used from `made_at`: t, q, v, a and lam in one array.

    M and the modes' slopes, c M + C, are those of there. price: iterations that it cost beyond its best ones, `least` a step.
    """

    def __init__(self, model, modes, h, made_at, linear="auto"):
        self.linear = linear
        self.model, self.modes, self.made_at = model, modes, made_at
        self.c = [mode.value / h for mode in modes]
        self.factors = self.borders = None
        self.backend = ""

    def make(self):
        """Factor, where it is not done. Raises SingularSystem."""
        if self.factors is not None:
            return
        at, first = self._evaluated(), self.model.step_matrix(self.linear)
        first.factor(*at, self.c[0] ** 2, self.c[0])
        more = ((c, c * slope - self.c[0] * self.slopes[0]) for c, slope in zip(self.c[1:], self.slopes[1:]))
        steps = [first, *(first.beside(c**2, c, change) for c, change in more)]
        self.backend, self.added = first.backend, 0.0
        self.factors = [partial(step.solve, at[1]) for step in steps]
        self.bare = [] if all(step.stands_alone() for step in steps) else [step.S for step in steps]

    def _evaluated(self):
        """(t, q, v, a, lam) of where they are made, with M and the slopes of there."""
        model, at = self.model, (float(self.made_at[0]), *np.split(self.made_at[1:], np.cumsum([self.model.n] * 3)))
        self.M, self.C = model.mass(at[1]), model.force_v(*at[:3]) if model.needs.velocity_forces else None
        self.slopes = [c * self.M if self.C is None else c * self.M + self.C for c in self.c]
        return at

    def _hold(self, B):
        """Solve with S + s B^T B, where S may be singular: coordinates have no mass and are held by constraints alone.

        With `B dq = -r3` nothing has changed but dlam, by s r3; so B is that of the rows themselves.
        """
        size = float(np.abs(self.bare[0].diagonal()).max(initial=0.0))
        self.added = size / max(float(np.abs(B).max(initial=0.0)), 1e-300) ** 2 if self.model.m else 0.0
        BB = self.added * (B.T @ B)
        self.factors = [LU(S + (type(S)(BB) if hasattr(S, "tocsc") else BB)).solve for S in self.bare]

    def surround(self, rows, counts):
        """Take the constraints' rows, and make the columns that belong to them."""
        if self.bare:
            counts.factorizations += len(self.bare)
            self._hold(rows.B)
        counts.solves += len(self.modes) * len(rows.both)
        self.rows, self.corner, self.borders = rows, rows.corner(), []
        for k, slope in enumerate(self.slopes):
            columns = np.hstack([rows.B.T, slope @ rows.G.T]) if rows.tied else rows.B.T
            self.borders.append(Border(self._free(k, columns)))

    def off(self, v, a):
        """(C v + M a, M v)."""
        force = self.M @ a
        return force if self.C is None else force + self.C @ v, self.M @ v

    def corrections(self, k, r, r3, r4):
        """(dq, dlam, dmu) of mode k from its residuals. Raises SingularSystem."""
        m = len(self.rows.B)
        dq, w = self.borders[k].solve(-self._free(k, r), self.rows.both, self.rows.below(self.c[k], r3, r4), self.corner)
        return dq, w[:m] - self.added * r3, w[m:]

    def _free(self, k, b):
        return self.factors[k](b.astype(complex) if self.modes[k].paired else b)
