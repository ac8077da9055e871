"""The generalized-alpha family: coefficients of its members, and which of them damp at infinite frequency."""

from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError


@dataclass(frozen=True)
class Coefficients:
    """alpha_m, alpha_f, beta, gamma of a member of the family."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float

    @classmethod
    def chung_hulbert(cls, rho_inf):
        """`alpha_m = (2 rho - 1)/(rho + 1)`, `alpha_f = rho/(rho + 1)`: the least low-frequency damping."""
        return cls.second_order((2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1))

    @classmethod
    def second_order(cls, alpha_m, alpha_f):
        """`gamma = 1/2 - alpha_m + alpha_f`, `beta = (gamma + 1/2)^2 / 4`."""
        gamma = 0.5 - alpha_m + alpha_f
        return cls(alpha_m, alpha_f, (gamma + 0.5) ** 2 / 4, gamma)

    def rates(self, h):
        """(dq''/dq, dv/dq) in a step of h."""
        return (1 - self.alpha_m) / (self.beta * h * h * (1 - self.alpha_f)), self.gamma / (self.beta * h)

    @property
    def error(self):
        """C in the local error of q, `C h^2 (q''_1 - q''_0)`: `C = 1/6 - (alpha_m - alpha_f)/2 - beta`."""
        return 1 / 6 - (self.alpha_m - self.alpha_f) / 2 - self.beta

    @property
    def tells(self):
        """Whether that is all of the leading error: the member is of second order, and C is not zero."""
        return abs(self.gamma - 0.5 + self.offset) < 1e-6 and abs(self.error) > 1e-3

    @property
    def offset(self):
        """Steps by which the algorithmic acceleration is ahead of q'': alpha_m - alpha_f."""
        return self.alpha_m - self.alpha_f

    @property
    def at_infinity(self):
        """Spectral radius along a constraint: of (h v, h^2 a) where q = 0, and of q''. Below 1 it is stable on index
        3.
        """
        b, g = self.beta, self.gamma
        motion = np.array([[1 - g / b, 1 - g / (2 * b)], [-1 / b, 1 - 1 / (2 * b)]])
        return max(float(np.abs(np.linalg.eigvals(motion)).max()), abs(self.alpha_f / (1 - self.alpha_f)))


def require_damping(name, c):
    """Raise InputError unless the member has numbers that make a method, and damps at infinite frequency."""
    finite = np.isfinite([c.alpha_m, c.alpha_f, c.beta, c.gamma]).all()
    if not (finite and c.beta > 0 and c.alpha_m < 1 and c.alpha_f < 1):
        raise InputError(f"{name}: {c} must be finite, with beta > 0, alpha_m < 1, alpha_f < 1")
    if not c.at_infinity < 1 - 1e-6:
        raise InputError(
            f"{name}: {c} has the spectral radius {c.at_infinity:.3g} at infinite frequency; on index 3 it "
            "must be below 1, or constraint forces grow (trapezoidal rule: beta 1/4, gamma 1/2)"
        )
