"""Time stepping through impacts and friction: steps of one size, which do not end at the events.

The step of each method is in nonsmooth/steps.py.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from polyida.fields import above_zero, check_fields, must_be, none_or
from polyida.integrate.alpha.generalized_alpha import Coefficients, GeneralizedAlpha
from polyida.integrate.discontinuities import Grid, at_kink, inner_side, number_of_steps, pieces
from polyida.integrate.nonsmooth.steps import Steps
from polyida.integrate.state import Counts, Integrator, State
from polyida.model import Model
from polyida.validation import is_number, is_whole, named_keywords


def _is_tolerance(value):
    """True for a number in [1e-14, 1)."""
    return is_number(value) and 1e-14 <= value < 1.0


STEP = must_be("a positive step in s", above_zero)  # checks of settings that both methods have
ITERATIONS = must_be("a positive whole number", is_whole)


class TimeStepping(Integrator):
    """What both methods share: the walk over pieces and steps, and Newton's method with a factor that is kept."""

    h: float
    tolerance: Any
    max_iterations: int
    trusted = velocity_rows = takes_laws = True

    def steps(self, model: Model, state: State, t_end: float, counts: Counts) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one for each step. Raises StepFailure."""
        run = Steps(self, model, counts)
        state = state if "closed" in state.memory else run.contacts.begin(state)
        for begin, end, most in pieces(model, state.t, t_end, self.h):
            v = model.sampled(begin, state.q, state.v)
            if at_kink(model, begin) or v is not state.v:
                state = run.restarted(state, v)
            grid = Grid(begin, end, number_of_steps(model, state, begin, end, min(self.h, most)))
            for k in range(1, grid.count + 1):
                state = run.step(state, grid.time(k) if k < grid.count else inner_side(model, end, grid.h), grid.h)
                state = state if k < grid.count else replace(state, t=end)
                counts.steps += 1
                yield state

    def __post_init__(self):
        """Check the settings. Raises InputError for a setting out of range."""
        check_fields(self, self.class_name())


@named_keywords
@dataclass(frozen=True)
class NonsmoothAlpha(TimeStepping):
    """Generalized-alpha in three stages for models with contact and friction: no penetration, no drift.

    Second order through friction and lasting contact, first order at impacts.

    Parameters
    ----------
    h : float, s
        Step.
    rho_inf : float
        Spectral radius at infinite frequency, in [0, 1). 0.3 to 0.5 while elastic waves of impacts matter.
    tolerance : float, optional
        Newton's tolerance, of beta h^2 times the size of q''. By default 1e-3 of the local error, but at least 1e-7 and at most 1e-4.
    max_iterations : int
        Largest number of iterations of a step.

    Raises
    ------
    InputError
        For a setting out of range.

    Notes
    -----
    `run.lam` of the rows with laws is P/h, the mean force of a step with its impacts.

    Capobianco, Harsch, Eugster, Leine, Int. J. Numer. Methods Eng. 122 (2021) 6497-6526; Cosimo, Galvez, Cavalieri, Cardona, Bruels, Multibody
    Syst. Dyn. 48 (2020) 127-157.
    """

    h: float = field(metadata=STEP)
    rho_inf: float = field(default=0.8, metadata=must_be("in [0, 1)", lambda rho: is_number(rho) and 0.0 <= rho < 1.0))
    tolerance: float | None = field(default=None, metadata=must_be("in [1e-14, 1)", none_or(_is_tolerance)))
    max_iterations: int = field(default=40, metadata=ITERATIONS)
    order, impulsive = 2, False

    @property
    def coefficients(self) -> Coefficients:
        """alpha_m, alpha_f, beta and gamma of Chung and Hulbert for rho_inf."""
        return Coefficients.chung_hulbert(self.rho_inf)

    def newton_tolerance(self, scale: float) -> tuple[float, float, float]:
        """(least, most, share) of Newton's tolerance of q'': share times its change in a step, within least and most times q''.

        scale: the ratio of h^2 q'' to q. A tolerance that the user gives is least and most, with share 0.
        """
        return GeneralizedAlpha(h=self.h, rho_inf=self.rho_inf, tolerance=self.tolerance).newton_tolerance(scale)


@named_keywords
@dataclass(frozen=True)
class MoreauJean(TimeStepping):
    """Time stepping of Moreau and Jean, of first order: `M (v_1 - v_0) + h g_theta + phi_q^T P = 0`, `q_1 = q_0 + h v_theta`.

    The known yardstick: robust, with penetration and drift of the order of h. phi_q is that of the end of a step: with theta = 1/2 the spin
    w of a free body decreases at the rate h w^3 / 2, with theta = 1 the body shrinks instead.

    Parameters
    ----------
    h : float, s
        Step.
    theta : float
        Weight of the end of a step, in [1/2, 1].
    tolerance : float
        Newton's tolerance, of the change of q in a step.
    max_iterations : int
        Largest number of iterations of a step.

    Raises
    ------
    InputError
        For a setting out of range.

    Notes
    -----
    Moreau, in Nonsmooth Mechanics and Applications (1988) 1-82; Jean, Comput. Methods Appl. Mech. Eng. 177 (1999) 235-257.
    """

    h: float = field(metadata=STEP)
    theta: float = field(default=0.5, metadata=must_be("in [0.5, 1]", lambda theta: is_number(theta) and 0.5 <= theta <= 1.0))
    tolerance: float = field(default=1e-10, metadata=must_be("in [1e-14, 1)", _is_tolerance))
    max_iterations: int = field(default=40, metadata=ITERATIONS)
    order, impulsive = 1, True

    def newton_tolerance(self, scale: float) -> tuple[float, float, float]:
        """(least, most, share) as NonsmoothAlpha has them: Newton may leave the tolerance times the change of q in a step."""
        return float(self.tolerance), float(self.tolerance), 0.0
