"""The stages of one step by simplified Newton iteration on the collocation equations.

With `q_i = q_0 + c_i h v_0 + e_i` the unknowns are e, lam and mu; v and v' follow from them,

    v_i = q_i' + D^-1 B^T mu_i,   q_i' = v_0 + sum_j W_ij e_j / h,   v_i' = sum_j W_ij (v_j - v_0) / h

and at each node `r(t, q, v, v', lam) = 0`, phi = 0 and, in the form "ggl", `B v + phi_t = 0`; "index3" has neither that nor mu.
D, the diagonal of M over its mean, makes it the same in all units. Where phi is linear in q and not driven, mu is zero and the two
forms are one: v = q' is on its constraint with q.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from polyida.integrate.radau.tableau import radau, through, through_zero
from polyida.jit import pack

SLOW = 0.9  # contraction beyond which a correction of ROUND of the size is round-off: one that still shrinks is none
ROUND = 1e-11
CARRIED = 10  # steps in which the contraction of an earlier one is taken for that of the first iteration
UNKNOWN = np.array([1.0, CARRIED])  # the marks of a Newton that has none
FAR = 4.0  # steps longer than the last by more begin from q_0 + c h v_0: its polynomial leads nowhere there


@pack
class Trial(NamedTuple):
    """What Newton works on: e, v - v_0 and v' of the stages (s, n), their multipliers lam (s, m) and mu (s, m), or (s, 0) without."""

    e: np.ndarray
    dv: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    mu: np.ndarray


def trial(stages, n, m, tied):
    """Of s stages, zero."""
    return Trial(*np.zeros((3, stages, n)), np.zeros((stages, m)), np.zeros((stages, m if tied else 0)))


class Failed(Exception):
    """Newton does not come to an end: status and reason, as a StepFailure has them, and what it last saw."""

    def __init__(self, status, reason, **seen):
        self.status, self.reason, self.seen = status, reason, seen
        super().__init__(reason)


class Newton:
    """Solves the stages of a model's `system`; `marks` are the contraction of an earlier step and its age in steps, so that a step
    may end after one iteration.
    """

    def __init__(self, system, tableau, max_iterations):
        self.system, self.tableau, self.max_iterations = system, tableau, max_iterations
        self.marks = UNKNOWN.copy()

    def solve(self, matrices, state, h, allowed, shares, least=0.0):
        """Iterations until they leave `allowed` of q; the stages are in the system's trial.

        shares (n,): the weights of the norm. least: round-off of q = 0. Raises Failed.
        """
        self._guess(state, h)
        size = np.sqrt(shares @ state.q**2) + h * np.sqrt(shares @ state.v**2)
        contraction, last, worst, round_off = self._first(), np.inf, 0.0, max(ROUND * size, least)
        self.system.take(matrices)
        for iteration in range(1, self.max_iterations + 1):
            moved = self.system.iterate(matrices)
            if not np.isfinite(moved):
                raise Failed("not finite", "the motion is not finite")
            if iteration > 1:
                contraction = moved / last
                worst = max(worst, contraction)
            left = contraction / (1.0 - contraction) * moved if contraction < 1.0 else np.inf
            spent, stalled = iteration == self.max_iterations, iteration > 1 and contraction > SLOW
            if left <= allowed or moved == 0.0 or (moved <= round_off and (stalled or spent)):
                self.marks = np.array([worst, 0.0]) if iteration > 1 else self.marks + (0.0, 1.0)
                return iteration
            if iteration > 1 and contraction ** (self.max_iterations - iteration) * left > max(allowed, round_off):
                break
            last = moved
        raise Failed("newton", "Newton does not converge with fresh matrices", **{"last |dq|": moved, "contraction": contraction})

    def _guess(self, state, h):
        """Stages to begin with: on the last step's polynomial, shifted through the state; at a run's start along v."""
        x, memory = self.system.trial, state.memory
        x.mu[:] = 0.0
        if "stages_e" not in memory or h > FAR * memory["step"]:
            x.e[:], x.lam[:] = 0.0, memory["stages_lam"][-1] if "stages_lam" in memory else state.lam
            return
        to_e, to_lam = _ahead(self.tableau.stages, h / float(memory["step"]))
        np.matmul(h * to_e, memory["stages_v"], out=x.e)
        np.matmul(to_lam, memory["stages_lam"], out=x.lam)

    def _first(self):
        contraction, age = self.marks
        return min(2.0 * contraction, 1.0) if age < CARRIED else 1.0


@lru_cache(maxsize=64)
def _ahead(stages, longer):
    """Weights (s, s) of the last step's v - v_0 in the next e over h, and of its lam in the next: its polynomials, a step `longer` on.

    That of v, integrated, is nearer than that of q.
    """
    tableau = radau(stages)
    at = 1.0 + tableau.c * longer
    ahead = through_zero(tableau.c, at)
    ahead[:, -1] -= 1.0
    return tableau.A @ ahead, through(tableau.c, at)
