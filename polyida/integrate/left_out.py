"""Redundant rows that are left out must hold all the same: motors that agree at the start of a run may contradict each other later."""

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.row_sizes import row_sizes
from polyida.linear.lu import dense
from polyida.model.guarded import unguarded

OPEN = 1e-6  # of the model's size: a row that is left out and open by more contradicts the others
SPREAD = 100.0  # times what the other rows are open, relative to their sizes, that such a row may be open beyond
NAMED = 3  # constraints that a message names
SHARE = 1e-3  # of the largest one: weights in the dependence of a row on others that are named


class LeftOut:
    """The rows that a model leaves out as redundant, if it does."""

    def __init__(self, model):
        """Take the redundant rows of a model, if it leaves some out, and the independent ones without a law."""
        self.redundant, self.sizes = getattr(unguarded(model), "redundant", None), None
        if self.redundant is not None and not self.redundant.labels:
            self.redundant = None
        if self.redundant is not None:
            laws = [law.row for law in self.redundant.whole.row_laws]
            self.basis = np.setdiff1d(self.redundant.independent, laws)

    def contradiction(self, t, q):
        """Text that names the row which is open at a state, and the constraints that it contradicts; empty if there is none."""
        if self.redundant is None:
            return ""
        whole, left_out = self.redundant.whole, self.redundant.left_out
        if self.sizes is None:
            sizes = row_sizes(whole, q, whole.phi_q(t, q))
            self.sizes = np.where(sizes > 0, sizes, 1.0)
        phi = np.abs(whole.phi(t, q)) / self.sizes
        worst = int(np.argmax(phi[left_out]))
        if phi[left_out[worst]] <= OPEN + SPREAD * phi[self.basis].max(initial=0.0):
            return ""
        gap = phi[left_out[worst]] * self.sizes[left_out[worst]]
        others = self._others(t, q, left_out[worst])
        return f"{self.redundant.labels[worst]} contradicts {others}: it was left out as redundant, and is open by {gap:.3g}"

    def look(self, stretch):
        """Examine accepted states: (number of those that satisfy all rows, the StepFailure if the next one does not)."""
        if self.redundant is not None:
            for k in range(len(stretch)):
                if reason := self.contradiction(stretch.t[k], stretch.q[k]):
                    return k, StepFailure("contradiction", reason, float(stretch.t[k]))
        return len(stretch), None

    def _others(self, t, q, row):
        """Names of the constraints of joints on which a row depends, the heaviest first."""
        whole = self.redundant.whole
        B = dense(whole.phi_q(t, q))
        weights = np.abs(np.linalg.lstsq(B[self.basis].T, B[row], rcond=None)[0])
        weights[[whole.keeps_body(int(k)) for k in self.basis]] = 0.0
        heaviest = [k for k in np.argsort(-weights, kind="stable")[:NAMED] if weights[k] > SHARE * weights.max()]
        return ", ".join(whole.constraint_name(int(self.basis[k])) for k in heaviest)
