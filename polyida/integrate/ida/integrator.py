"""IDA of SUNDIALS: variable-step, variable-order BDF on a stabilised form of the model's equations."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError, StepFailure
from polyida.integrate.ida.error_lines import error_lines_kept
from polyida.integrate.ida.forms import FORMS, Accepted, System
from polyida.integrate.ida.linear import Correction
from polyida.integrate.ida.whole import SCALINGS
from polyida.integrate.kinks import at_kink, segments, stops
from polyida.integrate.moves import cells_of
from polyida.integrate.sizes import chosen, relative_tolerance, sizes_of_run, typical_sizes
from polyida.integrate.start import far_side
from polyida.integrate.state import Counts, Integrator, State, States
from polyida.model import Model
from polyida.model.differences import beside
from polyida.system import INSTANTS
from polyida.validation import floats, is_flag, is_number, is_one_of, is_whole, named_keywords

LINEAR = ("auto", "kkt", "whole")
AIM, WAYS, FLEXIBLE_WAYS = (
    1e-5,
    3.0,
    30.0,
)  # rtol by default, of a motion that goes its length not more often; its error is about ten times that
VELOCITY_ATOL = 1e3  # 1/s: absolute tolerance of v over that of q, where a number is given
LOOSE = 5.0  # times rtol: tolerance of v of flexible bodies
OPEN = 1e-2  # of the model's length: a constraint that has drifted further ends the run
LONGEST = 5e-3  # s, that a stretch of states takes, unless a step takes longer
STANDSTILL = 20  # so many steps in a row that hardly move t end the run; IDA alone would go on for ever
STATUS = {
    -2: "accuracy",
    -3: "error test",
    -4: "newton",
    -6: "linear setup",
    -7: "linear solve",
    -8: "residual",
    -9: "residual",
    -12: "residual",
    -22: "input",
}


@named_keywords
@dataclass(frozen=True)
class IDA(Integrator):
    """Backward differentiation formulas of order 1 to 5 with error control, by SUNDIALS' IDA.

    rtol: relative tolerance; by default 1e-5, or less where the motion goes the model's length more than three times (30 times with flexible
    bodies), for an error about 1e-4 of that. atol: absolute tolerances; by default rtol times a length and a speed of the model, told from
    its first state (integrate/sizes.py). The run's summary says what was chosen. A number is that of q (m), with 1e3 1/s times it
    for v (m/s); a pair is (of q, of v); 2n numbers are those of every entry of (q, v).
    Multipliers are not in the error estimate. v of a model with flexible bodies, where atol is not given, is tested LOOSE times less
    sharply: that of stiff modes jumps with every change of the step, h, as in index 3, and no step would be long enough to leave
    order 1. q is tested the more sharply for it, to rtol^(1 + 1/max_order): what a tolerance of v allows q to err by in a step
    goes with h rtol, and, where mesh modes ring, h with rtol^(1/order); where plates turn smoothly it is sharper than need be.
    max_order: 1 to 5; by default 2 where the model has flexible bodies (BDF of order 3 to 5 is unstable beside the
    imaginary axis, where their mesh modes lie; only with all of them well damped is 5 the faster) and 5 elsewhere.
    form: "ggl2" (default), "ggl1", "index2", "index1", "baumgarte" (with `rate`, w in 1/s) or "index3"; the equations
    are in integrate/ida/forms.py. index3 is there to be studied: it is slow, and fails on many models.
    linear: "auto" takes compiled functions for a scene and for a model with n + m <= 50, "kkt" the general ones that any model has, all
    through S = K + cj C + cj^2 M and a border; "whole" factors the whole matrix of (q, v, multipliers). scaling: rows and columns of the whole
    matrix divided by "characteristic" sizes (integrate/ida/whole.py) or "none"; the other two do not depend on it.
    nonholonomic: the rows `phi_rate(t, q, v) = 0`, linear in v with the slope phi_q, need not be the derivative of phi; only with form
    "index2" or "index1", which hold these and not phi. A run refuses a phi_rate, or phi_bias, that is not the derivative of phi otherwise.
    max_step, first_step: s, 0 where IDA decides. max_num_steps: the run fails beyond so many.

    The error of a run, over the model's size, is commonly 2 to 20 times rtol with flexible bodies (far more on very stiff ones with rtol above
    1e-5) and 4 to 500 times without (`studies/defaults.py`). Raises InputError where a setting makes no sense.
    Source: Hindmarsh et al. 2005, SUNDIALS; Gear, Gupta, Leimkuhler 1985.
    """

    rtol: float | None = None
    atol: float | tuple | None = None
    max_order: int | None = None
    form: str = "ggl2"
    max_step: float = 0.0
    max_num_steps: int = 200_000
    first_step: float = 0.0
    rate: float = 10.0
    linear: str = "auto"
    scaling: str = "characteristic"
    nonholonomic: bool = False
    trusted = True

    def __post_init__(self):
        if not is_one_of(self.form, FORMS):
            raise InputError(f"IDA: form {self.form!r} is unknown; there are {', '.join(FORMS)}")
        if self.atol is not None and not is_number(self.atol):
            given = floats(self.atol)
            _check("atol", self.atol, given is not None and given.ndim == 1, "must be a number, a pair or a list of numbers")
            object.__setattr__(self, "atol", tuple(given.tolist()))
        on_velocity = self.form in ("index1", "index2")
        allowed = "must be True or False, and True with form index1 or index2 alone"
        _check("nonholonomic", self.nonholonomic, is_flag(self.nonholonomic) and (on_velocity or not self.nonholonomic), allowed)
        _check("linear", self.linear, is_one_of(self.linear, LINEAR), f"must be one of {', '.join(LINEAR)}")
        _check("scaling", self.scaling, is_one_of(self.scaling, SCALINGS), f"must be one of {', '.join(SCALINGS)}")
        _check("rtol", self.rtol, self.rtol is None or (is_number(self.rtol) and 0 < self.rtol < 1), "must lie between 0 and 1")
        in_range = self.max_order is None or is_whole(self.max_order, 1, 5)
        _check("max_order", self.max_order, in_range, "must be 1, 2, 3, 4 or 5")
        _check("max_num_steps", self.max_num_steps, is_whole(self.max_num_steps), "must be a positive whole number")
        for name in ("max_step", "first_step", "rate"):
            value = getattr(self, name)
            _check(name, value, is_number(value) and value >= 0, "must be a finite number, not negative")
        entries = self.atol if isinstance(self.atol, tuple) else (1.0 if self.atol is None else self.atol,)
        positive = len(entries) >= 1 and all(is_number(x) and x > 0 for x in entries)
        _check("atol", self.atol, positive, "must be positive")

    def relative(self, model: Model, sizes: NDArray) -> float:
        """rtol, or that of a run of these sizes, (length, speed, time, ways)."""
        ways = FLEXIBLE_WAYS if model.flexible else WAYS
        return relative_tolerance(AIM, ways, float(sizes[3])) if self.rtol is None else float(self.rtol)

    def tolerances(self, model: Model, sizes: NDArray) -> tuple[float, float | NDArray, float | NDArray]:
        """(Relative tolerance, absolute ones of q, of v) that IDA gets in a run of these sizes, (length, speed, time, ways).

        InputError where atol does not fit the model.
        """
        rtol, n = self.relative(model, sizes), model.n
        if self.atol is None and model.flexible:
            tight = rtol ** (1 + 1 / self.order(model))
            return tight, tight * float(sizes[0]), LOOSE * rtol * float(sizes[1])
        if self.atol is None:
            return rtol, rtol * float(sizes[0]), rtol * float(sizes[1])
        if not isinstance(self.atol, tuple):
            return rtol, self.atol, VELOCITY_ATOL * self.atol
        if len(self.atol) == 2:
            return rtol, *self.atol
        _check(
            "atol",
            f"of {len(self.atol)} entries",
            len(self.atol) == 2 * n,
            f"must be a number, a pair (of q, of v) or {2 * n} entries for the model's n = {n}",
        )
        return rtol, np.array(self.atol[:n]), np.array(self.atol[n:])

    def relative_tolerance(self) -> float | None:
        """rtol."""
        return self.rtol

    def summary_of_steps(self, memory: dict) -> str:
        """What a summary says of the tolerances that a run took from its model; memory of one of its states."""
        words = [chosen(float(memory["rtol"]), memory["sizes"][3])] if self.rtol is None and "rtol" in memory else []
        if "tolerances" in memory:
            rtol, of_q, of_v = memory["tolerances"]
            sharper = f"rtol {rtol:.1e} and " if rtol != float(memory["rtol"]) else ""
            words.append(f"{sharper}atol {of_q:.1e} of q, {of_v:.1e} of v")
        return ", ".join(words)

    def order(self, model: Model) -> int:
        """The largest BDF order used on this model."""
        return self.max_order or (2 if model.flexible else 5)

    def require_reach(self, model: Model, state: State, t_end: float) -> None:
        """Raise InputError where times near t_end are too far apart, as numbers, to resolve the model's motion."""
        length, speed = typical_sizes(model, state, t_end - state.t)
        if math.ulp(t_end) > length / speed:
            raise InputError(
                f"IDA: t_end = {t_end:g} s is too far: times there are {math.ulp(t_end):.2g} s apart, and "
                f"the model moves within {length / speed:.2g} s"
            )

    def steps(self, model: Model, state: State, t_end: float, counts: Counts) -> Iterator[State]:
        """Accepted States after `state` (consistent), one an internal step, the last at t_end; raises StepFailure.

        At a kink of the model it lands exactly and starts anew from the state consistent with the far side.
        State.memory: "mu" of the stabilised forms, and "sizes", from which "rtol" and "tolerances" came; a run that goes on keeps them.
        """
        return States(self._stretches(model, state, t_end, counts), counts)

    def _stretches(self, model, state, t_end, counts):
        sizes = sizes_of_run(model, state, t_end)
        run, look = _Run(self, model, sizes, counts), cells_of(math.inf, t_end - state.t)
        for begin, end in segments(model, state.t, t_end):
            limits = (-math.inf, math.inf)
            if at_kink(model, begin):
                limits = (beside(begin, 1), math.inf)
                state = far_side(model, state, limits[0])
            if at_kink(model, end):
                limits = (limits[0], beside(end, -1))
            for stretch in run.piece(state, begin, stops(model, state, begin, end, *look), limits):
                yield stretch
            state = stretch.last


