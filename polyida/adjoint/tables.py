"""What a backward sweep asks of the table of its steps, and the sweep over steps of which some need a factor of their own.

The table of a model solves the adjoint of one step after another (entry ADJOINT of polyida/system): `dense_steps.py` for small models,
`scene_table.py` for scenes, by refinement with an older factor, and `exact_steps.py` for any model, with a factor of each step.

The entry gets right (s, columns, n) and below (s, columns, m), the right sides of the equations of w and of the rows, and the adjoint of v
at the end of the step, b_v (columns, n), of generalized-alpha that of q. It fills w (s, columns, n), the multipliers (1 or 2, s, columns,
m), mu* and, where the steps have mu, kappa, and the products (3, s, columns, n) with the transposed matrices, their parts of q*, v* and a*.
"""

from contextlib import suppress

import numpy as np

from polyida.errors import DONE, SINGULAR
from polyida.linear.lu import SingularSystem


class AdjointTable:
    """Interface of the tables, with defaults for one that stores no factor. Each also has `set_states` and `at_work`.

    kappa, slips: results for velocity rows and the stabilised form (exact_steps.py), else None. products: the array that the entry ADJOINT
    fills with its products, None if it takes any.
    """

    kappa = slips = products = None

    def beside(self):
        """The table for the sweep of another objective over the same steps, with the same factors."""
        return self

    def scale(self, h):
        """Take the step h, s, for all solves that follow; the method's matrices were given for h = 1. This one does nothing."""

    def refresh(self, k):
        """Make sure that there is a factor; True if it was made for state k. Raises SingularSystem."""
        return True

    def drop(self):
        """Delete the factor: it is too old."""

    def raise_error(self):
        """Do nothing here; a table that calls Python functions raises the exception that one of them raised and that it stored."""


def by_stages(stages, t, *states):
    """The states of some steps as arrays (count, s, .), from these or, with one stage, from (count, .); None becomes (count, s, 0)."""
    states = (np.zeros((*np.shape(t), 0)) if x is None else x for x in states)
    return [np.ascontiguousarray(x, float).reshape(len(t), stages, *np.shape(x)[np.ndim(t) :]) for x in (t, *states)]


def sweep_with_fallback(table, exact, count, steps):
    """Sweep backward over `count` steps with a table; a step that does not converge is solved by the table of `exact()`.

    steps: function (functions, workspace, first, last) -> (the first step that is done, status of the one before).
    """
    done = count
    while done:
        last, status, fresh = done, SINGULAR, True
        with suppress(SingularSystem):
            fresh = table.refresh(done - 1)
            with table.at_work() as at:
                done, status = steps(*at, 0, done)
            table.raise_error()
        if status != DONE:
            if fresh and done == last:
                other = exact()
                with other.at_work() as at:
                    done, _ = steps(*at, done - 1, done)
                other.raise_error()
            table.drop()
