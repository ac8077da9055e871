"""Step matrices: `S = c_m M + c_v C + K`, factored at one state and used near it while Newton contracts, and the system with S exact at a state."""

from contextlib import suppress

import numpy as np

from polyida.linear.lu import LU, SingularSystem, dense
from polyida.linear.saddle import KKT, scaling_size

MANY = 50  # constraints beyond which the border's columns are not made anew in every iteration


class Border:
    """A few rows and columns around a factored S: constraints and their multipliers beside a step matrix. X: S^-1 C.

    ```
    [ S   C ] [ x ]   [ b     ]       X = S^-1 C,  y = S^-1 b
    [ R   D ] [ w ] = [ below ]       (R X - D) w = R y - below,  x = y - X w
    ```
    C and S may be as old as S's factor; R and D are those of each solve, so that its last rows hold to round-off however old S is.
    """

    def __init__(self, X):
        self.X, self.rows, self.lu = X, None, None

    def solve(self, y, rows, below, corner=0.0):
        """(x, w) from `y = S^-1 b`, rows R (k, n), below (k,) and corner D, (k, k) or 0. Raises SingularSystem.

        What the same rows, and their corner, need is made once.
        """
        if not self.X.shape[1]:
            return y, np.zeros(0)
        if rows is not self.rows:
            self.rows = None
            try:
                self.lu = LU(rows @ self.X - corner)
            except SingularSystem:
                raise SingularSystem("the constraints' system is singular") from None
            self.rows = rows
        w = self.lu.solve(rows @ y - below)
        return y - self.X @ w, w


class StepMatrix:
    """`S = c_m M + c_v C + K` of any model, C = dr/dv and K = dr/dq there; c_m and c_v are real or complex.

    made_at: what the factor was made from, in one array; `again` makes it anew from that. solves: those that its border took.
    Where S alone is singular, or may be, as with coordinates that have no mass, or constraints are many, `saddle` takes the whole matrix with
    its constraints, whose B is as old as S.
    """

    backend = ""
    near_any_state = False  # True of one that turns with its bodies, and so is of use at states far from where it was made
    caution = 0.5  # share of Newton's tolerance: a matrix that does not turn with its bodies contracts ever slower in a step

    def __init__(self, model):
        self.model, self.made_at, self.solves = model, np.zeros(0), 0
        self.S = self.lu = self.border = self.whole = None

    def factor(self, t, q, v, a, lam, c_m, c_v):
        """Factor S at a state; what else a solve needs is made when it is first asked for."""
        self.made_at = np.concatenate([[t], q, v, a, lam])
        self._take(self.model.tangent(t, q, v, a, lam, c_m, c_v, 1.0), c_m)

    def _take(self, S, c_m):
        self.S, self.c_m, self.lu, self.border, self.whole = S, c_m, None, None, None
        with suppress(SingularSystem):
            self.lu = LU(S)

    def again(self, made_at, c_m, c_v):
        """Factor S as it was factored before."""
        self.factor(float(made_at[0]), *np.split(made_at[1:], np.cumsum([self.model.n] * 3)), c_m, c_v)

    def beside(self, c_m, c_v, change):
        """The same with other c_m and c_v, from what that changes of S, M and C where it was factored: nothing is evaluated anew."""
        other = type(self)(self.model)
        other.made_at = self.made_at
        other._take(self.S + change, c_m)
        return other

    def solve(self, q, b, transposed=False):
        """S^-1 b, or S^-T b, b (n,) or (n, k), at q near to where S was factored. Raises SingularSystem where S has no inverse."""
        if self.lu is None:
            raise SingularSystem("the step matrix is singular")
        return self.lu.solve(b, transposed)

    def saddle(self, t, q, lam, r, phi):
        """(dq, dlam) of `S dq + B^T dlam = -r`, `B dq = -phi`, B that of (t, q) itself. Raises SingularSystem."""
        if self.whole is None and self.border is None and (self.model.m > MANY or not self.stands_alone()):
            at = float(self.made_at[0]), self.made_at[1 : self.model.n + 1]
            self.whole = KKT(self.S, self.model.phi_q(*at))
        if self.whole:
            return self.whole.solve(r, phi)
        B = self.model.phi_q(t, q)
        if self.border is None or self.model.needs.phi_q_varies or self.model.needs.driven:
            self.border = Border(self.solve(q, dense(B).T))
        return self.border.solve(self.solve(q, -r), B, -phi)

    def stands_alone(self):
        """Whether S has an inverse, beyond doubt where there are constraints that may be all that holds some coordinates."""
        return self.lu is not None and not (self.model.m > 0 and self.lu.doubtful())


