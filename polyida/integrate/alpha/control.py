"""What adaptive steps are held to: the local error of each as it was given, or its share of what a whole run may have."""

from dataclasses import dataclass

import numpy as np

from polyida.integrate.moves import PARTS
from polyida.integrate.sizes import sizes_of_run

ORDER = 3  # the local error is of that order in h
CAREFUL = 0.3  # of the first step that the motion's size and speed suggest
AIM = 5e-5  # rtol of a run where nothing was given: for an error of twice that


@dataclass(frozen=True)
class Control:
    """No step above `largest`, s; local errors of q below `atol + rtol |q|`, or below h/span of that.

    span: of the run, s, None where each step may have it all. first: the step to begin with, s. sizes: those of a run without h
    (integrate/sizes.py), from which it took these.
    """

    largest: float
    rtol: float
    atol: float
    first: float = np.inf
    span: float | None = None
    sizes: tuple = ()

    @property
    def order(self) -> int:
        """In h, of the local error over what is allowed."""
        return ORDER if self.span is None else ORDER - 1

    def allowed(self, h: float) -> tuple[float, float]:
        """(rtol, atol) of a step of h."""
        share = 1.0 if self.span is None else h / self.span
        return share * self.rtol, share * self.atol

    @property
    def before(self) -> float:
        """The weight of the step before in the change of q'' that the error is told from, beside 1 of the step itself.

        Modes far too fast for h change sign in every step, by -rho_inf: half the change over two steps sees next to nothing of them,
        and of a motion that is resolved the same as the change in one.
        """
        return 0.0 if self.span is None else 1.0

    @property
    def memory(self) -> dict:
        """What a state keeps of it, so that a run goes on with the same."""
        return {} if self.span is None else {"sizes": np.array(self.sizes)}


def over_run(settings, model, state, t_end):
    """The Control of a run from the state to t_end whose local errors add up to no more than atol + rtol |q|.

    What errors come of it `studies/defaults.py` measures: about their sum, and less where a motor drives all the time. It begins below the step that a motion bears that goes the model's length L within T:
    `|C| (h/T)^3 L = h/span (atol + rtol L)`.
    """
    length, _, span, ways = sizes = tuple(map(float, sizes_of_run(model, state, t_end)))
    rtol, atol = tolerances(settings.rtol, settings.atol, length)
    time = span / ways
    first = CAREFUL * time * np.sqrt((atol / length + rtol) * time / (abs(settings.coefficients.error) * span))
    return Control(span / PARTS, rtol, atol, min(first, span / PARTS), span, sizes)


def tolerances(rtol, atol, length):
    """(rtol, atol) of a run of a model of that length where these are given, or None."""
    rtol = AIM if rtol is None and atol is None else rtol or 0.0
    return rtol, rtol * length if atol is None else atol
