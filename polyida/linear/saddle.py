"""Saddle-point systems of Newton steps: factors, scaling, inertia, dependent constraints, and step matrices with a border of constraints.

```
[ S    B^T ] [ dq   ]     [ r   ]
[ B    0   ] [ dlam ] = - [ phi ]        S = c_m M + c_v C + c_q K,  B = phi_q
```
The inertia says whether a symmetric K is positive definite on the null space of B: `[[K, B^T], [B, 0]]` has m negative eigenvalues, m the
rows of B, exactly where K is. It is congruent to itself with `K + g B^T B` in place of K, any g, and so has the negative eigenvalues of that
and those of `-B (K + g B^T B)^-1 B^T` (Haynsworth 1968); those of a symmetric factor L D L^T are the negative entries of D (Sylvester).
"""

import math
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from polyida.errors import InputError
from polyida.linear.lu import LU, SYMMETRIC_MODE, SingularSystem, block_matrix, dense

DEPENDENT = 1e-6  # smallest singular value of the rows of phi_q, made of length one, below which they are
SCALINGS = ("none", "bottasso", "physical")


def typical(matrix):
    """The mean absolute value of the diagonal of a matrix; 1 if that is 0."""
    return float(np.mean(np.abs(matrix.diagonal()))) or 1.0


def scaling_size(kind, step_square, tangent):
    """The number by which rows of r are divided, which is also the unit of the multipliers; phi and q keep their units.

    kind: name of the scaling; "none" gives 1. step_square: beta h^2. tangent: the step matrix S.
    "bottasso" (Bottasso, Dopico, Trainelli 2008): 1 / (beta h^2). Any other, physical (Bauchau, Epple, Bottasso 2009): 1 / (beta h^2) times
    s = m_r + gamma h d_r + beta h^2 k_r, of typical mass, damping and stiffness: the mean of the diagonal of S.
    """
    return {"none": 1.0, "bottasso": 1.0 / step_square}.get(kind) or typical(tangent)


def assemble(tangent, phi_q, size=1.0, columns=None):
    """The scaled matrix, (n + m, n + m): dense if S is dense, CSC otherwise. columns: B of the upper right block, if it differs."""
    return block_matrix([[1 / size * tangent, (phi_q if columns is None else columns).T], [phi_q, None]])


class KKT:
    """A factor of the system. size: of the scaling; by default the power of two nearest the physical one, which rounds nothing.

    Raises SingularSystem.
    """

    def __init__(self, tangent, phi_q, size=None, columns=None):
        """Factor `[[S, B^T], [B, 0]]`, S = tangent (n, n), B = phi_q (m, n); columns: B of the upper right block, if it differs."""
        self.n, self.size = tangent.shape[0], size or 2.0 ** np.round(np.log2(typical(tangent)))
        self.lu = LU(assemble(tangent, phi_q, self.size, columns), pivoting=True)

    def solve(self, r, phi, transposed=False):
        """(dq, dlam) for the residuals r (n,) and phi (m,), or (n, k) and (m, k); transposed: with S^T in place of S."""
        x = self.lu.solve(-np.concatenate([1 / self.size * r, phi]), transposed)
        return x[: self.n], self.size * x[self.n :]


def require_independent(model, phi_q, q):
    """Raise InputError, naming the constraints, if the rows of phi_q (m, n) are linearly dependent."""
    rows = rows_of(phi_q, coordinate_sizes(model, q))
    if not np.all(rows.lengths > 0):
        names = ", ".join(model.constraint_name(int(k)) for k in np.flatnonzero(~(rows.lengths > 0))[:MOST])
        raise InputError(f"constraints {names}: phi_q has a row of zeros there; a constraint must depend on q")
    if least(rows) < DEPENDENT:
        last, others = first_dependent(model, rows)
        names = [model.constraint_name(k) for k in others]
        shown = ", ".join(names[:NAMED]) + f" and {len(names) - NAMED} more" * (len(names) > NAMED)
        row, solve = model.constraint_name(last), ', or let build(redundant="least-norm") leave it out' if model.is_scene else ""
        raise InputError(
            f"constraints {shown + ', ' * bool(shown)}{row} are redundant: {row} follows from the others (or contradicts them)"
            f"{_loop(model, last, others)}; remove it{solve}, or start elsewhere where only this position is singular"
        )


