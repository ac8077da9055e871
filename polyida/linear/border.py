"""A few rows and columns around a factored matrix: constraints and their multipliers beside a step matrix.

```
[ S   C ] [ x ]   [ b     ]       X = S^-1 C,  y = S^-1 b
[ R   D ] [ w ] = [ below ]       (R X - D) w = R y - below,  x = y - X w
```
C and S may be as old as S's factor; R and D are those of each solve, so that its last rows hold to round-off however old S is.
"""

import numpy as np

from polyida.linear.lu import SingularSystem


class Border:
    """Columns C (n, k) on a factored S, as `X = S^-1 C`."""

    def __init__(self, X):
        self.X = X

    def solve(self, y, rows, below, corner=0.0):
        """(x, w) from `y = S^-1 b`, rows R (k, n), below (k,) and corner D, (k, k) or 0. Raises SingularSystem."""
        if not self.X.shape[1]:
            return y, np.zeros(0)
        try:
            w = np.linalg.solve(rows @ self.X - corner, rows @ y - below)
        except np.linalg.LinAlgError:
            raise SingularSystem("the constraints' system is singular") from None
        return y - self.X @ w, w
