"""Generalized-alpha on index 3 (Chung and Hulbert 1993; Arnold and Bruels 2007), scaled after Bottasso and Bauchau."""

from collections.abc import Iterator
from dataclasses import astuple, dataclass, field, replace
from typing import Any, Self

import numpy as np

from polyida.errors import InputError
from polyida.fields import above_zero, check, check_fields, must_be, none_or, optional
from polyida.integrate.alpha.pieces import adaptive_steps, extrapolated, fixed_steps
from polyida.integrate.alpha.step_size import ErrorControl, control_of_run, tolerances
from polyida.integrate.alpha.steps import Steps
from polyida.integrate.discontinuities import PARTS, number_of_steps, pieces, run_interval, sampling
from polyida.integrate.state import Counts, Integrator, State, States, Stretch
from polyida.linear.saddle import SCALINGS, WholeMatrix
from polyida.model import Model
from polyida.validation import flag, floats, is_flag, is_number, is_one_of, is_whole, named_keywords, one_of, settle

LINEAR = ("auto", "kkt")
FORMS = ("index3", "stabilised")
STARTS = ("consistent", "plain")
ABSOLUTE = 1e-3  # m: atol over rtol if only rtol is given, for a start at q = 0
SHARE = 1e-3  # of the local error of a step, which Newton may leave by default
HINT = "errors of a number of the run: pi.error_of(run, objective)"
LEAST, MOST = 1e-7, 1e-4  # of the size of q'': bounds of that
ATOL = "a length below 1 m or None, and not zero beside rtol = 0"
EXTRAPOLATE = "True or False, and False if steps are adaptive"


def _below_one(value):
    """True for a number in [0, 1)."""
    return is_number(value) and 0 <= value < 1


def _four_numbers(label, name, value):
    """Return the value as a tuple of four floats; InputError, with the method and the value, for anything else."""
    numbers = floats(value)
    if numbers is None or numbers.shape != (4,):
        raise InputError(f"{label}: {name} = {value!r} must be four numbers, alpha_m, alpha_f, beta, gamma, or None")
    return tuple(numbers.tolist())


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
    def offset(self):
        """Steps by which the algorithmic acceleration is ahead of q'': alpha_m - alpha_f."""
        return self.alpha_m - self.alpha_f

    @property
    def error(self):
        """C in the local error of q, `C h^2 (q''_1 - q''_0)`: `C = 1/6 - (alpha_m - alpha_f)/2 - beta`."""
        return 1 / 6 - self.offset / 2 - self.beta

    @property
    def has_error_estimate(self):
        """True if that is the whole leading error: the member is of second order and C is not zero."""
        return abs(self.gamma - 0.5 + self.offset) < 1e-6 and abs(self.error) > 1e-3

    @property
    def at_infinity(self):
        """Spectral radius along a constraint: of (h v, h^2 a) with q = 0, and of q''. Below 1 the method is stable on index 3."""
        b, g = self.beta, self.gamma
        motion = np.array([[1 - g / b, 1 - g / (2 * b)], [-1 / b, 1 - 1 / (2 * b)]])
        return max(float(np.abs(np.linalg.eigvals(motion)).max()), abs(self.alpha_f / (1 - self.alpha_f)))

    def require_damping(self):
        """Raise InputError unless the member is a method that damps at infinite frequency."""
        if not (np.isfinite(astuple(self)).all() and self.beta > 0 and self.alpha_m < 1 and self.alpha_f < 1):
            raise InputError(f"GeneralizedAlpha: {self} must be finite, with beta > 0, alpha_m < 1, alpha_f < 1")
        if not self.at_infinity < 1 - 1e-6:
            rule = "on index 3 it must be below 1, or constraint forces grow (trapezoidal rule: beta 1/4, gamma 1/2)"
            raise InputError(f"GeneralizedAlpha: {self} has the spectral radius {self.at_infinity:.3g} at infinite frequency; {rule}")