def first_dependent(model, rows):
    """(The first row that depends on those before it, those that it depends on), in their order, rows that keep bodies rigid before all others.

    The rows before it are independent, so that the dependence is unique: it is that of one loop, whatever other loops there are. The others are
    without those that keep bodies rigid.
    """
    m = len(rows.gram)
    order = np.array(sorted(range(m), key=lambda k: (not model.keeps_body(k), k)))
    gram, factor, squares = rows.gram[np.ix_(order, order)], np.zeros((m, m)), np.ones(m)
    for k in range(m):  # Cholesky's factor, up to the row whose distance from the rows before it is zero
        factor[k, :k] = solve_triangular(factor[:k, :k], gram[:k, k], lower=True) if k else 0.0
        squares[k] = gram[k, k] - factor[k, :k] @ factor[k, :k]
        if squares[k] < DISTANCE**2:
            break
        factor[k, k] = math.sqrt(squares[k])
    last = int(np.argmin(squares))
    shares = np.abs(solve_triangular(factor[:last, :last], factor[last, :last], trans=1, lower=True)) if last else np.zeros(0)
    others = [int(k) for k in order[:last][shares > SHARE * shares.max(initial=0.0)] if not model.keeps_body(k)]
    return int(order[last]), others


def _loop(model, last, others):
    """Which joint of a scene closes the loop of these rows, and the loop's other joints, in words; empty for other models."""
    if not model.is_scene:
        return ""
    parts = {k: name for name, rows in model.rows.items() for k in range(rows.start, rows.stop)}
    joints = list(dict.fromkeys(parts[k] for k in others if parts[k] != parts[last]))
    return (
        f"; {parts[last]!r} closes the loop of {', '.join(map(repr, joints))}"
        if joints
        else f"; rows of {parts[last]!r} depend on each other"
    )


SYMMETRIC = 1e-6  # largest asymmetry of K over its largest entry that is an error of derivatives by differences


def negative_directions(tangent, phi_q):
    """Number of negative eigenvalues of the tangent (n, n) on the null space of phi_q; None if the tangent is not symmetric.

    Raises SingularSystem if the sparse factor breaks down.
    """
    if not symmetric(tangent):
        return None
    m = phi_q.shape[0]
    size = typical(tangent)
    if not hasattr(tangent, "tocsc"):
        matrix = assemble(tangent, phi_q, size)
        return int(np.sum(np.linalg.eigvalsh((matrix + matrix.T) / 2) < 0)) - m
    if not m:
        return _negative(tangent / size)[0]
    from scipy.sparse import csr_array, diags_array

    rows = csr_array(phi_q)
    border = diags_array(1.0 / np.sqrt(rows.multiply(rows).sum(axis=1))) @ rows
    negative, solve = _negative(tangent / size + border.T @ border)
    schur = border @ solve(border.T.toarray())
    return negative + int(np.sum(np.linalg.eigvalsh((schur + schur.T) / 2) > 0)) - m


def symmetric(matrix):
    """True if a matrix is its transpose up to errors of derivatives by differences."""
    return abs(matrix - matrix.T).max() <= SYMMETRIC * abs(matrix).max()


def _negative(matrix):
    """(number of negative eigenvalues, solve) of a sparse symmetric matrix, from L D L^T without pivoting."""
    from scipy.sparse.linalg import splu

    try:
        lu = splu(matrix.tocsc(), **SYMMETRIC_MODE)
    except RuntimeError as error:
        raise SingularSystem("the tangent is singular") from error
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise SingularSystem("the tangent is singular to working precision")
    return int(np.sum(lu.U.diagonal() < 0)), lu.solve


MOST = 3  # constraints in a message of a singular position
NAMED = 8  # constraints of a dependent loop in a message
DISTANCE = 1e-5  # of a row of length one from the rows before it, below which it depends on them: ten times DEPENDENT
SHARE = 1e-4  # of the largest coefficient of a dependence: smaller ones are round-off
FULL = 10_000  # numbers of phi_q up to which a dense matrix is faster than a sparse one


class Rows(NamedTuple):
    """The lengths of the rows of phi_q in the sizes of the coordinates, (m,); the rows made of length one if they are above 0, (m, n), dense or
    sparse; and the Gram matrix of these, (m, m).
    """

    lengths: np.ndarray
    unit: Any
    gram: np.ndarray


