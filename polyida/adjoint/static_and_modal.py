"""The gradients of an equilibrium, by one transposed solve, and of modes; both found again, of a model with a parameter changed.

    [[K^T, B^T], [B, 0]] (w, mu) = (-j_q, -j_lam),   dJ/dp = w . dr/dp + mu . dphi/dp + what J says of p itself

K, B, r and phi are those at the equilibrium; of one for small displacements those of what it solves, `r = g_0 + K_0 q + B_0^T lam`,
`phi = phi_0 + B_0 q`, all at q = 0. What J says of parameters by itself is the modes' at their state; where this is an equilibrium of
`pi.static`, which moves with parameters, its adjoint adds what J says of q and lam. Any other state is held as it is.
"""

import numpy as np

from polyida.adjoint.parameters.parameter import AdjointMultipliers
from polyida.adjoint.totals import Gradient, Totals
from polyida.errors import StepFailure
from polyida.integrate.start import VIOLATION
from polyida.integrate.state import Counts
from polyida.integrate.statics.static import FREE, Equilibrium, static
from polyida.linear.kkt import KKT, scaling_factors
from polyida.linear.lu import SingularSystem
from polyida.modal.modes import Modes, modes
from polyida.model.guarded import guard
from polyida.objective.slopes import along_way

TOLERANCE = 1e-13  # of Newton's method, in what differences are made of


def gradient_of_state(subject, objective, names=None):
    """The Gradient of an objective of an Equilibrium, or of Modes. Raises StepFailure where the structure can move freely."""
    totals, counts = Totals(subject.model, names), Counts()
    own = objective.slopes(subject)(slice(0, 1))
    totals.own(own)
    equilibrium = subject.state if isinstance(subject, Modes) else subject
    if isinstance(equilibrium, Equilibrium):
        for multipliers in adjoint_of_static(equilibrium, own, counts):
            totals.add(multipliers)
    return Gradient(objective(subject), totals.slopes(), counts, totals.left_out)


def adjoint_of_static(equilibrium, own, counts):
    """Yield the AdjointMultipliers of an equilibrium for an objective's own Slopes in it; none where these are zero."""
    model, t, lam = guard(equilibrium.model), equilibrium.t, equilibrium.lam
    j_q, j_lam = (np.zeros(x.shape) if slope is None else slope[0] for x, slope in ((equilibrium.q, own.q), (lam, own.lam)))
    if not (j_q.any() or j_lam.any()):
        return
    still, none = np.zeros(model.n), np.zeros(model.m)
    about = (still, none) if equilibrium.linear else (equilibrium.q, lam)
    K = model.tangent(t, about[0], still, still, about[1], 0.0, 0.0, 1.0)
    counts.tangents, counts.factorizations, counts.solves = 1, 1, 1
    try:
        w, mu = KKT(K, model.phi_q(t, about[0]), scaling_factors("physical", 1.0, K)).adjoint(j_q, j_lam)
    except SingularSystem:
        raise StepFailure("singular", FREE, t) from None
    entry = (t, about[0], still, still, lam, w, mu)
    yield AdjointMultipliers(*(np.asarray(x, float)[None] for x in entry))
    if equilibrium.linear:
        yield AdjointMultipliers(*along_way(model, t, still, none, equilibrium.q, w, mu))


class ReplayedState:
    """An Equilibrium, or Modes, to be found again; state: the equilibrium itself, or what the modes are about."""

    def __init__(self, subject):
        self.subject, self.state = subject, subject.state if isinstance(subject, Modes) else subject

    def frames(self, model):
        """What is found of another model: from the same state, or about the same where that is no equilibrium."""
        state = self.state
        if isinstance(state, Equilibrium):
            state = static(model, state.t, state.q, tolerance=TOLERANCE, linear=state.linear)
        return modes(model, state, count=len(self.subject.roots)) if isinstance(self.subject, Modes) else state

    def begins(self, model):
        """Whether a state that is held is one of another model too."""
        if isinstance(self.state, Equilibrium):
            return True
        phi = guard(model).phi(self.state.t, self.state.q)
        return bool(np.abs(phi).max(initial=0.0) <= VIOLATION * max(1.0, np.abs(self.state.q).max()))
