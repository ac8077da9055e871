"""The factored step matrices of a step of any model, one for each mode of the tableau, and what its systems need around them.

`WholeModes` factors the system of one mode as a whole, its rows and columns divided by characteristic sizes or raw.

c = l/h, l an eigenvalue of `W = A^-1`, real or complex (radau/tableau.py), `G = B D^-1`, `H = d(B v + phi_t)/dq` (radau/step.py):

    |  c I    -I             G^T |  |dq  |     q' - v + G^T mu
    |  K     c M + C   B^T       |  |dv  |     M v' + g + B^T lam
    |  B                         |  |dlam|     phi
    |  H      B                  |  |dmu |     B v + phi_t

| scaling | unknowns measured in | rows measured in |
|---|---|---|
| none | 1 | 1 |
| bottasso | dv: c, dlam: c^2, dmu: c | q': c, r: c^2, B v + phi_t: c |
| physical | dv: c, dlam: s, dmu: c | q': c, r: s, B v + phi_t: c |

with |c| for c, s the mean size of the diagonal of `S = K + c C + c^2 M`. Form "index3" has neither dmu nor the last row. Raw, the condition
number grows as h^-3 (index3) or h^-2 (ggl) where h is small; scaled, it is flat. Sources: as linear/saddle.py's.
"""

import numpy as np

from polyida.linear.lu import LU, ScaledLU, dense, first_order_matrix, first_order_sizes
from polyida.linear.saddle import Border, StepMatrix, typical
from polyida.model.differences import bend, reach_along

NOTHING = 1e-12  # of the largest mass: smaller masses count as zero


def lift(model, shares):
    """Weights (n,) of `phi_q^T mu` in q': the mean mass over the mass of each coordinate, from their shares in the total mass.

    1 for massless coordinates, and for all if the model has uniform units.
    """
    heavy = shares > NOTHING * shares.max()
    masses = np.where(heavy, 1.0 / (len(shares) * np.where(heavy, shares, 1.0)), 1.0)
    return np.ones_like(shares) if model.uniform_units else masses


def columns_at(model, t, q, lam, B):
    """`(dr/dlam)^T`, (m, n), which is B without forces that grow with lam."""
    columns = model.columns_of_forces(t, q, lam)
    return B if columns is None else columns


class Rows:
    """The constraint rows at (t, q, v): B (m, n), columns (m, n) of their forces, and H and G (m, n) if there is mu.

    columns: B itself, or with the forces that grow with lam (friction). lift: the diagonal of D^-1 (n,), or None without mu. on_q, on_v: factors
    of dq and dv in the rows; both: factor of dq with dv = c dq, the second block reduced by c times the first. ida/tables.py's FormRows has the
    same B, columns, G, on_q, on_v, both, tied, below and corner.
    """

    def __init__(self, model, t, q, v, lam, lift):
        """Evaluate B, and H by differences of it along the motion if there is mu."""
        self.B, self.tied = dense(model.phi_q(t, q)), lift is not None
        self.columns = columns_at(model, t, q, lam, self.B)
        level = np.zeros_like(self.B)
        self.G = self.B * lift if self.tied else self.B[:0]
        self.H = bend(lambda s: dense(model.phi_q(t + s, q + s * v)), self.B, reach_along(q, v))[0] if self.tied else level[:0]
        self.both = self.on_q = np.vstack([self.B, self.H])
        self.on_v = np.vstack([level, self.B]) if self.tied else level

    def below(self, c, r3, r4):
        """Right-hand sides of the rows, from the residuals r3 of phi and r4 of phi'; the second block reduced by c times the first."""
        return np.concatenate([-r3, c * r3 - r4]) if self.tied else -r3

    def corner(self):
        """Block of the multipliers in the rows."""
        m = len(self.B)
        corner = np.zeros((len(self.both), len(self.both)))
        if self.tied:
            corner[m:, m:] = self.B @ self.G.T
        return corner


class FactorWithRows:
    """The factor of a matrix in place of a StepMatrix."""

    def __init__(self, S):
        """Factor the square matrix S, dense or sparse. Raises SingularSystem."""
        self.lu, self.dtype = LU(S), S.dtype

    def solve(self, q, b):
        """S^-1 b, b (n,) or (n, k); q has no influence."""
        return self.lu.solve(b)

    def columns(self, q, B):
        """S^-1 B^T, (n, rows of B); q has no influence."""
        return self.lu.solve(B.T.astype(self.dtype))