def coordinate_sizes(model, q):
    """`1 / sqrt(M_ii)`, (n,): a unit of each coordinate, so that results do not depend on units; the mean for massless ones."""
    masses = np.abs(model.mass(q).diagonal())
    known = masses > 0
    return 1.0 / np.sqrt(np.where(known, masses, masses[known].mean() if known.any() else 1.0))


def rows_of(phi_q, sizes):
    """The Rows of a dense or sparse phi_q, its columns times the sizes (n,) of the coordinates."""
    sparse = hasattr(phi_q, "toarray") and np.prod(phi_q.shape) > FULL
    if sparse:
        from scipy.sparse import diags_array

        phi_q = phi_q @ diags_array(sizes)
        lengths = np.sqrt(phi_q.multiply(phi_q).sum(axis=1))
    else:
        phi_q = dense(phi_q) * sizes
        lengths = np.sqrt(np.einsum("ij,ij->i", phi_q, phi_q))
    divisor = np.where(lengths > 0, lengths, 1.0)
    unit = diags_array(1.0 / divisor) @ phi_q if sparse else phi_q / divisor[:, None]
    return Rows(lengths, unit, dense(unit @ unit.T))


def least(rows):
    """The smallest singular value of the unit rows, 0 to 1; nan if they are not finite."""
    if not math.isfinite(rows.gram.sum()):
        return math.nan
    return math.sqrt(max(0.0, float(np.linalg.eigvalsh(rows.gram)[0])))


def involved(model, rows):
    """Names of up to three constraints with the largest weights in the nearest linear dependence, in their order; rather of joints than of
    rows that keep bodies rigid."""
    weights = np.abs(np.linalg.eigh(rows.gram)[1][:, 0])
    of_joints = np.where([model.keeps_body(k) for k in range(len(weights))], 0.0, weights)
    weights = of_joints if of_joints.any() else weights
    heaviest = [int(k) for k in np.argsort(-weights)[:MOST] if weights[k] > 0.05 * weights.max()]
    return ", ".join(model.constraint_name(k) for k in sorted(heaviest))


def path_length(before, after):
    """Frobenius norm of the change of the unit rows between two Rows."""
    change = after.unit - before.unit
    values = change.data if hasattr(change, "toarray") else change
    return math.sqrt(np.vdot(values, values))


def cosine(before, after):
    """Cosine of the angle by which the space of the rows has turned; -1 if a combination of rows was reversed."""
    sign, size = np.linalg.slogdet(dense(before.unit @ after.unit.T))
    sizes = [np.linalg.slogdet(rows.gram)[1] for rows in (before, after)]
    return float(sign * np.exp(size - 0.5 * sum(sizes)))


MANY = 50  # constraints beyond which the border's columns are not made anew in every iteration


