"""The gradient of modes about a state.

What J says of parameters by itself is the modes' at that state; where this is an equilibrium of `pi.static`, which moves with parameters,
the adjoint of that adds what J says of q and lam. Any other state is held as it is.
"""

from polyida.adjoint.result import Gradient
from polyida.adjoint.still.static import adjoint_of_static
from polyida.adjoint.totals import Totals
from polyida.integrate.state import Counts
from polyida.integrate.statics.loading import Equilibrium


def gradient_of_modes(modes, objective, names=None):
    """The Gradient of an objective of Modes."""
    totals, counts = Totals(modes.model, names), Counts()
    own = objective.slopes(modes)(slice(0, 1))
    totals.own(own)
    if isinstance(modes.state, Equilibrium):
        for work in adjoint_of_static(modes.state, own, counts):
            totals.work(work)
    return Gradient(objective(modes), totals.slopes(), counts, totals.left_out)
