"""How much a structure gives way to its loads."""

from dataclasses import dataclass

import numpy as np

from polyida.integrate.kinks import inner_side
from polyida.keywords import named_keywords
from polyida.objective.means.time_mean import TimeMean, rates
from polyida.objective.slopes import Slopes


@named_keywords
@dataclass(frozen=True, eq=False)
class Compliance(TimeMean):
    """Time mean of `f . q`, J, the work of the loads on the displacements; f = -g(t, 0, 0): gravity, loads, and all other forces at q = 0.

    Of an equilibrium for small displacements, `pi.static(model, linear=True)`, it is twice the strain energy, unless constraints move or
    springs are strained at q = 0: what topology optimisation calls compliance. Of a load that jumps in a frame its value before the jump
    counts.
    """

    def _seen(self, model, span):
        """f . q."""
        still = np.zeros(model.n)

        def load(t):
            return -model.force(t, still, still)

        def look(frames):
            at = _sides(model, frames)
            f = np.array([load(t) for t in at.tolist()])

            def back(factor):
                by_time = lambda: factor * np.sum(rates(model, load, at, span) * frames.q, axis=1)  # noqa: E731
                rest, none = np.zeros_like(frames.q), np.zeros_like(frames.lam)
                work = at, rest, rest, rest, none, -factor[:, None] * frames.q, none
                return Slopes(q=factor[:, None] * f, t=by_time, work=work)

            return lambda: np.sum(f * frames.q, axis=1), back

        return look


def _sides(model, frames):
    """Times of the frames; of one at a kink the side where the steps of the run are: before it, behind it in the first frame."""
    begin = frames.run.t[0]
    if len(frames.run.t) == 1:
        return frames.t
    return np.array([inner_side(model, t, 1.0 if t > begin else -1.0) for t in frames.t.tolist()])