class Border:
    """A few rows and columns beside a factored S: constraints and their multipliers. X: S^-1 C.

    ```
    [ S   C ] [ x ]   [ b     ]       X = S^-1 C,  y = S^-1 b
    [ R   D ] [ w ] = [ below ]       (R X - D) w = R y - below,  x = y - X w
    ```
    C and S may be as old as S's factor. R and D are those of each solve, so that the last rows are solved to round-off for any age of S.
    """

    def __init__(self, X):
        """Store X = S^-1 C, (n, k), of the k columns C beside S; the rows R and the corner D come with each `solve`."""
        self.X, self.rows, self.lu = X, None, None

    def solve(self, y, rows, below, corner=0.0):
        """(x, w) from `y = S^-1 b`, rows R (k, n), below (k,) and corner D, (k, k) or 0; y and below may have columns. Raises SingularSystem.

        The factor for the same rows and their corner is made once.
        """
        if not self.X.shape[1]:
            return y, np.zeros(below.shape)
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
    """`S = c_m M + c_v C + K` of a model, C = dr/dv and K = dr/dq there; c_m and c_v are real or complex.

    A user's model returns an own one from `step_matrix`: a subclass with another factor, which overrides `factor`, `beside`, `solve` and, if its
    S has an inverse at any state, `stands_alone`. By default S is factored by LAPACK or SuperLU. If S alone is singular, or may be, as with
    coordinates without mass, or constraints are many, `saddle` factors the whole matrix with its constraints, whose B is as old as S.

    Parameters
    ----------
    model : Model
        The model.

    Attributes
    ----------
    made_at : (1 + 3 n + m,) float
        t, q, v, a, lam of the factor; `factor` sets it.
    near_any_state : bool
        True if `solve` fits S to its q, as S turns with the bodies: it then serves far from the state of the factor.
    caution : float
        Share of Newton's tolerance to which a correction is trusted: 0.5 if contraction becomes slower in a step, 1 with near_any_state.
    solves : int
        Number of solves that `factor` took.
    backend : str
        Name in summaries.
    """

    backend = ""
    near_any_state = False
    caution = 0.5

    def __init__(self, model: Any) -> None:
        """Take the model; `factor` makes S."""
        self.model, self.made_at, self.solves = model, np.zeros(0), 0
        self.S: Any = None
        self.lu: Any = None
        self.border: Any = None
        self.whole: Any = None

    def factor(self, t: float, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, c_m: complex, c_v: complex) -> None:
        """Factor S at a state; a subclass may wait for the first solve. A singular S raises SingularSystem at the factor or at the solve."""
        self.made_at = np.concatenate([[t], q, v, a, lam])
        self._set_matrix(self.model.tangent(t, q, v, a, lam, c_m, c_v, 1.0), c_m)

    def _set_matrix(self, S, c_m):
        """Take S and its c_m and factor S, unless it is singular; all earlier factors are dropped."""
        self.S, self.c_m, self.lu, self.border, self.whole = S, c_m, None, None, None
        with suppress(SingularSystem):
            self.lu = LU(S)

    def again(self, made_at: NDArray, c_m: complex, c_v: complex) -> None:
        """Repeat the factorization of S at the state made_at, (t, q, v, a, lam) in one array."""
        q, v, a, lam = np.split(made_at[1:], np.cumsum([self.model.n] * 3))
        self.factor(float(made_at[0]), q, v, a, lam, c_m, c_v)

    def beside(self, c_m: complex, c_v: complex, change: Any) -> "StepMatrix":
        """The step matrix with other c_m and c_v, S + change, from M and C of the same state: nothing is evaluated again."""
        other = type(self)(self.model)
        other.made_at = self.made_at
        other._set_matrix(self.S + change, c_m)
        return other

    def solve(self, q: NDArray, b: NDArray, transposed: bool = False) -> NDArray:
        """S^-1 b, or S^-T b, b (n,) or (n, k), at q near to where S was factored. Raises SingularSystem where S has no inverse."""
        if self.lu is None:
            raise SingularSystem("the step matrix is singular")
        return self.lu.solve(b, transposed)

    def columns(self, q: NDArray, B: Any) -> NDArray:
        """S^-1 B^T, (n, m), at q near to where S was factored; B (m, n), dense or sparse. Raises SingularSystem."""
        return self.solve(q, dense(B).T)

    def saddle(self, t: float, q: NDArray, lam: NDArray, r: NDArray, phi: NDArray) -> tuple[NDArray, NDArray]:
        """(dq, dlam) of `S dq + B^T dlam = -r`, `B dq = -phi`, B that of (t, q) itself, for r (n,) and phi (m,), or (n, k) and (m, k).

        Raises SingularSystem.
        """
        if self.whole is None and self.border is None and (self.model.m > MANY or not self.stands_alone()):
            at = float(self.made_at[0]), self.made_at[1 : self.model.n + 1]
            self.whole = KKT(self.S, self.model.phi_q(*at), columns=self.model.columns_of_forces(*at, self.made_at[1 + 3 * self.model.n :]))
        if self.whole:
            return self.whole.solve(r, phi)
        B = self.model.phi_q(t, q)
        if self.border is None or self.near_any_state or self.model.needs.phi_q_varies or self.model.needs.driven:
            columns = self.model.columns_of_forces(t, q, lam)
            self.border = Border(self.columns(q, B if columns is None else columns))
        return self.border.solve(self.solve(q, -r), B, -phi)

    def positive_definite(self) -> bool:
        """True if S is known to be positive definite: of K, an equilibrium is then stable without another factor."""
        return False

    def stands_alone(self) -> bool:
        """True if S certainly has an inverse; with constraints, some coordinates may be held by these alone."""
        return self.lu is not None and not (self.model.m > 0 and self.lu.doubtful())


