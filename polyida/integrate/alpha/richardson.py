"""Richardson extrapolation: `x = (4 x(h/2) - x(h)) / 3` at the ends of steps of h, of order 3 to 4.

Two runs side by side, with h and h/2, none of which sees the other; phi = 0 and energy hold to the order of the result
only. A kink that is hit exactly does no harm; ringing mesh modes, which no step resolves, gain nothing. Once the two runs
have parted, on a motion that is sensitive to everything, there is nothing to extrapolate: the run stops there.
"""

from dataclasses import replace

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.sizes import extent
from polyida.integrate.state import State, States

PARTED = 0.03  # distance of the two runs over the extent of the model, beyond which they tell of different motions


def extrapolated(settings, model, state, t_end, counts):
    """Yield the extrapolated states at the ends of steps of h. Raises StepFailure, also where h and h/2 have parted."""
    plain = replace(settings, extrapolate=False)
    coarse, fine = (States(plain.in_pieces(model, state, t_end, counts, split), counts) for split in (1, 2))
    for one in coarse:
        next(fine)
        two = next(fine)
        counts.steps -= 2
        apart = float(np.abs(two.q - one.q).max())
        if apart > PARTED * extent(model, two.q):
            reason = f"the runs with h and h/2 are {apart:.3g} apart in q; there is nothing to extrapolate: take a shorter h"
            raise StepFailure("extrapolation", reason, one.t, **{"|q(h) - q(h/2)|": apart})
        x = [(4 * b - a) / 3 for a, b in ((one.q, two.q), (one.v, two.v), (one.a, two.a), (one.lam, two.lam))]
        yield State(one.t, *x, restart=False)
