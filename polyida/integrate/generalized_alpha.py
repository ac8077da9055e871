"""Generalized-alpha on index 3 (Chung and Hulbert 1993; Arnold and Bruels 2007), scaled after Bottasso and Bauchau."""

from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.integrate import alpha_generic
from polyida.integrate import alpha_scene
from polyida.integrate.segments import segments
from polyida.linear.kkt import SCALINGS


LINEAR = ("auto", "fronts", "band", "superlu", "kkt")


@dataclass(frozen=True)
class Coefficients:
    """alpha_m, alpha_f, beta, gamma of a member of the family."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float

    @classmethod
    def chung_hulbert(cls, rho_inf):
        """`alpha_m = (2 rho - 1)/(rho + 1)`, `alpha_f = rho/(rho + 1)`, second order with the least low-frequency damping."""
        alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
        gamma = 0.5 - alpha_m + alpha_f
        return cls(alpha_m, alpha_f, (gamma + 0.5) ** 2 / 4, gamma)


@dataclass(frozen=True)
class GeneralizedAlpha:
    """Generalized-alpha with constant steps.

    Equilibrium and phi = 0 hold at the end of each step, `(1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) q''_1 + alpha_f q''_0`,
    with Newmark's formulas in a. h: step, s; a run takes the largest step not above h that divides its time evenly. rho_inf: spectral
    radius at infinite frequency, in [0, 1). tolerance: Newton's, of beta h^2 times the size of q''. scaling: "none", "bottasso" or
    "physical". max_iterations: of one Newton solve. start: "consistent" (second order in lam from the first step) or "plain".
    Raises InputError for a setting out of range.
    """

    h: float
    rho_inf: float = 0.9
    tolerance: float = 1e-4
    scaling: str = "physical"
    max_iterations: int = 25
    start: str = "consistent"
    linear: str = "auto"

    def __post_init__(self):
        number = (int, float, np.floating, np.integer)
        checks = (
            ("h", isinstance(self.h, number) and np.isfinite(self.h) and self.h > 0, "a positive step in s"),
            ("rho_inf", isinstance(self.rho_inf, number) and 0 <= self.rho_inf < 1, "in [0, 1); index 3 is unstable at 1"),
            ("tolerance", isinstance(self.tolerance, number) and 0 < self.tolerance < 1, "between 0 and 1"),
            ("scaling", self.scaling in SCALINGS, f"one of {', '.join(SCALINGS)}"),
            ("max_iterations", isinstance(self.max_iterations, int) and self.max_iterations > 0, "a positive whole number"),
            ("linear", self.linear in LINEAR, f"one of {', '.join(LINEAR)}"),
            ("start", self.start in ("consistent", "plain"), '"consistent" or "plain"'),
        )
        for name, good, want in checks:
            if not good:
                raise InputError(f"GeneralizedAlpha: {name} = {getattr(self, name)!r} must be {want}")

    @property
    def coefficients(self):
        """The family's coefficients for rho_inf."""
        return Coefficients.chung_hulbert(self.rho_inf)

    def steps(self, model, state, t_end, counts):
        """Accepted states after `state` up to t_end, one a step. Raises StepFailure."""
        for begin, end in segments(model, state.t, t_end):
            count = max(1, int(np.ceil((end - begin) / self.h * (1 - 1e-12))))
            method = alpha_generic if self.linear == "kkt" or not getattr(model, "fused", False) else alpha_scene
            for state in method.advance(self, model, state, begin, end, count, counts):
                yield state