def _check(name, value, right, wanted):
    if not right:
        raise InputError(f"IDA: {name} {value} {wanted}")


class _Run:
    """One run of IDA: the solver of the binding with its callbacks, and the counting of steps."""

    def __init__(self, settings, model, sizes, counts):
        from sksundae.ida import IDA as Solver
        from sksundae.ida import IDAJacTimes

        self.settings, self.model, self.counts = settings, model, counts
        rtol, *atol = settings.tolerances(model, sizes)
        self.sizes, self.memory = sizes, {"sizes": sizes, "rtol": settings.relative(model, sizes)}
        self.memory |= {} if settings.atol else {"tolerances": np.array([rtol, *atol])}
        self.system = System(model, settings.form, settings.rate)
        self.linear = Correction(self.system, counts, settings.order(model), settings.linear, settings.scaling)
        self.steps, self.standing, self.attempts = 0, 0, 0
        self.tried, self.last_step = math.nan, math.nan
        self.refused, self.blamed = None, ""  # where the residual was last not finite, and by whose doing
        self.solver = Solver(
            self._residual,
            rtol=rtol,
            atol=self.system.tolerances(*atol),
            max_order=settings.order(model),
            max_step=float(settings.max_step),
            first_step=float(settings.first_step),
            linsolver="gmres",
            krylov_dim=5,
            jactimes=IDAJacTimes(None, self.linear.product),
        )

    def _residual(self, t, y, yp, res):
        self.counts.residuals += 1
        if t != self.tried:
            self.attempts, self.tried = self.attempts + 1, t
        if not self.linear.residual(t, y, yp, res):
            res[:] = math.nan
            self.refused, self.blamed = (t, np.array(y[: self.model.n])), self.model.not_finite

    def piece(self, state, begin, times, limits):
        """Stretches of accepted states on the smooth piece from begin to the last of `times`, all of which it hits.

        The model's time is held to `limits`. A stretch ends before it takes LONGEST, for progress and Ctrl-C wait for it.
        """
        self.system.limits = limits
        y, yp = self.system.pack(state)
        self.linear.begin(begin, y)
        self.solver.init_step(begin, y, yp)
        self.t, self.q, most = begin, state.q, 1 if self.model.switching else INSTANTS
        for end in times:
            while self.t < end:
                made, until = [], time.perf_counter() + LONGEST
                try:
                    with error_lines_kept as printed:
                        while self.t < end and len(made) < most and (not made or time.perf_counter() < until):
                            self._step(end, printed, made)
                except BaseException:
                    if made:
                        spent = self._work()
                        yield self._stretch(made)
                        vars(self.counts).update(spent)
                    raise
                if made:
                    yield self._stretch(made)

    def _stretch(self, made):
        work, *rows = zip(*made)
        return Accepted(self.system, self.memory, work, *map(np.array, rows))

    def _work(self):
        """The counts but for the steps, which are counted as the states are taken."""
        work = vars(self.counts).copy()
        del work["steps"]
        return work

    def _step(self, end, printed, made):
        """Take a step; one below the round-off of t has no instant of its own."""
        if self.steps >= self.settings.max_num_steps:
            raise self._failure("too many steps", f"more than {self.steps} steps (max_num_steps)")
        if self.standing >= STANDSTILL:
            raise self._failure("step too small", "the step has shrunk to the round-off of t")
        self.attempts, self.tried = 0, math.nan
        result = self.solver.step(end, method="onestep", tstop=end)
        if result.status < 0:
            reason = (printed.message or result.message).rstrip(".")
            raise self._failure(STATUS.get(result.status, "ida"), reason)
        t, y = float(result.t), result.y
        q, self.last_step = y[: self.model.n], t - self.t
        self.steps += 1
        self.counts.steps += 1
        self.counts.rejected += max(self.attempts - 1, 0)
        self.standing = self.standing + 1 if self.last_step < 16 * math.ulp(t) else 0
        self.linear.accept(t, y)
        if self.linear.objects and (objection := self.system.rejection_reason(t, q)):
            raise self._failure("objection", objection)
        if opened := self.system.opened(t, q, OPEN * self.sizes[0]):
            raise self._failure("drift", f"{opened}; a form that holds phi, or a tighter rtol, keeps it closed")
        self.refused = self.refused if self.standing else None
        if t > self.t:
            self.t, self.q = t, q
            made.append((self._work(), t, y, result.yp))

    def _failure(self, status, reason):
        """StepFailure at the last accepted state, with the step tried and the constraint that is worst there."""
        if self.refused:
            why = self.model.rejection_reason(*self.refused)
            status, reason = (
                ("objection", f"{why}; {reason}") if why else (status, f"{self.blamed or 'the residual is not finite'}; {reason}")
            )
        phi = np.abs(self.model.phi(self.t, self.q))
        tried = float(self.tried - self.t)
        seen = {"steps": self.steps, "step": tried if tried > 0 else self.last_step}
        if phi.size:
            seen |= {"worst constraint": self.model.constraint_name(int(phi.argmax())), "|phi|": float(phi.max())}
        return StepFailure(status, f"IDA: {reason}", self.t, **seen)
