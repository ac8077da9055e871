"""The adjoint of a step of a scene with s stages: refinement with a stale co-rotated factor and the exact products (products.py).

In: the states of the stages, and right sides of a step (adjoint/tables.py). Out: w, the multipliers and the products of the step.

The step's system is, with B, C, H, K and M of each stage (exact_steps.py, radau_sweep.py; generalized-alpha has one stage),

    K_i^T w_i + B_i^T mu_i + sum_j to_v_ij (C_j^T w_j + B_j^T kappa_j) + to_a_ij M w_j + H_i^T kappa_i + (B_i^T mu_i)_q^T v*_i = right_i
    B_i w_i = below_i,    B_i v*_i = 0,    v*_i = C_i^T w_i + B_i^T kappa_i + sum_j to_v_ij M w_j + [b_v]

b_v, the adjoint of v at the step's end, stands in the last stage; the terms of kappa and mu_i are there where the step has mu. With
`to_v = sum c row column^T`, to_a = to_v^2, it falls into one system for each eigenvalue c (scene_modes.py) if all matrices are those of one
state. Each correction solves these for the residuals, turned from the frames of each stage to those of the middle one.

Several objectives are columns of the right-hand side. Columns that have converged are left out of further corrections.
"""

from contextlib import contextmanager, nullcontext
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.adjoint import products
from polyida.adjoint.products import DZ, VZ, Scratch, arrays_of, scratch, viscosity_of
from polyida.adjoint.refinement import FRESH, OLD, FactorRecord, convergence, count_work, new_record, too_old
from polyida.adjoint.scene_modes import KAPPA, MU, Mode, MuTerms, add_change, correct, prepare_mode
from polyida.adjoint.tables import AdjointTable, by_stages
from polyida.assembly import joints
from polyida.assembly.increments import drive_table
from polyida.assembly.own_laws import Laws
from polyida.assembly.rate_multipliers import factor_rates, rate_multipliers
from polyida.environment import threads
from polyida.errors import DONE, REFACTOR, SINGULAR
from polyida.jit import entry, fast, pack, part
from polyida.jit.intrinsics import COLUMNS, pointer
from polyida.linear.dense import clear
from polyida.linear.lu import FactorCache
from polyida.linear.team import Helpers
from polyida.system import ADJOINT, ENTRIES, scene_functions
from polyida.system import scene as forward

EXACT = 1e-11  # of |w|: refinement leaves no less
MAX_CORRECTIONS = 60  # corrections of a step with one factor


@pack
class SceneAdjointWork(NamedTuple):
    """The workspace of a scene. A field that is None is a part that the step does not have; the code for it is then not compiled.

    first, second, third: the Scratch of each stage. They are three fields, not a tuple, because compiled code cannot index a tuple of packs by
    a variable (see `stage`); with fewer stages the last one is repeated.
    """

    scene: tuple  # of `arrays_of`
    viscosity: np.ndarray  # of `viscosity_of`
    laws: Laws
    real: Mode | None  # of the real eigenvalue of to_v
    pair: Mode | None  # of one eigenvalue of a complex pair
    tied: MuTerms | None  # of mu
    drives: np.ndarray  # (count, s, profiles, 3) of the stages
    q: np.ndarray  # (count, s, n) of the stages
    v: np.ndarray  # (count, s, n)
    lam: np.ndarray  # (count, s, m)
    to_v: np.ndarray  # (s, s)
    to_a: np.ndarray  # (s, s)
    enough: float  # accepted error of w over |w|
    first: Scratch  # state and products of stage 0
    second: Scratch  # of stage 1
    third: Scratch  # of stage 2
    slopes: np.ndarray  # (s, .) phi_z
    turn: np.ndarray  # (s, nodes, 2) rotations from a stage to the middle one
    r: np.ndarray  # (s, columns, nodes, 2) residuals
    dw: np.ndarray  # (s, columns, nodes, 2) corrections of w
    rows: np.ndarray  # (1 or 2, s, columns, m) residuals of the rows
    change: np.ndarray  # (1 or 2, s, columns, m) corrections of the multipliers
    which: np.ndarray  # (columns,) first the numbers of the columns that have not converged
    small: np.ndarray  # (columns,) True for those of them that have in this iteration
    left: np.ndarray  # (columns,) first the numbers of the others
    unconstrained: np.ndarray  # (columns,) |w| of the last solve without constraints
    largest: np.ndarray  # (columns,) the largest such |w|
    record: FactorRecord