class Matrices:
    """S of every mode for steps of h, factored on first use at `made_at`: t, q, v, a and lam in one array.

    M and `slopes`, c M + C of each mode, are those at this state. factors: StepMatrix of each mode, or FactorWithRows if an S may be singular
    alone. singular_S: those S, factored in `surround` as S + s C^T R (`_hold`); empty otherwise. weight_of_rows: that s; corrections subtract
    s r3 from dlam. borders: of each mode. rows_turn: True if the factors turn with the bodies, and the border with them. last: (mode, r,
    free correction) of the last request.
    """

    def __init__(self, model, modes, h, made_at, linear="auto"):
        """Store the state; `make` evaluates the matrices there and factors them."""
        self.linear = linear
        self.model, self.modes, self.made_at = model, modes, made_at
        self.c = [mode.value / h for mode in modes]
        self.factors = self.borders = None
        self.backend, self.rows_turn = "", False

    def make(self):
        """Factor S unless it is factored. Raises SingularSystem."""
        if self.factors is not None:
            return
        at, first = self._evaluated(), StepMatrix(self.model) if self.linear == "kkt" else self.model.step_matrix()
        first.factor(*at, self.c[0] ** 2, self.c[0])
        more = ((c, c * slope - self.c[0] * self.slopes[0]) for c, slope in zip(self.c[1:], self.slopes[1:]))
        steps = [first, *(first.beside(c**2, c, change) for c, change in more)]
        self.backend, self.weight_of_rows = first.backend, 0.0
        self.factors, self.rows_turn = steps, first.near_any_state
        self.singular_S = [] if all(step.stands_alone() for step in steps) else [step.S for step in steps]

    def _evaluated(self):
        """(t, q, v, a, lam) of `made_at`; M, C and the slopes are evaluated there."""
        model, at = self.model, (float(self.made_at[0]), *np.split(self.made_at[1:], np.cumsum([self.model.n] * 3)))
        self.M, self.C = model.mass(at[1]), model.force_v(*at[:3]) if model.needs.velocity_forces else None
        self.slopes = [c * self.M if self.C is None else c * self.M + self.C for c in self.c]
        return at

    def _hold(self, C, R):
        """Factor S + s C^T R, C the columns and R the first block of rows, for a singular S: only constraints hold coordinates without mass.

        With `R dq = -r3` only dlam changes, by s r3; R is therefore the rows themselves.
        """
        size = float(np.abs(self.singular_S[0].diagonal()).max(initial=0.0))
        largest = (max(float(np.abs(x).max(initial=0.0)), 1e-300) for x in (C, R))
        self.weight_of_rows = size / np.prod(list(largest)) if self.model.m else 0.0
        held = self.weight_of_rows * (C.T @ R)
        self.factors = [FactorWithRows(S + (type(S)(held) if hasattr(S, "tocsc") else held)) for S in self.singular_S]

    @property
    def lam(self):
        """Multipliers lam, (m,), of the state `made_at`."""
        return self.made_at[1 + 3 * self.model.n :]

    def surround(self, rows, q, counts):
        """Set the constraint rows at q and solve for the columns of the border."""
        self.q = q
        if self.singular_S:
            counts.factorizations += len(self.singular_S)
            self._hold(rows.columns, rows.both[: self.model.m])
        counts.solves += len(self.modes) * len(rows.both)
        self.last = (None,)
        self.rows, self.corner, self.borders = rows, rows.corner(), []
        for k, slope in enumerate(self.slopes):
            X = self.factors[k].columns(q, rows.columns)
            self.borders.append(Border(np.hstack([X, self._free(k, slope @ rows.G.T)]) if rows.tied else X))

    def inertia(self, v, a):
        """The product `C v + M a`, (n,), with C = dr/dv and M at the state `made_at`, of any v and a (n,)."""
        force = self.M @ a
        return force if self.C is None else force + self.C @ v

    def corrections(self, k, r, r3, r4):
        """(dq, dlam, dmu) of mode k from its residuals. Raises SingularSystem."""
        m = len(self.rows.B)
        if self.last[0] != k or not np.array_equal(r, self.last[1]):  # IDA asks for a second correction, with other rows
            self.last = k, r, -self._free(k, r)
        dq, w = self.borders[k].solve(self.last[2], self.rows.both, self.rows.below(self.c[k], r3, r4), self.corner)
        return dq, w[:m] - self.weight_of_rows * r3, w[m:]

    def _free(self, k, b):
        """S^-1 b of mode k, without its border of constraints; complex for a pair of eigenvalues."""
        return self.factors[k].solve(self.q, b.astype(complex) if self.modes[k].paired else b)


def whole_matrix(c, K, slope, rows):
    """(the matrix, typical size s of S) of K, slope = c M + C and the constraints' Rows: CSC where K is sparse, else dense."""
    mu = rows.G.T if rows.tied else None
    return first_order_matrix(c, K, slope, rows.columns.T, mu, rows.on_q, rows.on_v), typical(K + c * slope)


def sizes(scaling, c, s, n, m, tied):
    """Factors (of rows, of columns), (N,) each, of a scaling; tied: True if there is mu."""
    size = 1.0 if scaling == "none" else abs(c)
    return first_order_sizes(size, s if scaling == "physical" else size**2, n, m, (0, 1) if tied else (0,), tied)


class WholeModes(Matrices):
    """The Matrices of a step with one factor of each mode's whole matrix; K, M and C are those at `made_at`, the rows those of `surround`."""

    def __init__(self, model, modes, h, made_at, scaling):
        """Take the scaling of the whole matrices; `make` evaluates K."""
        super().__init__(model, modes, h, made_at)
        self.scaling, self.K = scaling, None

    def make(self):
        """Evaluate K unless it is evaluated."""
        if self.K is None:
            self.K = self.model.tangent(*self._evaluated(), 0.0, 0.0, 1.0)

    def surround(self, rows, q, counts):
        """Set the constraint rows; the whole matrices are factored on first use."""
        counts.factorizations += len(self.modes)
        self.rows, self.borders = rows, [None] * len(self.modes)

    def corrections(self, k, r, r3, r4):
        """(dq, dlam, dmu) of mode k from its residuals r, r3, r4, by the factor of its whole matrix. Raises SingularSystem."""
        n, m = self.model.n, self.model.m
        if self.borders[k] is None:
            matrix, s = whole_matrix(self.c[k], self.K, self.slopes[k], self.rows)
            self.borders[k] = ScaledLU(matrix, *self._sizes(self.c[k], s))
        x = -self.borders[k].solve(np.concatenate([np.zeros(n), r, r3, r4]))  # q' has no residual
        return x[:n], x[2 * n : 2 * n + m], x[2 * n + m :]

    def _sizes(self, c, s):
        """Factors (of rows, of columns) of the whole matrix of a mode; s: typical size of its S."""
        return sizes(self.scaling, c, s, self.model.n, self.model.m, self.rows.tied)