class WholeMatrix(StepMatrix):
    """The same by one factor of `[[S, B^T], [B, 0]]`, scaled on request; its B is as old as S."""

    def __init__(self, model, scaling):
        super().__init__(model)
        self.scaling = scaling

    def factor(self, t, q, v, a, lam, c_m, c_v):
        """Factor the whole matrix at a state. Raises SingularSystem."""
        S = self.model.tangent(t, q, v, a, lam, c_m, c_v, 1.0)
        self.made_at = np.concatenate([[t], q, v, a, lam])
        self.whole = KKT(S, self.model.phi_q(t, q), scaling_size(self.scaling, 1 / abs(c_m), S))


ENOUGH = 1e-11  # of |x|: the error at which refinement ends
LEFT = 1e3 * ENOUGH  # of |x|: below it a correction that no longer falls is round-off
SLOW = 0.3  # contraction above which the factor is made anew
MOST = 12  # corrections with one factor


class ExactSaddle:
    """The system at one state after another, of a model with c_m and c_v. counts: anything that counts factorizations and solves."""

    def __init__(self, model, c_m, c_v, counts):
        self.model, self.c_m, self.c_v, self.counts = model, c_m, c_v, counts
        self.system = self.direct = self.M = self.K = self.C = self.S = self.B = None
        self.here = ()

    def at(self, t, q, v, a, lam):
        """Take the matrices of a state."""
        model, self.here, self.direct = self.model, (t, q, v, a, lam), None
        self.C = model.force_v(t, q, v) if model.needs.velocity_forces else None
        if model.is_scene and model.small:
            self.K, self.M, self.B = model.small_tangent(t, q, v, lam), model.small_mass(), model.small_phi_q(t, q)
            self.C = None if self.C is None else self.C.toarray()
        else:
            self.K, self.M, self.B = model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0), model.mass(q), model.phi_q(t, q)
        self.S = self.c_m * self.M + self.K
        self.S = self.S if self.C is None else self.S + self.c_v * self.C

    def solve(self, right, below, transposed=False):
        """(x, mu). Raises SingularSystem."""
        if isinstance(self.S, np.ndarray):
            return self._direct(right, below, transposed)
        S, self.system = self.S.T if transposed else self.S, self.system or self.model.step_matrix()
        if not self.system.near_any_state:
            return self._direct(right, below, transposed)
        found = self._refine(S, right, below) if len(self.system.made_at) else None
        if found is None:
            self.system = self.model.step_matrix()
            self.system.factor(*self.here, self.c_m, self.c_v)
            self.counts.factorizations += 1
            self.counts.solves += self.system.solves
            found = self._refine(S, right, below)
        return self._direct(right, below, transposed) if found is None else found

    def _direct(self, right, below, transposed):
        if self.direct is None:
            self.counts.factorizations += 1
            self.direct = KKT(self.S, self.B)
        self.counts.solves += 1
        return self.direct.solve(-right, -below, transposed)

    def _refine(self, S, right, below):
        """(x, mu), or None where the factor is too old."""
        t, q, _, _, lam = self.here
        x, mu, r, rows, last = np.zeros_like(right), np.zeros_like(below), right, below, np.inf
        for _ in range(MOST):
            dx, dmu = self.system.saddle(t, q, lam, -r, -rows)
            self.counts.solves += 1
            x, mu, moved = x + dx, mu + dmu, np.linalg.norm(dx)
            size, rate = np.linalg.norm(x), moved / last
            ahead = rate / (1.0 - rate) if 0.0 < rate < 0.5 else 1.0
            if moved * ahead <= ENOUGH * size:
                return x, mu
            if rate > SLOW:
                break
            r, rows, last = right - S @ x - self.B.T @ mu, below - self.B @ x, moved
        return (x, mu) if moved <= LEFT * size else None
