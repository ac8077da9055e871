"""The adjoint of a step of a scene: one stale co-rotated factor, refined with the exact products (products.py)."""

from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.adjoint import products
from polyida.adjoint.products import DZ, Scratch, arrays_of, scratch
from polyida.adjoint.tables import AdjointTable
from polyida.assembly import corotated, joints
from polyida.assembly.increments import drive_table
from polyida.assembly.own_laws import Laws
from polyida.environment import threads
from polyida.errors import DONE, REFACTOR, SINGULAR
from polyida.integrate.alpha.step import SLOW
from polyida.jit import entry, fast, pack, part
from polyida.jit.intrinsics import pointer
from polyida.linear.team import Helpers
from polyida.system import ADJOINT, ENTRIES, c_address
from polyida.system import scene as forward

# constants of compiled code
CONTRACTION, AGE, SOLVES, LARGEST = range(4)  # of SceneAdjointWork.marks
R, DW = range(2)  # of SceneAdjointWork.now
DMU, PHI = range(2)  # of SceneAdjointWork.rows
FRESHEN = 30  # steps after which the contraction is measured again
ROUND_OFF = 1e-9  # of |w|: below it a correction need not fall any more
NOTHING = 1e-14  # of what w would be without constraints: below it corrections of a w that these hold to zero are nothing
LEAST = 1e-280  # a residual below that is taken as that large: single precision, in which the factor solves, ends at 1e-38
SHARE = 1e-2  # of Newton's tolerance that refinement leaves of w
EXACT = 1e-11  # of |w|: it leaves no less
MOST = 12  # corrections of a step with one factor


@pack
class SceneAdjointWork(NamedTuple):
    """The workspace of a scene.

    viscosity, laws: None where there is nothing of the kind, which is not compiled then. drives (count, profiles, 3), q, v, lam: of the
    states. enough: the error of w, over |w|, that is left. products: of the state and w. now (2, nodes, 2), rows (2, m): scratch. marks:
    CONTRACTION, and AGE in steps since it was measured; SOLVES; LARGEST, the largest |w| so far that no constraint held.
    """

    scene: tuple
    viscosity: np.ndarray | None
    laws: Laws | None
    factored: corotated.Corotated
    room: corotated.Room
    drives: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    to_a: float
    to_v: float
    enough: float
    products: Scratch
    now: np.ndarray
    rows: np.ndarray
    marks: np.ndarray


@part
def pairs(w, x):
    """A vector (n,) as (nodes, 2)."""
    return x.reshape(w.now.shape[1:])


@part
def pairs_at(w, at):
    """The coordinates at an address as (nodes, 2)."""
    return carray(pointer(at), w.now.shape[1:])


@part
def hold(w, k, x):
    """The factor's frames, the border's rows and their curvature, `S^T` on the points included. The rotations must be there."""
    s, c, room = w.scene.links, w.factored, w.room
    corotated.turn_frames(s, c, room, x.rotation)
    corotated.hold_border(s, c, room, w.drives[k], x.points[DZ])
    curvature, mirror = room.border.curvature, s.coupling.mirror
    for e in range(mirror.shape[0]):
        for i in range(2):
            for j in range(2):
                curvature[e, i, j] = x.curvature[mirror[e], j, i]
                if x.slack.shape[0]:
                    curvature[e, i, j] += w.to_v * x.slack[mirror[e], j, i]
    corotated.add_masses(s, w.to_a, curvature)


@part
def correct(s, c, room, r, phi, dw, dmu):
    """Fill dw (nodes, 2) and dmu of `S dw + B^T dmu = -r`, `B dw = -phi`: the sum of |S^-1 r|, below zero if it is singular. r is lost."""
    size, free = LEAST, 0.0
    for i in range(r.shape[0]):
        size = max(size, abs(r[i, 0]), abs(r[i, 1]))
    for i in range(r.shape[0]):
        r[i, 0], r[i, 1] = r[i, 0] / size, r[i, 1] / size
    corotated.solve_turned(c, room, r, dw)
    for i in range(r.shape[0]):
        dw[i, 0], dw[i, 1] = -size * dw[i, 0], -size * dw[i, 1]
        free += abs(dw[i, 0]) + abs(dw[i, 1])
    if room.border.x.shape[0]:
        joints.point_values(s, dw, room.moved)
        if not corotated.close(s, c, room, phi, dmu):
            return -1.0
        corotated.pull_points(s, c, room, dw)
    return free


@fast
def residual(w, right, below, x):
    """r = S^T w + B^T mu - right and phi = B w - below."""
    r = w.now[R]
    for i in range(r.shape[0]):
        for e in range(2):
            r[i, e] = x.stiff[i, e] + w.to_a * x.heavy[i, e] - right[i, e]
    if x.slowing.shape[0]:
        for i in range(r.shape[0]):
            for e in range(2):
                r[i, e] += w.to_v * x.slowing[i, e]
    for i in range(x.rows.shape[0]):
        w.rows[PHI, i] = x.rows[i] - below[i]