@named_keywords
@dataclass(frozen=True)
class GeneralizedAlpha(Integrator):
    """Generalized-alpha: equilibrium and phi = 0 hold at the end of each step.

    `(1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) q''_1 + alpha_f q''_0`, with Newmark's formulas in a.

    Parameters
    ----------
    h : float, s, optional
        Step. Each smooth piece of a run takes the largest step not above h that divides it evenly, at least four steps behind a kink of inputs
        that are not straight lines, and shorter ones where inputs change too fast. By default h follows from the error of the run.
    rho_inf : float
        Spectral radius at infinite frequency, in [0, 1).
    tolerance : float, optional
        Newton's tolerance, of beta h^2 times the size of q''. By default 1e-3 of the local error, but at least 1e-7 and at most 1e-4.
    scaling : {"physical", "bottasso", "none"}
        Scaling of the whole matrix of `linear="kkt"`.
    max_iterations : int
        Largest number of iterations of one Newton solve.
    start : {"consistent", "plain"}
        "consistent": second order in lam from the first step; "plain": a_0 = q''.
    linear : {"auto", "kkt"}
        "auto": the model's step matrix with a border of its constraints; "kkt": the whole matrix of both.
    form : {"index3", "stabilised"}
        "stabilised": also `phi_q v + phi_t = 0` at the end of each step, with q corrected along M^-1 phi_q^T.
    member : (4,) array_like, optional
        (alpha_m, alpha_f, beta, gamma) in place of rho_inf; see `hht`, `wbz`, `newmark`.
    rtol : float, optional
        Relative tolerance of q, see Notes. With h, the default is fixed steps; without h, 5e-5.
    atol : float, m, optional
        Absolute tolerance of q. With h, the default is 1e-3 rtol; without h, rtol times the model's length.
    extrapolate : bool
        Return (4 x(h/2) - x(h))/3 at the ends of fixed steps (Richardson).
    incremental_phi : bool
        Carry phi of a scene by increments, accurate down to h = 1e-9 s; False: evaluate it from positions.
    max_halvings : int
        A step that fails is taken in 2, 4, ..., 2^max_halvings parts.
    max_num_steps : int
        Adaptive steps: the run fails beyond that number, rejected steps included.

    Raises
    ------
    InputError
        For a setting out of range.

    Notes
    -----
    The local error of q is `(1/6 - (alpha_m - alpha_f)/2 - beta) h^2 (q''_1 - q''_0)`, a root mean square of coordinates weighted by mass; lam is
    not in it. With h and rtol or atol it stays below atol + rtol |q| in each step, and steps are h 2^(-k/4). Without h the local errors of all
    steps add up to that bound; the error of the run is then about twice rtol, unless the motion is chaotic.

    Chung, Hulbert, J. Appl. Mech. 60 (1993) 371-375; Arnold, Bruels, Multibody Syst. Dyn. 18 (2007) 185-202.
    """

    h: float | None = field(default=None, metadata=must_be("a positive step in s, or None: by the error of the run", none_or(above_zero)))
    rho_inf: float = field(default=0.9, metadata=must_be("in [0, 1); index 3 is unstable at 1", _below_one))
    tolerance: float | None = field(
        default=None, metadata=must_be("between 0 and 1, or None: by the local error", none_or(lambda x: is_number(x) and 0 < x < 1))
    )
    scaling: str = field(default="physical", metadata=check(one_of, SCALINGS))
    max_iterations: int = field(default=25, metadata=must_be("a positive whole number", is_whole))
    start: str = field(default="consistent", metadata=must_be('"consistent" or "plain"', lambda start: is_one_of(start, STARTS)))
    linear: str = field(default="auto", metadata=check(one_of, LINEAR))
    form: str = field(default="index3", metadata=check(one_of, FORMS))
    member: tuple | None = field(default=None, metadata=check(optional, _four_numbers))
    rtol: float | None = field(default=None, metadata=must_be("a number in [0, 1) or None", none_or(_below_one)))
    atol: float | None = field(default=None, metadata=must_be(ATOL, none_or(_below_one)))
    extrapolate: bool = field(default=False, metadata=must_be(EXTRAPOLATE, is_flag))
    incremental_phi: bool = field(default=True, metadata=check(flag))
    max_halvings: int = field(default=6, metadata=must_be("a whole number from 0 to 20", lambda count: is_whole(count, 0, 20)))
    max_num_steps: int = field(default=1_000_000, metadata=must_be("a positive whole number", is_whole))
    second_order = trusted = writes_rows = True

    @classmethod
    def hht(cls, h: float | None = None, alpha: float = -0.05, **settings) -> Self:
        """Hilber, Hughes, Taylor 1977: alpha_m = 0, alpha_f = -alpha, alpha in [-1/3, 0); second order."""
        if not (is_number(alpha) and -1 / 3 <= alpha < 0):
            raise InputError(f"GeneralizedAlpha.hht: alpha = {alpha!r} must be in [-1/3, 0); index 3 is unstable at 0")
        return cls(h, member=astuple(Coefficients.second_order(0.0, -alpha)), **settings)

    @classmethod
    def wbz(cls, h: float | None = None, alpha: float = -0.05, **settings) -> Self:
        """Wood, Bossak, Zienkiewicz 1980: alpha_m = alpha, alpha_f = 0, alpha in (-1, 0); second order."""
        if not (is_number(alpha) and -1 < alpha < 0):
            raise InputError(f"GeneralizedAlpha.wbz: alpha = {alpha!r} must be in (-1, 0); index 3 is unstable at 0")
        return cls(h, member=astuple(Coefficients.second_order(alpha, 0.0)), **settings)

    @classmethod
    def newmark(cls, h: float, beta: float = 0.3025, gamma: float = 0.6, **settings) -> Self:
        """Newmark 1959: alpha_m = alpha_f = 0. Index 3 needs gamma > 1/2, which is of first order; the trapezoidal rule (1/4, 1/2) is unstable."""
        return cls(h, member=(0.0, 0.0, beta, gamma), **settings)

    def __post_init__(self):
        """Check the settings, and those that depend on each other; set what follows from them."""
        check_fields(self, self.class_name())
        tolerances_given = self.rtol is not None or self.atol is not None
        if tolerances_given and not (self.rtol or self.atol):
            raise InputError(f"{self.class_name()}: atol = {self.atol!r} must be {ATOL}")
        if self.extrapolate and self.adaptive:
            raise InputError(f"{self.class_name()}: extrapolate = True must be {EXTRAPOLATE}")
        if self.member is not None:
            self.coefficients.require_damping()
            if self.h is None and not self.coefficients.has_error_estimate:
                unknown = f"for the member {self.member}, whose local error is unknown"
                raise InputError(f"GeneralizedAlpha: h = None must be a step in s {unknown}")
        if self.adaptive and self.h is not None:
            rtol = float(self.rtol or 0.0)
            settle(self, rtol=rtol, atol=ABSOLUTE * rtol if self.atol is None else float(self.atol))

    @property
    def coefficients(self) -> Coefficients:
        """alpha_m, alpha_f, beta and gamma: those of `member`, or Chung and Hulbert's for rho_inf."""
        return Coefficients(*self.member) if self.member is not None else Coefficients.chung_hulbert(self.rho_inf)

    @property
    def order(self) -> int:  # type: ignore[override]  # it depends on the member
        """2, or 1 of a member with damping of first order."""
        c = self.coefficients
        return 1 if abs(c.gamma - 0.5 + c.offset) > 1e-6 else 2

    def newton_tolerance(self, scale: float) -> tuple[float, float, float]:
        """(least, most, share) of Newton's tolerance of q'': share times its change in a step, within least and most times q''.

        scale: the ratio of h^2 q'' to q. A tolerance that the user gives is least and most, with share 0.
        """
        if self.tolerance is not None:
            return self.tolerance, self.tolerance, 0.0
        return LEAST, MOST, SHARE * max(abs(self.coefficients.error), 1 / 12) * scale

    @property
    def adaptive(self) -> bool:
        """True if the step follows the local error."""
        return self.h is None or self.rtol is not None or self.atol is not None

    def without_halving(self) -> Self:
        """The integrator with max_halvings = 0 if its steps are fixed; itself if they are adaptive."""
        return self if self.adaptive else replace(self, max_halvings=0)

    def settings_used(self, memory: dict) -> dict:
        """{setting: value} of a run, with the rtol and atol that a run without h chose; memory of one of its states."""
        used = super().settings_used(memory)
        if self.h is None and "sizes" in memory:
            used["rtol"], used["atol"] = map(float, tolerances(self.rtol, self.atol, memory["sizes"][0]))
        return used

    def summary_of_steps(self, memory: dict) -> str:
        """Text of a summary: how to estimate errors, and the steps that a run without h took; memory of one of its states."""
        if self.h is not None or "sizes" not in memory:
            return HINT
        length, _, time, _ = memory["sizes"]
        rtol, atol = tolerances(self.rtol, self.atol, length)
        last = f", at last of {float(memory['h']):.1e} s" if "h" in memory else ""
        return f"steps by local errors of q that add up to {atol:.1e} + {rtol:.1e} |q| in {time:.4g} s{last}, {HINT}"

    def steps(self, model: Model, state: State, t_end: float, counts: Counts, rows: Any = None) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one for each step; rows: arrays for the frames, see Steps. Raises StepFailure."""
        if self.extrapolate:
            return extrapolated(self, model, state, t_end, counts)
        return States(self.in_pieces(model, state, t_end, counts, rows=rows), counts)

    def in_pieces(
        self, model: Model, state: State, t_end: float, counts: Counts, split: int = 1, rows: Any = None, recorder: Any = None
    ) -> Iterator[Stretch]:
        """Stretches of the accepted states up to t_end, with steps of h / split; recorder: what records the segments and steps, or None."""
        if self.h is None:
            control = control_of_run(self, model, state, t_end)
        else:
            control = ErrorControl(self.h, float(self.rtol or 0.0), float(self.atol or 0.0)) if self.adaptive else None
        engine = self._engine(model, counts, control)
        engine.rows, engine.recorder = rows or engine.rows, recorder
        most_steps = counts.steps + counts.rejected + self.max_num_steps
        run = run_interval(state, t_end)
        h, samples = sampling(control.largest, np.ptp(run)) if control else (self.h, PARTS)
        for begin, end, most in pieces(model, run[0], t_end, h, samples, now=state.t):
            if control:
                stretches = adaptive_steps(engine, state, begin, end, min(control.largest, most), most_steps)
            else:
                count = split * number_of_steps(model, state, begin, end, min(self.h, most))
                stretches = fixed_steps(engine, state, begin, end, count)
            for stretch in stretches:
                state = stretch.last
                if state.restart:
                    state.memory["run"] = run
                yield stretch

    def _engine(self, model, counts, control):
        """The Steps that take the steps; subclasses have others."""
        return Steps(self, model, counts, control)

    def step_matrix(self, model: Model) -> Any:
        """The model's step matrix, or the whole matrix for `linear="kkt"`."""
        return WholeMatrix(model, self.scaling) if self.linear == "kkt" else model.step_matrix()
