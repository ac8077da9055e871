"""Generalized-alpha on index 3 (Chung and Hulbert 1993; Arnold and Bruels 2007), scaled after Bottasso and Bauchau."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from polyida.errors import InputError
from polyida.integrate.alpha.march import Control, adapt, extrapolated, march, over_run, tolerances
from polyida.integrate.alpha.steps import Steps
from polyida.integrate.kinks import enough_steps, run_of, stretches
from polyida.integrate.moves import PARTS, cells_of
from polyida.integrate.state import Counts, Integrator, State, States, Stretch
from polyida.linear.saddle import SCALINGS
from polyida.linear.step_matrix import WholeMatrix
from polyida.model import Model
from polyida.validation import floats, is_flag, is_number, is_one_of, is_whole, named_keywords

LINEAR = ("auto", "kkt")
ABSOLUTE = 1e-3  # m: atol over rtol where only rtol is given, for a start at q = 0
FORMS = ("index3", "stabilised")
SHARE = 1e-3  # of the local error of a step that Newton may leave, where `tolerance` says nothing
LEAST, MOST = 1e-7, 1e-4  # of the size of q'': bounds of that


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


@named_keywords
@dataclass(frozen=True)
class GeneralizedAlpha(Integrator):
    """Generalized-alpha: equilibrium and phi = 0 hold at the end of each step,
    `(1 - alpha_m) a_1 + alpha_m a_0 = (1 - alpha_f) q''_1 + alpha_f q''_0`, with Newmark's formulas in a.

    h: step, s, or None: by the error of the run, see rtol. A piece of a run between kinks of its loads takes the largest step not above
    h that divides it evenly, four at least behind a kink where loads and motors are no straight lines, and as many as it needs where a
    load or motor moves too fast for h (integrate/moves.py).
    rho_inf: spectral radius at infinite frequency, in [0, 1). member: other members of the family, (alpha_m, alpha_f,
    beta, gamma), in place of rho_inf; see `hht`, `wbz` and `newmark`.
    form: "index3", or "stabilised": also phi_q v + phi_t = 0 at the end of each step, q moved along M^-1 phi_q^T to
    have both. rtol, atol: with either given, steps change on the ladder h 2^(-k/4) so that the local error of q,
    `(1/6 - (alpha_m - alpha_f)/2 - beta) h^2 (q''_1 - q''_0)`, stays below atol + rtol |q| (root mean squares, each
    coordinate weighted with its mass; m; atol is 1e-3 rtol where only rtol is given); lam is not in it. h is then the
    largest step, and the run fails beyond max_num_steps steps, with those rejected. Without h the local errors
    of all steps together stay below that: each may have h over the run's time of it; rtol is 5e-5 where neither is given, and atol rtol
    times the model's length (integrate/sizes.py). The error of the run is then about twice rtol, 1e-4 of the model's size by default
    (integrate/alpha/march.py), unless neighbouring motions part faster than in proportion to time; the summary says what was chosen.
    extrapolate: give (4 x(h/2) - x(h))/3 at the ends of steps of h (Richardson), fixed steps only.

    tolerance: Newton's, of beta h^2 times the size of q''; None: 1e-3 of the step's local error, but at least 1e-7 and at
    most 1e-4 of that. max_iterations: of one Newton solve. max_halvings: a step
    whose Newton fails even with a fresh matrix in each iteration, or ends where the model objects, is taken in 2, 4,
    ... 2^max_halvings parts. scaling: "none", "bottasso" or "physical". start: "consistent" (second order in lam from
    the first step) or "plain" (a_0 = q''). incremental_phi: carry phi of a scene by its increments, clean down to h =
    1e-9, or take it from positions with their round-off. linear: "auto", the model's step matrix with a border of its constraints; "kkt": the whole
    matrix of both, in plain code; `scaling` acts there only. Raises InputError for a setting out of range.
    """

    h: float | None = None
    rho_inf: float = 0.9
    tolerance: float | None = None
    scaling: str = "physical"
    max_iterations: int = 25
    start: str = "consistent"
    linear: str = "auto"
    form: str = "index3"
    member: tuple | None = None
    rtol: float | None = None
    atol: float | None = None
    extrapolate: bool = False
    incremental_phi: bool = True
    max_halvings: int = 6
    max_num_steps: int = 1_000_000
    second_order = trusted = writes_rows = True

    @classmethod
    def hht(cls, h: float | None = None, alpha: float = -0.05, **settings) -> Self:
        """Hilber, Hughes, Taylor 1977: alpha_m = 0, alpha_f = -alpha, alpha in [-1/3, 0); second order."""
        if not (is_number(alpha) and -1 / 3 <= alpha < 0):
            raise InputError(f"GeneralizedAlpha.hht: alpha = {alpha!r} must be in [-1/3, 0); index 3 is unstable at 0")
        return cls(h, member=_tuple(Coefficients.second_order(0.0, -alpha)), **settings)

    @classmethod
    def wbz(cls, h: float | None = None, alpha: float = -0.05, **settings) -> Self:
        """Wood, Bossak, Zienkiewicz 1980: alpha_m = alpha, alpha_f = 0, alpha in (-1, 0); second order."""
        if not (is_number(alpha) and -1 < alpha < 0):
            raise InputError(f"GeneralizedAlpha.wbz: alpha = {alpha!r} must be in (-1, 0); index 3 is unstable at 0")
        return cls(h, member=_tuple(Coefficients.second_order(alpha, 0.0)), **settings)

    @classmethod
    def newmark(cls, h: float, beta: float = 0.3025, gamma: float = 0.6, **settings) -> Self:
        """Newmark 1959: alpha_m = alpha_f = 0. Index 3 needs gamma > 1/2, which makes it first order; the trapezoidal
        rule (1/4, 1/2) is refused: its constraint forces grow without bound."""
        return cls(h, member=(0.0, 0.0, beta, gamma), **settings)

    def __post_init__(self):
        for name, good, want in self._checks():
            if not good:
                raise InputError(f"GeneralizedAlpha: {name} = {getattr(self, name)!r} must be {want}")
        if self.member is not None:
            object.__setattr__(self, "member", tuple(map(float, self.member)))
            require_damping("GeneralizedAlpha", self.coefficients)
            if self.h is None and not self.coefficients.tells:
                raise InputError(
                    f"GeneralizedAlpha: h = None must be a step in s for the member {self.member}, whose local error is not told"
                )
        if self.adaptive and self.h is not None:
            object.__setattr__(self, "rtol", float(self.rtol or 0.0))
            object.__setattr__(self, "atol", ABSOLUTE * self.rtol if self.atol is None else float(self.atol))

    def _checks(self):
        allowed = lambda x: x is None or (is_number(x) and 0 <= x < 1)  # noqa: E731
        return (
            ("h", self.h is None or (is_number(self.h) and self.h > 0), "a positive step in s, or None: by the error of the run"),
            ("rho_inf", is_number(self.rho_inf) and 0 <= self.rho_inf < 1, "in [0, 1); index 3 is unstable at 1"),
            (
                "tolerance",
                self.tolerance is None or (is_number(self.tolerance) and 0 < self.tolerance < 1),
                "between 0 and 1, or None: by the local error",
            ),
            ("scaling", is_one_of(self.scaling, SCALINGS), f"one of {', '.join(SCALINGS)}"),
            ("max_iterations", is_whole(self.max_iterations), "a positive whole number"),
            ("linear", is_one_of(self.linear, LINEAR), f"one of {', '.join(LINEAR)}"),
            ("start", is_one_of(self.start, ("consistent", "plain")), '"consistent" or "plain"'),
            ("form", is_one_of(self.form, FORMS), f"one of {', '.join(FORMS)}"),
            ("member", self.member is None or _four(self.member), "four numbers, alpha_m, alpha_f, beta, gamma, or None"),
            ("rtol", allowed(self.rtol), "a number in [0, 1) or None"),
            (
                "atol",
                allowed(self.atol) and (self.rtol is self.atol is None or self.rtol or self.atol),
                "a length below 1 m or None, and not zero beside rtol = 0",
            ),
            (
                "extrapolate",
                is_flag(self.extrapolate) and not (self.extrapolate and self.adaptive),
                "True or False, and False where the step adapts",
            ),
            ("incremental_phi", is_flag(self.incremental_phi), "True or False"),
            ("max_num_steps", is_whole(self.max_num_steps), "a positive whole number"),
            ("max_halvings", is_whole(self.max_halvings, 0, 20), "a whole number from 0 to 20"),
        )

    @property
    def coefficients(self) -> Coefficients:
        """The member's coefficients."""
        return Coefficients(*self.member) if self.member is not None else Coefficients.chung_hulbert(self.rho_inf)

    def newton_tolerance(self, scale: float) -> tuple[float, float, float]:
        """(least, most, share): Newton may leave share times the change of q'' in a step, within least and most times q''.

        scale: h^2 q'' over the q that goes with it.
        """
        if self.tolerance is not None:
            return self.tolerance, self.tolerance, 0.0
        return LEAST, MOST, SHARE * max(abs(self.coefficients.error), 1 / 12) * scale

    @property
    def adaptive(self) -> bool:
        """Whether the step follows the local error."""
        return self.h is None or self.rtol is not None or self.atol is not None

    def fixed_step(self) -> float:
        """h; 0 with step control."""
        return 0.0 if self.adaptive else float(self.h or 0.0)

    def relative_tolerance(self) -> float | None:
        """rtol with step control, None with fixed steps."""
        return self.rtol if self.adaptive else None

    def without_halving(self) -> Self:
        """The same with max_halvings = 0 if its steps are fixed."""
        return self if self.adaptive else replace(self, max_halvings=0)

    def summary_of_steps(self, memory: dict) -> str:
        """What a summary says of the steps that a run without h took; memory of one of its states."""
        if self.h is not None or "sizes" not in memory:
            return ""
        length, _, time, _ = memory["sizes"]
        rtol, atol = tolerances(self.rtol, self.atol, length)
        last = f", at last of {float(memory['h']):.1e} s" if "h" in memory else ""
        return f"steps by local errors of q that add up to {atol:.1e} + {rtol:.1e} |q| in {time:.4g} s{last}"

    def steps(self, model: Model, state: State, t_end: float, counts: Counts, rows: Any = None) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one a step; rows: where to write them, see Steps. Raises StepFailure."""
        if self.extrapolate:
            return extrapolated(self, model, state, t_end, counts)
        return States(self.in_pieces(model, state, t_end, counts, rows=rows), counts)

    def in_pieces(
        self, model: Model, state: State, t_end: float, counts: Counts, split: int = 1, rows: Any = None, watch: Any = None
    ) -> Iterator[Stretch]:
        """The same in stretches, with h / split between the kinks of loads and motors, where h divides each piece evenly; watch: see Steps."""
        engine = self._engine(model, counts, self._control(model, state, t_end))
        engine.rows, engine.watch, control = rows or engine.rows, watch, engine.control
        most_steps = counts.steps + counts.rejected + self.max_num_steps
        run = run_of(state, t_end)
        h, fine = cells_of(control.largest, np.ptp(run)) if control else (self.h, PARTS)
        for begin, end, most in stretches(model, run[0], t_end, h, fine, now=state.t):
            if control:
                piece = adapt(engine, self, model, state, begin, end, min(control.largest, most), counts, most_steps)
            else:
                count = split * enough_steps(model, state, begin, end, min(self.h, most))
                piece = march(engine, self, model, state, begin, end, count, counts)
            for stretch in piece:
                state = stretch.last
                if state.restart:
                    state.memory["run"] = run
                yield stretch

    def _engine(self, model, counts, control):
        return Steps(self, model, counts, control)

    def _control(self, model, state, t_end):
        """What its steps are held to; None where they are equal."""
        if self.h is None:
            return over_run(self, model, state, t_end)
        return Control(self.h, self.rtol, self.atol) if self.adaptive else None

    def step_matrix(self, model: Model) -> Any:
        """The model's step matrix, by `linear` and, where that is "kkt", `scaling`."""
        return WholeMatrix(model, self.scaling) if self.linear == "kkt" else model.step_matrix()


def _four(given):
    numbers = floats(given)
    return numbers is not None and numbers.shape == (4,)


def _tuple(c):
    return c.alpha_m, c.alpha_f, c.beta, c.gamma