@fast
def add_correction(now, multipliers, dw, dmu):
    """w += dw, mu += dmu; the sums of |dw| and |w|, whose squares may be too small for a number."""
    moved = size = 0.0
    for i in range(now.shape[0]):
        for e in range(2):
            now[i, e] += dw[i, e]
            moved += abs(dw[i, e])
            size += abs(now[i, e])
    for i in range(multipliers.shape[0]):
        multipliers[i] += dmu[i]
    return moved, size


@part
def judge(w, moved, size, last, iteration):
    """Whether the error behind a correction by `moved` after one by `last` is small enough, or round-off, and whether it will never be."""
    marks, measured = w.marks, last > 0.0
    rate = marks[CONTRACTION]
    if measured:
        rate = moved / last
        marks[CONTRACTION], marks[AGE] = max(rate, (0.5 if iteration == 1 else 1.0) * marks[CONTRACTION]), 0.0
    slow = measured and not rate <= SLOW
    small = (measured or marks[AGE] < FRESHEN) and rate < 1.0 and moved * rate / (1.0 - rate) <= w.enough * size
    return small or (slow and moved <= ROUND_OFF * size) or moved <= NOTHING * marks[LARGEST], slow


@entry
def solve(w, k, right, below, bar, now, multipliers, found):
    """Solve step k by refinement. Returns how it ended."""
    m, x, last = (w.rows.shape[1],), w.products, 0.0
    right, below, now, multipliers = pairs_at(w, right), carray(pointer(below), m), pairs_at(w, now), carray(pointer(multipliers), m)
    u, v, plates, links = pairs(w, w.q[k]), pairs(w, w.v[k]), w.scene, w.scene.links
    products.hold_state(plates, w.laws, w.drives[k], u, v, w.lam[k], x)
    products.body_products(plates, w.viscosity, u, v, now, x.rotation, x)
    hold(w, k, x)
    for iteration in range(MOST):
        products.point_products(links, w.laws, w.room.border.slopes, now, multipliers, x)
        residual(w, right, below, x)
        free = correct(links, w.factored, w.room, w.now[R], w.rows[PHI], w.now[DW], w.rows[DMU])
        if free < 0.0:
            return SINGULAR
        w.marks[LARGEST] = max(w.marks[LARGEST], free)
        w.marks[SOLVES] += 1.0
        moved, size = add_correction(now, multipliers, w.now[DW], w.rows[DMU])
        products.body_products(plates, w.viscosity, u, v, now, x.rotation[:0], x)
        small, hopeless = judge(w, moved, size, last, iteration)
        if small:
            products.point_products(links, w.laws, w.room.border.slopes, now, multipliers, x)
            n = x.stiff.shape[0]
            lost = carray(pointer(found), (2 * n, 2))
            for i in range(n):
                for e in range(2):
                    lost[i, e] = x.stiff[i, e]
                    lost[n + i, e] = x.slowing[i, e] if x.slowing.shape[0] else 0.0
            w.marks[AGE] += 1.0
            return DONE
        if hopeless:
            return REFACTOR
        last = moved
    return REFACTOR


class SceneAdjoint(AdjointTable):
    """The table of a compiled scene for steps of h, its solves by several threads where the run's are. counts: what counts its work."""

    def __init__(self, model, settings, h, counts):
        (to_a, to_v), (_, most, _) = settings.coefficients.rates(h), settings.newton_tolerance(0.0)
        self.model, self.settings, self.counts, self.system = model, settings, counts, None
        self.functions, self.helpers = np.zeros(ENTRIES, np.int64), Helpers(threads() if model.n >= forward.SHARED else 1)
        self.w = {
            "scene": arrays_of(model),
            "viscosity": model.arrays.plates.body_viscosity if model.damped else None,
            "laws": model.laws,
            "to_a": to_a,
            "to_v": to_v,
            "enough": max(EXACT, SHARE * most),
            "products": scratch(model),
            "now": np.zeros((2, model.n_nodes, 2)),
            "rows": np.zeros((2, model.m)),
            "marks": np.zeros(4),
        }

    def take(self, t, q, v, a, lam, slips=None):
        """Take the states at the ends of some steps."""
        self.states = t, *(np.ascontiguousarray(x, float) for x in (q, v, a, lam))
        self.w |= dict(zip(("q", "v", "lam"), (self.states[1], self.states[2], self.states[4])))
        self.w["drives"] = drive_table(self.model, t, (t[0], t[-1]))

    def refresh(self, k):
        if self.system is not None:
            return False
        self.system = self.settings.step_matrix(self.model)
        self.system.factor(*(x[k].copy() for x in self.states), self.w["to_a"], self.w["to_v"])
        self.counts.factorizations += 1
        self.counts.solves += self.system.solves
        self.counts.backend = self.system.backend
        self.w["marks"][[CONTRACTION, AGE]] = 1.0, FRESHEN
        return True

    def drop(self):
        self.system = None

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        marks = self.w["marks"]
        marks[SOLVES] = 0.0
        with self.helpers.at_work(self.system.corotated, self.system.room) as room:
            work = SceneAdjointWork(factored=self.system.corotated, room=room, **self.w)
            self.functions[ADJOINT] = c_address(solve, typeof(work))
            yield self.functions, work.address
        self.counts.solves += int(marks[SOLVES])
