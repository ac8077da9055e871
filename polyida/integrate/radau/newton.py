"""The stages of one step by simplified Newton iteration on the collocation equations.

At each node, with `q' = sum_j W_ij (q_j - q_0)/h` and v' alike: `q' - v + D^-1 B^T mu = 0`, `r(t, q, v, v', lam) = 0`, phi = 0
and, in the form "ggl", `B v + phi_t = 0`; "index3" has neither that nor mu. D, the diagonal of M over its mean, makes it the
same in all units. Where phi is linear in q and not driven, mu is zero and the two are one: v = q' is on its constraint with q.
"""

from typing import NamedTuple

import numpy as np

from polyida.integrate.radau.matrices import Rows
from polyida.integrate.radau.tableau import from_zero
from polyida.linear.lu import SingularSystem

SLOW = 0.5  # contraction beyond which a correction of ROUND of the size is round-off
ROUND = 1e-11
CARRIED = 10  # steps in which the contraction of an earlier one is taken for that of the first iteration
NOTHING = 1e-12  # of the largest mass: none
FAR = 4.0  # steps longer than the last by more begin from q_0 + c h v_0: its polynomial leads nowhere there


class Stages(NamedTuple):
    """The stages of a step: differences q - q_0 and v - v_0 (s, n), v' (s, n), multipliers (s, m), and how Newton came to them."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    iterations: int
    contraction: float


class Failed(Exception):
    """Newton does not come to an end: status and reason, as a StepFailure has them, and what it last saw."""

    def __init__(self, status, reason, **seen):
        self.status, self.reason, self.seen = status, reason, seen
        super().__init__(reason)


class Newton:
    """Stages on one model; `marks` are the contraction of an earlier step and its age in steps, for a step to end after one iteration."""

    def __init__(self, model, tableau, tied, max_iterations, counts):
        self.model, self.tableau, self.max_iterations, self.counts = model, tableau, max_iterations, counts
        needs, self.marks = model.needs, np.array([1.0, CARRIED])
        self.lift, self.tied = None, tied and model.m > 0 and (needs.phi_q_varies or needs.driven)

    def weigh(self, shares):
        """Take the coordinates' shares in the mass, of which D is made; those without mass count as any."""
        heavy = shares > NOTHING * shares.max()
        self.lift = np.where(heavy, 1.0 / (len(shares) * np.where(heavy, shares, 1.0)), 1.0) if self.tied else None

    def solve(self, matrices, state, h, at, allowed, shares):
        """The Stages of a step of h from the state; `at`(t) is the time at which the model is asked, shares (n,) the norm's weights.

        Newton may leave `allowed` of q. Raises Failed.
        """
        times = [at(state.t + c * h) for c in self.tableau.c]
        q, v, lam = self._guess(state, h)
        mu = np.zeros_like(lam) if self.tied else np.zeros((len(q), 0))
        size = np.sqrt(shares @ state.q**2) + h * np.sqrt(shares @ state.v**2)
        self._surround(matrices, times, state, q, v)
        contraction, last, round_off = self._first(), np.inf, ROUND * size
        for iteration in range(1, self.max_iterations + 1):
            residuals = self._residuals(times, state, h, q, v, lam, mu)
            dq, dv, dlam, dmu = self._corrected(matrices, state.q + q, residuals)
            q, v, lam, mu = q + dq, v + dv, lam + dlam, mu + dmu
            moved = float(np.sqrt(np.mean(dq**2 @ shares) + h * h * np.mean(dv**2 @ shares)))
            if not np.isfinite(moved):
                raise Failed("not finite", "the motion is not finite")
            contraction = moved / last if iteration > 1 else contraction
            left = contraction / (1.0 - contraction) * moved if contraction < 1.0 else np.inf
            spent, stalled = iteration == self.max_iterations, iteration > 1 and contraction > SLOW
            if left <= allowed or moved == 0.0 or (moved <= round_off and (stalled or spent)):
                self._note(iteration, contraction)
                return Stages(q, v, self.tableau.W @ v / h, lam, iteration, contraction)
            if iteration > 1 and contraction ** (self.max_iterations - iteration) * left > max(allowed, round_off):
                break
            last = moved
        raise Failed("newton", "Newton does not converge with fresh matrices", **{"last |dq|": moved, "contraction": contraction})

    def _guess(self, state, h):
        """Stages to begin with: on the last step's polynomial, shifted through the state; at a run's start along v."""
        c, n, memory = self.tableau.c, self.model.n, state.memory
        lam = np.tile(memory.get("lam_end", state.lam), (len(c), 1))
        if "stages_q" not in memory or h > FAR * memory["step"]:
            return c[:, None] * (h * state.v), np.zeros((len(c), n)), lam
        ahead = np.array([from_zero(c, 1.0 + x * h / memory["step"]) for x in c])
        ahead[:, -1] -= 1.0
        return ahead @ memory["stages_q"], ahead @ memory["stages_v"], lam

    def _surround(self, matrices, times, state, q, v):
        """Give the matrices the constraints' rows of the middle stage; in a frame that stands those of a linear phi never change."""
        needs, k = self.model.needs, len(times) // 2
        if matrices.borders is None or needs.phi_q_varies or needs.driven or matrices.rotations is not None:
            at = state.q + q[k]
            p = matrices.turn(at[None])
            matrices.surround(Rows(self.model, times[k], at, state.v + v[k], self.lift, None if p is None else p[0]))
            self.counts.solves += len(matrices.modes) * len(matrices.rows.both)

    def _first(self):
        contraction, age = self.marks
        return min(2.0 * contraction, 1.0) if age < CARRIED else 1.0

    def _note(self, iteration, contraction):
        self.marks = np.array([contraction, 0.0]) if iteration > 1 else self.marks + (0.0, 1.0)

    def _residuals(self, times, state, h, q, v, lam, mu):
        """(r1, r2, r3, r4) of all stages, each (s, ...)."""
        model, a, r1 = self.model, self.tableau.W @ v / h, self.tableau.W @ q / h - (state.v + v)
        self.counts.residuals += len(times)
        self.counts.newton_iterations += 1
        r2, r3, r4 = [], [], []
        for i, t in enumerate(times):
            at_q, at_v = state.q + q[i], state.v + v[i]
            r2.append(model.residual(t, at_q, at_v, a[i], lam[i]))
            r3.append(model.phi(t, at_q) if model.m else lam[i])
            if self.tied:
                B = model.phi_q(t, at_q)
                r1[i] += self.lift * (B.T @ mu[i])
                r4.append(B @ at_v + model.phi_t(t, at_q))
        residuals = r1, np.array(r2), np.array(r3), np.array(r4) if self.tied else mu
        if not all(np.isfinite(r).all() for r in residuals):
            raise Failed("not finite", "the motion is not finite")
        return residuals

    def _corrected(self, matrices, q, residuals):
        self.counts.solves += len(matrices.modes)
        try:
            return matrices.stages(q, *residuals)
        except SingularSystem as error:
            raise Failed("singular", str(error)) from None
