"""Richardson extrapolation: `x = (4 x(h/2) - x(h)) / 3` at the ends of steps of h, of order 3 to 4.

Two runs side by side, with h and h/2, none of which sees the other; phi = 0 and energy hold to the order of the result
only. A kink that is hit exactly does no harm; ringing mesh modes, which no step resolves, gain nothing.
"""

from dataclasses import replace

from polyida.integrate.state import State


def extrapolated(settings, model, state, t_end, counts):
    """Yield the extrapolated states at the ends of steps of h. Raises StepFailure."""
    plain = replace(settings, extrapolate=False)
    coarse, fine = (plain.in_pieces(model, state, t_end, counts, split) for split in (1, 2))
    for one in coarse:
        next(fine)
        two = next(fine)
        counts.steps -= 2
        x = [(4 * b - a) / 3 for a, b in ((one.q, two.q), (one.v, two.v), (one.a, two.a), (one.lam, two.lam))]
        yield State(one.t, *x, restart=False)
