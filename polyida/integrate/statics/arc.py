"""A step along a path of equilibria by its length: the load factor is one more multiplier, the length one more constraint.

```
[ K     B^T   -slope ] [ dq      ]     [ r                      ]
[ B     0      0     ] [ dlam    ] = - [ phi                    ]      |x|^2 = sum w_i x_i^2, sum w_i = 1
[ w Dq  0      0     ] [ dfactor ]     [ (|Dq|^2 - length^2) / 2 ]
```
Dq = q - q0 is the way since the last point (Crisfield 1981, the cylindrical form; linearised in every iteration as Ramm 1981 and Schweizerhof
and Wriggers 1986 do). The matrix is regular at turning points of the factor, where K alone is not.
"""

from dataclasses import dataclass

import numpy as np

from polyida.integrate.state import StepFailure
from polyida.integrate.statics.loading import FREE, Equilibrium, Loading
from polyida.linear.independence import coordinate_sizes
from polyida.linear.kkt import KKT, scaling_factors
from polyida.linear.lu import SingularSystem

LOST = "the path of equilibria is lost"
STRAIGHT = 0.9  # cosine of the angle, at most, between a step and the path at its two ends


@dataclass(frozen=True, eq=False)
class Point:
    """An equilibrium on the path and the way on from it, of length one: `q' = dq/ds`, `lam'`, and `rate = dfactor/ds`."""

    factor: float
    state: Equilibrium
    q_s: np.ndarray
    lam_s: np.ndarray
    rate: float


class Path:
    """Points of a Loading's equilibria."""

    def __init__(self, loading: Loading):
        self.loading = loading
        sizes = coordinate_sizes(loading.model, np.zeros(loading.model.n))
        self.weights = sizes**-2 / np.sum(sizes**-2)

    def length(self, x):
        """|x|, m: the root mean square, by mass, of displacements."""
        return float(np.sqrt(self.weights @ x**2))

    def begin(self, q, factor):
        """The Point at a factor, by Newton's method from q; it goes on to where the factor grows."""
        loading = self.loading
        q, lam, system = loading.solve(q, loading.multipliers(q, factor), factor)
        if system.lu.doubtful():
            raise StepFailure("singular", FREE, loading.t)
        loading.require_accepted(q)
        q_s, lam_s = system.solve(-loading.slope, np.zeros(loading.model.m))
        size = self.length(q_s)
        if not size > 0:
            raise StepFailure("singular", "the load moves nothing", loading.t)
        return Point(factor, loading.found(q, lam, system.solve), q_s / size, lam_s / size, 1.0 / size)

    def onward(self, point, length):
        """(the next Point, iterations) at a distance `length` from one, to either side. Raises StepFailure."""
        loading, start = self.loading, point.state
        q, lam, factor = start.q + length * point.q_s, start.lam + length * point.lam_s, point.factor + length * point.rate
        for iteration in range(1, loading.max_iterations + 1):
            r, phi = loading.residuals(q, lam, factor)
            way = q - start.q
            system = self._system(q, lam, way)
            dq, dlam = system.solve(r, np.append(phi, (self.weights @ way**2 - length**2) / 2))
            loading.require_near(q, dq, iteration)
            q, lam, factor = q + dq, lam + dlam[:-1], factor + float(dlam[-1])
            if loading.converged(q, dq):
                return self._reached(point, q, lam, factor, (q - start.q) / length), iteration
        raise StepFailure("newton", LOST, loading.t, iterations=loading.max_iterations)

    def _reached(self, last, q, lam, factor, chord):
        """The Point at (q, lam, factor). Raises StepFailure where the path bends too far on the way there: it may be another's point."""
        self.loading.require_accepted(q)
        system = self._system(q, lam, chord)
        q_s, lam_s = system.solve(np.zeros(len(q)), np.append(np.zeros(len(lam)), -1.0))
        size = self.length(q_s)
        if min(self.weights @ (chord * last.q_s), 1.0 / size) < STRAIGHT:
            raise StepFailure("bent", LOST, self.loading.t)
        solve = lambda r, phi: system.solve(r, np.append(phi, 0.0))  # noqa: E731
        return Point(factor, self.loading.found(q, lam, solve), q_s / size, lam_s[:-1] / size, float(lam_s[-1]) / size)

    def _system(self, q, lam, along):
        """The factored system; along: the way whose length is held."""
        K, B = self.loading.stiffness(q, lam), self.loading.model.phi_q(self.loading.t, q)
        try:
            return KKT(K, _under(B, self.weights * along), scaling_factors("physical", 1.0, K), _under(B, -self.loading.slope))
        except SingularSystem:
            raise StepFailure("singular", LOST, self.loading.t) from None


def _under(B, row):
    """B (m, n), dense or sparse, with one row more."""
    if not hasattr(B, "tocsc"):
        return np.vstack([B, row])
    from scipy.sparse import csr_array, vstack

    return vstack([csr_array(B), csr_array(row[None])], format="csr")
