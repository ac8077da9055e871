"""The transposed equations of a compiled scene's stages, solved with one stale co-rotated factor for each mode of the tableau, and refined.

With `W^T = sum l row column^T` the stages' system falls into one for each eigenvalue l, c = l/h, of K, M and C as old as the factor, in the
frames of the nodes, each stage turned from its own to the middle one's, and B and H of the middle stage:

    | S                   B^T   (c B + H)^T |  |w    |     S = K + c C + c^2 M
    | B                                     |  |mu   |
    | B (c M + C)^T              B B^T      |  |kappa|     the last row and column where there is mu in the step

What is left of the exact equations goes round again.
"""

import numpy as np

from polyida.linear.step_matrix import Border


class Modes:
    """The factors for steps of h, made at a state (t, q, v, a, lam); `surround` takes a step's rows, `solve` solves. Raises SingularSystem."""

    def __init__(self, model, tableau, h, at, linear, counts):
        self.model, self.tableau, self.counts = model, tableau, counts
        self.c = [mode.value / h for mode in tableau.modes]
        first = model.step_matrix(linear)
        first.factor(*at, self.c[0] ** 2, self.c[0])
        self.factors = [first, *(first.beside(c**2, c, None) for c in self.c[1:])]
        self.counts.factorizations += len(self.factors)
        self.counts.backend = first.backend

    def surround(self, q, turns, B, H, slopes):
        """Take the q of the middle stage, the stages' turns to there (s, nodes), complex, and its rows.

        H, and slopes, c M + C of every mode, are None where there is no mu.
        """
        self.q, self.turns, self.tied = q, turns, H is not None
        rows = np.vstack([B, H]) if self.tied else B
        self.borders, self.rows, self.corner = [], [], np.zeros((len(rows), len(rows)))
        if self.tied:
            self.corner[len(B) :, len(B) :] = B @ B.T
        for k, factor in enumerate(self.factors):
            self.counts.solves += len(rows)
            self.borders.append(Border(factor.solve(q, self._of_type(k, rows.T), True)))
            self.rows.append(np.vstack([B, (slopes[k] @ B.T).T]) if self.tied else B)

    def solve(self, on_e, on_lam, on_mu):
        """(w, mu, kappa), (s, .) each, of a right-hand side in the rows of e, lam and mu."""
        parts, m = (self._turned(on_e, self.turns), on_lam, on_mu), self.model.m
        found = None
        for k, (mode, factor) in enumerate(zip(self.tableau.modes, self.factors)):
            right, *below = (mode.column @ part for part in parts)
            self.counts.solves += 1
            y = factor.solve(self.q, self._of_type(k, right), True)
            w, x = self.borders[k].solve(y, self.rows[k], np.concatenate(below), self.corner)
            shares = [_back(mode, part) for part in (w, x[:m] - self.c[k] * x[m:] if self.tied else x, x[m:])]
            found = shares if found is None else [one + other for one, other in zip(found, shares)]
        w, mu, kappa = found
        return self._turned(w, self.turns.conj()), mu, kappa if self.tied else np.zeros_like(mu)

    def _of_type(self, k, x):
        return np.ascontiguousarray(x, complex if self.tableau.modes[k].paired else float)

    @staticmethod
    def _turned(x, turns):
        """Each pair of coordinates turned."""
        pairs = np.ascontiguousarray(x).view(complex)
        return (turns * pairs).view(float)


def _back(mode, x):
    """What the part x (k,) of a mode of W^T is of the stages, (s, k); of a pair twice its real part."""
    share = np.outer(mode.row, x)
    return 2.0 * share.real if mode.paired else share
