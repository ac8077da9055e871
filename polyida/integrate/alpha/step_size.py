"""Step sizes of generalized-alpha from local errors of q, `C h^2 (q''_1 - q''_0)`.

h is piecewise constant, on levels that differ by a factor 2^(1/4), so that factors are kept and changes of h are few. The local error is
bounded in each step, or over the whole run: then each step may have its share of the time.
"""

from dataclasses import dataclass

import numpy as np

from polyida.integrate.discontinuities import PARTS
from polyida.integrate.sizes import sizes_of_run

ORDER = 3  # of the local error in h
CAREFUL = 0.3  # of the first step that the motion's size and speed suggest
AIM = 5e-5  # default rtol of a run; its error is about twice that
LEVELS = 4  # for a factor of two
SAFETY = 0.85
CUT = 2 * LEVELS  # levels down if Newton's method fails
LAST_LEVEL = 30 * LEVELS


@dataclass(frozen=True)
class ErrorControl:
    """No step above `largest`, s; local errors of q below `atol + rtol |q|`, or below h/span of that.

    first: first step, s. span: time of the run, s, or None if the bound holds for each step. sizes: the run's (integrate/sizes.py) if the
    bounds were chosen from them.
    """

    largest: float
    rtol: float
    atol: float
    first: float = np.inf
    span: float | None = None
    sizes: tuple = ()

    @property
    def order(self):
        """The power of h in the ratio of local to allowed error: ORDER, or one less if the allowed error is h/span of the run's."""
        return ORDER if self.span is None else ORDER - 1

    @property
    def before(self):
        """Weight in the error of the change of q'' in the step before, over that in the step itself.

        Modes far too fast for h change sign in every step, by -rho_inf: half the change over two steps nearly cancels them, and equals the
        change in one step for a motion that is resolved.
        """
        return 0.0 if self.span is None else 1.0

    def allowed(self, h):
        """(rtol, atol, the error below which h may grow by two levels) of a step of h."""
        share = 1.0 if self.span is None else h / self.span
        grow = (SAFETY / 2.0 ** (2 / LEVELS)) ** self.order if h < 0.99 * self.largest else 0.0
        return share * self.rtol, share * self.atol, grow


def control_of_run(settings, model, state, t_end):
    """The ErrorControl of a run from the state to t_end whose local errors add up to atol + rtol |q|; `studies/defaults.py` measures its errors.

    It begins below the step that is allowed for a motion over the model's length L within T: `|C| (h/T)^3 L = h/span (atol + rtol L)`.
    """
    length, _, span, lengths = sizes = tuple(map(float, sizes_of_run(model, state, t_end)))
    rtol, atol = tolerances(settings.rtol, settings.atol, length)
    time = span / lengths
    first = CAREFUL * time * np.sqrt((atol / length + rtol) * time / (abs(settings.coefficients.error) * span))
    return ErrorControl(span / PARTS, rtol, atol, min(first, span / PARTS), span, sizes)


def tolerances(rtol, atol, length):
    """(rtol, atol) of a run of a model of that length; None for the defaults."""
    rtol = AIM if rtol is None and atol is None else rtol or 0.0
    return rtol, rtol * length if atol is None else atol


class StepSizeController:
    """The level of the step: 0 is control.largest, each level less by a factor 2^(1/4). It begins near h, or near `most` below it.

    level_of_longest: that of `longest`, above which no step is.
    """

    def __init__(self, control, h, most, longest):
        """Begin at the least of h, `most` and the largest step, s; longest: limit of all later steps, s."""
        self.control = control
        self.level = int(np.clip(round(LEVELS * np.log2(control.largest / min(h, most, control.largest))), 0, LAST_LEVEL))
        self.level_of_longest = 0 if longest == control.largest else int(np.ceil(LEVELS * np.log2(control.largest / longest) - 1e-9))

    @property
    def h(self):
        """The step at the present level, s."""
        return self.control.largest * 2.0 ** (-self.level / LEVELS)

    def reduce(self, error):
        """Reduce h until the predicted error is allowed, by one level at least."""
        self.level += max(1, int(np.ceil(-self._levels(error))) if np.isfinite(error) else CUT)

    def raise_step(self, error):
        """Raise h until the predicted error is the allowed one, at most by a factor of 2."""
        self.level = max(0, self.level_of_longest, self.level - min(LEVELS, int(np.floor(self._levels(error)))))

    def _levels(self, error):
        """Number of levels, a real number, by which h may rise; negative if it must fall. error: over the allowed one."""
        return LEVELS * np.log2(SAFETY * max(error, 1e-12) ** (-1 / self.control.order))