@part
def stage(work, number):
    """The Scratch of the stage with this number."""
    x = work.first
    if number == 1:
        x = work.second
    if number == 2:
        x = work.third
    return x


@part
def pairs(work, vector):
    """A vector (n,) as (nodes, 2)."""
    return vector.reshape(work.r.shape[2:])


@entry
def solve(work, step, right, below, b_v, fields, multipliers, out):
    """Solve the system of the head for w and the multipliers of one step, by refinement from their predictions. Returns a status.

    right, fields (s, columns, nodes, 2): right sides and w; below (s, columns, m); b_v (columns, nodes, 2); multipliers (1 or 2, s, columns,
    m): mu, and kappa. out (3, s, columns, nodes, 2): the products, which is SceneAdjoint.products: the Scratches of work write there. The
    status is REFACTOR too if the last steps cost more than the mean of all steps with the factor, its making included.
    """
    record, shape, (_, stages, columns, m) = work.record, work.r.shape, work.rows.shape
    if too_old(record):
        return REFACTOR
    right, below, b_v = carray(pointer(right), shape), carray(pointer(below), (stages, columns, m)), carray(pointer(b_v), shape[1:])
    fields, multipliers = carray(pointer(fields), shape), carray(pointer(multipliers), work.rows.shape)
    for column in range(columns):
        work.which[column] = column
    if not prepare_step(work, step, fields, multipliers, b_v):
        return SINGULAR
    status = refine(work, step, right, below, b_v, fields, multipliers)
    if status == DONE:
        record.slowest[0] = OLD
        stage_products = carray(pointer(out), (3, *shape))
        for i in range(stages):
            for column in range(columns if not stage(work, i).slowing.shape[1] else 0):
                clear(stage_products[1, i, column])  # the sweep of Radau IIA adds to them
    return status


@part
def prepare_step(work, step, fields, multipliers, b_v):
    """Evaluate the stages of a step and the first products, and set the factors' frames and borders. False if B B^T is singular."""
    middle = work.r.shape[0] // 2
    for i in range(work.r.shape[0]):
        x, drives, u, v = stage(work, i), work.drives[step, i], pairs(work, work.q[step, i]), pairs(work, work.v[step, i])
        products.hold_state(work.scene, work.laws, drives, u, v, work.lam[step, i], x)
        joints.joint_jacobian(work.scene.links, drives, x.points[DZ], work.slopes[i])
        evaluate_mu_terms(work, work.tied, step, i)
    multiply(work, step, fields, multipliers, b_v, work.which, work.which, True)
    if not prepare_rates(work, work.tied, step, middle):
        return False
    prepare_mode(work.scene.links, work.real, stage(work, middle), work.slopes[middle])
    prepare_mode(work.scene.links, work.pair, stage(work, middle), work.slopes[middle])
    return True


@part
def evaluate_mu_terms(work, terms, step, number):
    """Evaluate the terms of mu at a stage, unless the step has none (terms is None)."""
    if terms is not None:
        links, x, drives = work.scene.links, stage(work, number), work.drives[step, number]
        joints.point_values(links, pairs(work, work.v[step, number]), x.points[VZ])
        joints.joint_rate_jacobian(links, drives, x.points[DZ], x.points[VZ], terms.rates[number])
        terms.curvature[number] = 0.0
        joints.joint_curvature(links, drives, terms.mu[step, number], terms.curvature[number])


@part
def prepare_rates(work, terms, step, number):
    """Factor B B^T at a stage of a step, unless the step has no mu (terms is None). False if it is singular."""
    if terms is None:
        return True
    return factor_rates(work.scene.links, terms.system, work.drives[step, number], stage(work, number).points[DZ])


