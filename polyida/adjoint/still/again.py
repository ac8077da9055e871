"""An equilibrium or modes found again, of a model with a parameter changed."""

import numpy as np

from polyida.integrate.start import VIOLATION
from polyida.integrate.statics.loading import Equilibrium
from polyida.integrate.statics.static import static
from polyida.modal.modes import Modes, modes
from polyida.model.guarded import guard

TOLERANCE = 1e-13  # of Newton's method, in what differences are made of


class StillAgain:
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
