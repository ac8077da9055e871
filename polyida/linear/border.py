"""A few rows and columns around a factored matrix: constraints and their multipliers beside a step matrix.

```
[ S   C ] [ x ]   [ b     ]       X = S^-1 C,  y = S^-1 b
[ R   D ] [ w ] = [ below ]       (R X - D) w = R y - below,  x = y - X w
```
C and S may be as old as S's factor; R and D are those of each solve, so that its last rows hold to round-off however old S is.
"""

import numpy as np

from polyida.linear.lu import LU, SingularSystem

MANY = 50  # constraints beyond which the border's columns are not made anew in every iteration


class Border:
    """Columns C (n, k) on a factored S, as `X = S^-1 C`."""

    def __init__(self, X):
        self.X, self.rows, self.lu = X, None, None

    def solve(self, y, rows, below, corner=0.0):
        """(x, w) from `y = S^-1 b`, rows R (k, n), below (k,) and corner D, (k, k) or 0. Raises SingularSystem.

        What the same rows, and their corner, need is made once.
        """
        if not self.X.shape[1]:
            return y, np.zeros(0)
        if rows is not self.rows:
            self._close(rows, corner)
        w = self.lu.solve(rows @ y - below)
        return y - self.X @ w, w

    def _close(self, rows, corner):
        self.rows = None
        try:
            self.lu = LU(rows @ self.X - corner)
        except SingularSystem:
            raise SingularSystem("the constraints' system is singular") from None
        self.rows = rows