class WholeMatrix(StepMatrix):
    """A StepMatrix by one factor of `[[S, B^T], [B, 0]]`, scaled on request; its B is as old as S."""

    def __init__(self, model, scaling):
        """Take the model and the scaling of its whole matrix."""
        super().__init__(model)
        self.scaling = scaling

    def factor(self, t, q, v, a, lam, c_m, c_v):
        """Factor the whole matrix at a state. Raises SingularSystem."""
        S = self.model.tangent(t, q, v, a, lam, c_m, c_v, 1.0)
        self.made_at = np.concatenate([[t], q, v, a, lam])
        self.whole = KKT(S, self.model.phi_q(t, q), scaling_size(self.scaling, 1 / abs(c_m), S))


ENOUGH = 1e-11  # of |x|: the error at which refinement ends
LEFT = 1e3 * ENOUGH  # of |x|: a smaller correction that no longer decreases is round-off
SLOW = 0.3  # contraction above which the factor is repeated
CORRECTIONS = 12  # with one factor


class ExactSaddle:
    """The system at one state after another, of a model with c_m and c_v. counts: anything that counts factorizations and solves.

    slopes (m, n): in place of B in the lower rows, and of B^T in the right columns of the transposed system; `at` sets it to B.
    """

    def __init__(self, model, c_m, c_v, counts):
        """Take c_m and c_v of `S = c_m M + c_v C + K`; nothing is evaluated yet."""
        self.model, self.c_m, self.c_v, self.counts = model, c_m, c_v, counts
        self.system = self.direct = self.M = self.K = self.C = self.S = self.B = self.slopes = None
        self.here = ()

    def at(self, t, q, v, a, lam):
        """Evaluate M, K, C, B and S at a state; the next solve factors them."""
        model, self.here, self.direct = self.model, (t, q, v, a, lam), None
        self.C = model.force_v(t, q, v) if model.needs.velocity_forces else None
        if model.is_scene and model.small:
            self.K, self.M, self.B = model.small_tangent(t, q, v, lam), model.small_mass(), model.small_phi_q(t, q)
            self.C = None if self.C is None else self.C.toarray()
        else:
            self.K, self.M, self.B = model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0), model.mass(q), model.phi_q(t, q)
        self.slopes, self.S = self.B, self.c_m * self.M + self.K
        self.S = self.S if self.C is None else self.S + self.c_v * self.C

    def solve(self, right, below, transposed=False):
        """(x, mu) with `S x + B^T mu = right`, `slopes x = below`, or of the transposed system. Raises SingularSystem.

        An old factor is refined by residuals of the present matrices; it is made anew where that is slow.
        """
        if isinstance(self.S, np.ndarray):
            return self._direct(right, below, transposed)
        S, self.system = self.S.T if transposed else self.S, self.system or self.model.step_matrix()
        if not self.system.near_any_state:
            return self._direct(right, below, transposed)
        columns, rows = (self.slopes, self.B) if transposed else (self.B, self.slopes)
        x = self._refine(S, right, below, columns, rows) if len(self.system.made_at) else None
        if x is None:
            self.system = self.model.step_matrix()
            self.system.factor(*self.here, self.c_m, self.c_v)
            self.counts.factorizations += 1
            self.counts.solves += self.system.solves
            x = self._refine(S, right, below, columns, rows)
        return self._direct(right, below, transposed) if x is None else x

    def _direct(self, right, below, transposed):
        """(x, mu) by one factor of the whole system at this state, made at the first call."""
        if self.direct is None:
            self.counts.factorizations += 1
            self.direct = KKT(self.S, self.slopes, columns=self.B)
        self.counts.solves += 1
        return self.direct.solve(-right, -below, transposed)

    def _refine(self, S, right, below, columns, border):
        """(x, mu) by iterative refinement with the factor at hand; None if it converges too slowly.

        S: the present matrix, transposed for that system; columns (m, n): the transpose of its columns beside S; border: its lower rows.
        """
        t, q, _, _, lam = self.here
        x, mu, r, rows, last = np.zeros_like(right), np.zeros_like(below), right, below, np.inf
        for _ in range(CORRECTIONS):
            dx, dmu = self.system.saddle(t, q, lam, -r, -rows)
            self.counts.solves += 1
            x, mu, moved = x + dx, mu + dmu, np.linalg.norm(dx)
            size, rate = np.linalg.norm(x), moved / last
            ahead = rate / (1.0 - rate) if 0.0 < rate < 0.5 else 1.0
            if moved * ahead <= ENOUGH * size:
                return x, mu
            if rate > SLOW:
                break
            r, rows, last = right - S @ x - columns.T @ mu, below - border @ x, moved
        return (x, mu) if moved <= LEFT * size else None