@part
def refine(work, step, right, below, b_v, fields, multipliers):
    """Correct w = fields and the multipliers with the factors of the modes until their errors are small. Returns a status.

    Shapes as in `solve`. REFACTOR: the factors are too old.
    """
    which, stages, spent, u = work.which, work.r.shape[0], 0.0, pairs(work, work.q[step, work.r.shape[0] // 2])
    for iteration in range(MAX_CORRECTIONS):
        for column in which:
            set_residuals(work, right, below, column)
            work.unconstrained[column] = 0.0
        good = correct(work.scene, work.real, work.tied, u, work.r, work.rows, work.unconstrained, which)
        if not (good and correct(work.scene, work.pair, work.tied, u, work.r, work.rows, work.unconstrained, which)):
            return SINGULAR
        work.record.solves[0] += which.shape[0]
        spent += 0.5 * (1.0 + which.shape[0])  # each further column costs about half of the first
        if not add_corrections(work, fields, multipliers, which, iteration):
            return REFACTOR
        left = list_open_columns(work, which)
        # with one stage, M w of a column that has converged is not needed
        multiply(work, step, fields, multipliers, b_v, which, which if stages > 1 else work.left[:left], False)
        for e in range(left):
            which[e] = work.left[e]
        which = which[:left]
        if not left:
            count_work(work.record, spent)
            return DONE
    return REFACTOR


@part
def add_corrections(work, fields, multipliers, which, iteration):
    """Correct the columns in `which` and set work.small of each. False as soon as one of them will not converge with the factors."""
    for e in range(which.shape[0]):
        work.small[e], hopeless = add_correction(work, fields, multipliers, which[e], iteration)
        if hopeless and not work.small[e]:
            return False
    return True


@part
def list_open_columns(work, which):
    """Store the columns in `which` that have not converged at the beginning of work.left; return their number."""
    left = 0
    for e in range(which.shape[0]):
        if not work.small[e]:
            work.left[left] = which[e]
            left += 1
    return left


@part
def multiply(work, step, fields, multipliers, b_v, which, moving, anew):
    """Compute the products of w = fields and the multipliers at the stages in the columns of `which`, M w only in those of `moving`.

    anew: True if the bodies' rotations must be computed.
    """
    for i in range(work.r.shape[0]):
        x, u, v = stage(work, i), pairs(work, work.q[step, i]), pairs(work, work.v[step, i])
        products.body_products(work.scene, work.viscosity, u, v, (which, moving), fields[i], x.rotation if anew else x.rotation[:0], x)
        for column in which:
            products.point_products(work.scene.links, work.slopes[i], column, fields[i, column], multipliers[MU, i, column], x)
            for row in range(work.rows.shape[3]):
                work.rows[MU, i, column, row] = x.rows[column, row]
    for column in which:
        add_mu_terms(work, work.tied, multipliers, b_v, column)


@part
def add_mu_terms(work, terms, multipliers, b_v, column):
    """Add the terms of kappa and mu to the products of a column, and set B v* in work.rows, unless the step has no mu (terms is None)."""
    if terms is None:
        return
    links, stages, values, forces = work.scene.links, work.r.shape[0], terms.points[0], terms.points[1]
    for i in range(stages):
        slowing = stage(work, i).slowing[column]
        clear(forces)
        joints.add_rows(links, work.slopes[i], multipliers[KAPPA, i, column], forces)
        joints.spread(links, forces, slowing)
        for a in range(slowing.shape[0]):
            for e in range(2):
                terms.v[i, a, e] = slowing[a, e] + (b_v[column, a, e] if i == stages - 1 else 0.0)
    for i in range(stages):
        for j in range(stages):
            add(work.to_v[i, j], stage(work, j).heavy[column], terms.v[i])
        joints.point_values(links, terms.v[i], values)
        products.pull_back(links.coupling, terms.curvature[i], values, forces)
        for k in range(work.rows.shape[3]):
            work.rows[KAPPA, i, column, k] = joints.along(links, work.slopes[i], k, values)
        joints.add_rows(links, terms.rates[i], multipliers[KAPPA, i, column], forces)
        joints.spread(links, forces, stage(work, i).stiff[column])


@fast
def add(factor, values, out):
    """out += factor values, both (nodes, 2)."""
    for a in range(values.shape[0]):
        for e in range(2):
            out[a, e] += factor * values[a, e]


@fast
def set_residuals(work, right, below, column):
    """work.r = minus the residuals of a column, rotated to the middle stage; work.rows = residuals of the rows."""
    stages = work.r.shape[0]
    for i in range(stages):
        stiff, own, r = stage(work, i).stiff[column], stage(work, i).heavy[column], work.r[i, column]
        for a in range(r.shape[0]):
            for e in range(2):
                r[a, e] = right[i, column, a, e] - stiff[a, e] - work.to_a[i, i] * own[a, e]
        for j in range(stages):
            if j != i:
                add(-work.to_a[i, j], stage(work, j).heavy[column], r)
            add(-work.to_v[i, j], stage(work, j).slowing[column], r)
        for e in range(below.shape[2]):
            work.rows[MU, i, column, e] -= below[i, column, e]
        if stages > 1:
            scene_functions.turn_to(stage(work, i).rotation, stage(work, stages // 2).rotation, work.turn[i], r)


@part
def add_correction(work, fields, multipliers, column, iteration):
    """Add the corrections of the modes to w = fields and the multipliers of a column. Returns (small, hopeless) of `convergence`.

    dw = that of the real mode + 2 Re of that of the pair.
    """
    if work.r.shape[0] > 1:
        work.dw[:, column] = 0.0
    work.change[:, :, column] = 0.0
    add_change(work.real, 1.0, work.dw, work.change, column)
    add_change(work.pair, 2.0, work.dw, work.change, column)
    work.largest[column] = max(work.largest[column], work.unconstrained[column])
    moved, size = add_to_w(work, fields, column)
    mu_moved = mu_size = 0.0
    for f in range(multipliers.shape[0]):
        for i in range(multipliers.shape[1]):
            for e in range(multipliers.shape[3]):
                multipliers[f, i, column, e] += work.change[f, i, column, e]
                if f == MU:
                    mu_moved += abs(work.change[f, i, column, e])
                    mu_size += abs(multipliers[f, i, column, e])
    return convergence(work.record, column, iteration, moved, size, mu_moved, mu_size, work.enough, work.largest[column])


@fast
def add_to_w(work, fields, column):
    """fields w += dw in a column, rotated back. Returns the sums of |dw| and |w|, since squares may underflow."""
    moved = size = 0.0
    for i in range(fields.shape[0]):
        dw, own = work.dw[i, column], fields[i, column]
        if fields.shape[0] > 1:
            scene_functions.turn_back(work.turn[i], dw)
        for a in range(own.shape[0]):
            for e in range(2):
                own[a, e] += dw[a, e]
                moved += abs(dw[a, e])
                size += abs(own[a, e])
    return moved, size


class SceneAdjoint(AdjointTable):
    """The table of a compiled scene.

    to_v, to_a (s, s): of steps with h = 1 (see `scale`). modes: (row, column) of each mode. factor: function (t, q, v, a, lam, h) at the middle
    stage -> [Factor of each mode]. enough: accepted error of w over |w|. counts: Counts to be increased. tied: True if the steps have mu.
    columns: number of right-hand sides.
    """

    def __init__(self, model, to_v, to_a, modes, factor, enough, counts, tied=False, columns=1):
        """Allocate the workspace for s stages and all columns."""
        self.model, self.counts = model, counts
        self.modes = modes
        self.factor = factor
        self.tied = tied
        self.columns = columns
        self.of_h = (np.array(to_v, float), np.array(to_a, float))  # to_v and to_a at h = 1
        self.factor_cache = FactorCache()  # {step h: (modes, {number of a table: its FactorRecord})}
        self.functions = np.zeros(ENTRIES, np.int64)
        s, nodes, kinds, entries = len(to_v), (model.n_nodes, 2), 1 + tied, len(model.arrays.links.row_columns)
        self.helpers = Helpers(threads()) if s == 1 and model.n >= forward.SHARED and threads() > 1 else None
        self.products = np.zeros((3, s, columns, *nodes))
        scratches = [scratch(model, tied, self.products[:, i]) for i in range(s)]
        self.w: dict[str, Any] = {
            "scene": arrays_of(model),
            "viscosity": viscosity_of(model),
            "laws": model.laws,
            "enough": enough,
            **dict(zip(("first", "second", "third"), scratches + scratches[-1:] * 2)),
            "slopes": np.zeros((s, entries)),
            "turn": np.zeros((s, *nodes)),
            "r": np.zeros((s, columns, *nodes)),
            "dw": np.zeros((s, columns, *nodes)),
            "rows": np.zeros((kinds, s, columns, model.m)),
            "change": np.zeros((kinds, s, columns, model.m)),
            "which": np.zeros(columns, np.int64),
            "small": np.zeros(columns, bool),
            "left": np.zeros(columns, np.int64),
            "unconstrained": np.zeros(columns),
            "largest": np.zeros(columns),
        }
        self.mu_terms = {}
        if tied:
            self.mu_terms = {
                "curvature": np.zeros((s, len(model.arrays.links.coupling.columns), 2, 2)),
                "rates": np.zeros((s, entries)),
                "v": np.zeros((s, *nodes)),
                "points": np.zeros((2, model.n_points, 2)),
                "system": rate_multipliers(model),
            }
        self.scale(1.0)

    def beside(self):
        """A copy for the sweep of another objective: the factors are shared, the error measures of the columns are its own."""
        other = copy(self)
        other.w = self.w | {name: np.zeros(self.columns) for name in ("unconstrained", "largest")}
        return other

    def scale(self, h):
        """Set the step h; to_v and to_a were given for h = 1."""
        to_v, to_a = self.of_h
        self.h = h
        self.w |= {"to_v": to_v / h, "to_a": to_a / h**2}

    def set_states(self, t, q, v, a, lam, mu=None):
        """Set the states of the stages of some steps, (count, s, .) each, or (count, .) for one stage."""
        *self.states, mu = by_stages(len(self.w["r"]), t, q, v, a, lam, mu)
        t, q, v, _, lam = self.states
        drives = drive_table(self.model, t.ravel(), (t[0, 0], t[-1, -1])).reshape(*t.shape, -1, 3)
        self.w |= {"q": q, "v": v, "lam": lam, "drives": drives, "tied": MuTerms(mu, **self.mu_terms) if self.tied else None}

    def refresh(self, k):
        """Use the factors of steps of h, made in the middle stage of step k if there are none: True in that case. Raises SingularSystem."""
        key = f"{self.h:.9e}"
        if known := self.factor_cache.get(key):
            self._use(*known, OLD)
            return False
        middle = len(self.w["r"]) // 2
        factors = self.factor(*(x[k, middle].copy() for x in self.states), self.h)
        self.counts.factorizations += len(factors)
        modes = {"real": None, "pair": None}
        for (row, column), factor in zip(self.modes, factors):
            modes["pair" if np.iscomplexobj(row) else "real"] = self._mode(row, column, factor)
        self.factor_cache.keep(key, known := (modes, {}))
        self._use(*known, FRESH)
        return True

    def _use(self, modes, known, slowest):
        """Use the modes of a factor. known: {number of a table: its FactorRecord}; slowest: of a new one."""
        if id(self) not in known:
            known[id(self)] = new_record(slowest, self.columns)
        self.w |= modes | {"record": known[id(self)]}

    def _mode(self, row, column, factor):
        """The Mode of a factor with new scratch; with one stage it works on the arrays of the step."""
        kind, columns = np.asarray(row).dtype, self.columns
        r, dw = (self.w[name][0] if len(self.w[name]) == 1 else np.zeros(self.w[name].shape[1:], kind) for name in ("r", "dw"))
        rows, multipliers = np.zeros((2, columns, 1 + self.tied, self.model.m), kind)
        lanes = None if np.issubdtype(kind, complex) else np.zeros((2 * self.model.n_factored, COLUMNS), np.float32)
        return Mode(factor, np.array(row), np.array(column), r, dw, rows, multipliers, np.zeros(columns), lanes)

    def raise_error(self):
        """Raise the stored exception of a Python function."""
        self.model.raise_error()

    def drop(self):
        """Delete the factors of steps of h."""
        self.factor_cache.factors.pop(f"{self.h:.9e}", None)

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        record, real = self.w["record"], self.w["real"]
        record.solves[0] = 0.0
        own = real and real.factor.workspace
        with self.helpers.at_work(real.factor.factored, own) if real and self.helpers else nullcontext(own) as workspace:
            modes = {"real": real._replace(factor=real.factor._replace(workspace=workspace))} if real else {}
            work = SceneAdjointWork(**self.w | modes)
            self.functions[ADJOINT] = forward.entry_address(solve, typeof(work))
            yield self.functions, work.address
        self.counts.solves += int(record.solves[0]) * len(self.modes)
