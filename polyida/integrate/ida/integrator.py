"""IDA of SUNDIALS: variable-step, variable-order BDF on a stabilised form of the model's equations."""

import math
import re
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from traceback import extract_tb

import numpy as np
from numpy.typing import NDArray

from polyida.clock import loading
from polyida.errors import InputError, StepFailure
from polyida.integrate.discontinuities import edges, sampling, stop_times, time_limits
from polyida.integrate.ida.forms import FORMS, AcceptedStates, System
from polyida.integrate.ida.newton import Correction
from polyida.integrate.ida.tables import SCALINGS
from polyida.integrate.sizes import relative_tolerance, rtol_message, sizes_of_run, typical_sizes
from polyida.integrate.start import behind_samples, far_side
from polyida.integrate.state import Counts, Integrator, State, States
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.system import INSTANTS
from polyida.validation import LEAST_RTOL, floats, is_number, is_one_of, is_whole, named_keywords

LINEAR = ("auto", "kkt", "whole")
# default rtol of a motion over that many lengths of the model; the error is about ten times
AIM, LENGTHS, FLEXIBLE_LENGTHS = 1e-5, 3.0, 30.0
VELOCITY_ATOL = 1e3  # 1/s: absolute tolerance of v over that of q, if atol is one number
EXACT = 1e-8  # rtol below which a factor in single precision shows: friction that slips brings its errors of lam, 1e-7, into the motion
LOOSE = 5.0  # times rtol: tolerance of v of flexible bodies
DRIFT = 1e-2  # of the model's length: a constraint that has drifted further ends the run
LONGEST = 5e-3  # s of computing time for a stretch of states, unless one step takes longer
APPROACH = 3  # steps before a time at which a step must end are chosen so that they end there
STANDSTILL = 20  # steps in a row that hardly change t and so end the run; IDA alone would not end
STATUS = {-2: "accuracy", -3: "error test", -4: "newton", -6: "linear setup", -7: "linear solve"}
STATUS |= {-8: "residual", -9: "residual", -12: "residual", -22: "input"}
ERROR_LINE = re.compile(r"\[IDA\w*, Error: -?\d+\] (.*)", re.DOTALL)


@named_keywords
@dataclass(frozen=True)
class IDA(Integrator):
    """Backward differentiation formulas of order 1 to 5 with error control, by SUNDIALS' IDA.

    Parameters
    ----------
    rtol : float, optional
        What is asked: the accuracy of the motion, relative, at least 8.9e-16. By default 1e-5, or less if the motion covers more than 3 lengths of
        the model (30 with flexible bodies), for an error of about 1e-4 of that length. SUNDIALS gets the same number, but with flexible bodies and
        without atol `rtol^(1 + 1/max_order)`, see Notes.
    atol : float, (2,) or (2n,) array_like, optional
        Absolute tolerance of q, m, with 1e3 1/s times it for v; of (q, v); or of every entry of (q, v). By default rtol times a length and a
        speed of the model's first state. Multipliers are not in the error estimate.
    max_order : int, optional
        Largest order, 1 to 5. By default 2 with flexible bodies, whose mesh modes lie near the imaginary axis, where BDF of order 3 to 5 is
        unstable, and 5 without.
    form : {"ggl2", "ggl1", "index2", "index1", "baumgarte", "index3"}
        Form of the equations, see Notes. "index3" is slow and fails on many models.
    max_step : float, s
        Largest step; 0 for none.
    max_num_steps : int
        The run fails beyond that number of steps.
    first_step : float, s
        First step; 0 for IDA's choice.
    baumgarte_rate : float, 1/s
        w of form "baumgarte".
    linear : {"auto", "kkt", "whole"}
        "auto": compiled functions for scenes and for models with n + m <= 50; "kkt": those that any model has. Both solve by
        S = K + cj C + cj^2 M and a border. "whole": one matrix of (q, v, multipliers).
    scaling : {"characteristic", "none"}
        Scaling of the whole matrix; the other two do not depend on it.
    ida_rtol : float, optional
        What is passed: the relative tolerance that SUNDIALS gets, in place of rtol. `run.settings_used` has both.

    Raises
    ------
    InputError
        For a setting out of range.

    Notes
    -----
    `q' - v + phi_q^T mu = 0`, `M v' + g + phi_q^T lam = 0` and, for "ggl2" and "ggl1" (with integrated multipliers), phi and phi'; mu is zero in
    the other forms, which have phi', phi'', `phi'' + 2 w phi' + w^2 phi` or phi.

    The error of q over the model's size is commonly 2 to 20 times rtol with flexible bodies (far more on very stiff ones with rtol above 1e-5)
    and 4 to 500 times without. With flexible bodies and default atol the error test of v is 5 times less strict, because v of stiff modes
    jumps with every change of the step, which would keep the order at 1; q is tested with rtol^(1 + 1/max_order) instead.

    Hindmarsh et al., ACM TOMS 31 (2005) 363-396; Gear, Gupta, Leimkuhler, J. Comput. Appl. Math. 12-13 (1985) 77-90.
    """

    rtol: float | None = None
    atol: float | tuple | None = None
    max_order: int | None = None
    form: str = "ggl2"
    max_step: float = 0.0
    max_num_steps: int = 200_000
    first_step: float = 0.0
    baumgarte_rate: float = 10.0
    linear: str = "auto"
    scaling: str = "characteristic"
    ida_rtol: float | None = None
    trusted = True

    def __post_init__(self):
        if not is_one_of(self.form, FORMS):
            raise InputError(f"IDA: form {self.form!r} is unknown; there are {', '.join(FORMS)}")
        if self.atol is not None and not is_number(self.atol):
            entries = floats(self.atol)
            _check("atol", self.atol, entries is not None and entries.ndim == 1, "must be a number, a pair or a list of numbers")
            object.__setattr__(self, "atol", tuple(entries.tolist()))
        entries = self.atol if isinstance(self.atol, tuple) else (1.0 if self.atol is None else self.atol,)
        not_negative = "must be a finite number, not negative"
        rtol_ok, ida_rtol_ok = (x is None or (is_number(x) and LEAST_RTOL <= x < 1) for x in (self.rtol, self.ida_rtol))
        between = f"must lie between {LEAST_RTOL:.2g}, which double precision resolves, and 1"
        for name, good, expected in (
            ("linear", is_one_of(self.linear, LINEAR), f"must be one of {', '.join(LINEAR)}"),
            ("scaling", is_one_of(self.scaling, SCALINGS), f"must be one of {', '.join(SCALINGS)}"),
            ("rtol", rtol_ok, between),
            ("ida_rtol", ida_rtol_ok, between),
            (
                "ida_rtol",
                self.rtol is None or self.ida_rtol is None,
                f"stands beside rtol {self.rtol}: give what is asked or what is passed",
            ),
            ("max_order", self.max_order is None or is_whole(self.max_order, 1, 5), "must be 1, 2, 3, 4 or 5"),
            ("max_num_steps", is_whole(self.max_num_steps), "must be a positive whole number"),
            ("max_step", is_number(self.max_step) and self.max_step >= 0, not_negative),
            ("first_step", is_number(self.first_step) and self.first_step >= 0, not_negative),
            ("baumgarte_rate", is_number(self.baumgarte_rate) and self.baumgarte_rate >= 0, not_negative),
            ("atol", len(entries) >= 1 and all(is_number(x) and x > 0 for x in entries), "must be positive"),
        ):
            _check(name, getattr(self, name), good, expected)

    def relative(self, model: Model, sizes: NDArray) -> float:
        """What is asked, rtol, or its default in a run of these sizes, (length, speed, time, lengths), or that which ida_rtol stands for."""
        if self.ida_rtol is not None:
            return self.ida_rtol ** (1 / self._strictness(model))
        most = FLEXIBLE_LENGTHS if model.flexible else LENGTHS
        return relative_tolerance(AIM, most, float(sizes[3])) if self.rtol is None else float(self.rtol)

    def tolerances(self, model: Model, sizes: NDArray) -> tuple[float, float | NDArray, float | NDArray]:
        """(relative tolerance, absolute ones of q and of v) in a run of these sizes. Raises InputError if atol does not fit the model."""
        rtol, n = self.relative(model, sizes), model.n
        if self.atol is None and model.flexible:
            strict = max(rtol ** self._strictness(model), LEAST_RTOL) if self.ida_rtol is None else self.ida_rtol
            return strict, strict * float(sizes[0]), LOOSE * rtol * float(sizes[1])
        if self.atol is None:
            return rtol, rtol * float(sizes[0]), rtol * float(sizes[1])
        if not isinstance(self.atol, tuple):
            return rtol, self.atol, VELOCITY_ATOL * self.atol
        if len(self.atol) == 2:
            return rtol, *self.atol
        expected = f"must be a number, a pair (of q, of v) or {2 * n} entries for the model's n = {n}"
        _check("atol", f"of {len(self.atol)} entries", len(self.atol) == 2 * n, expected)
        return rtol, np.array(self.atol[:n]), np.array(self.atol[n:])

    def _strictness(self, model):
        """The power of rtol that SUNDIALS gets."""
        return 1 + 1 / self.largest_order(model) if self.atol is None and model.flexible else 1.0

    def relative_tolerance(self) -> float | None:
        """What is asked, or what is passed if that is given; None if neither is."""
        return self.ida_rtol if self.rtol is None else self.rtol

    def settings_used(self, memory: dict) -> dict:
        """{setting: value} of a run: rtol asked, ida_rtol and atol (of q, of v, or of each entry) as SUNDIALS got them, and the largest order."""
        used = super().settings_used(memory)
        if "rtol" not in memory:
            return used
        asked = float(memory["rtol"])
        passed = memory["tolerances"].tolist() if "tolerances" in memory else [self.ida_rtol or asked]
        used |= {"rtol": asked, "ida_rtol": passed[0], "max_order": int(memory["max_order"]) if "max_order" in memory else self.max_order}
        if len(passed) == 3:
            used["atol"] = passed[1], passed[2]
        elif self.atol is not None and not isinstance(self.atol, tuple):
            used["atol"] = self.atol, VELOCITY_ATOL * self.atol
        return used

    def summary_of_steps(self, memory: dict) -> str:
        """Text of a summary on the tolerances that a run chose; memory of one of its states."""
        chosen = self.rtol is None and self.ida_rtol is None and "rtol" in memory
        words = [rtol_message(float(memory["rtol"]), memory["sizes"][3])] if chosen else []
        if "tolerances" in memory:
            rtol, of_q, of_v = memory["tolerances"]
            strict = f"rtol {rtol:.1e} and " if rtol != float(memory["rtol"]) else ""
            words.append(f"{strict}atol {of_q:.1e} of q, {of_v:.1e} of v")
        return ", ".join(words)

    def require(self, model: Model) -> None:
        """Raise InputError for velocity rows in form "index3"."""
        known = guard(model, "IDA")
        if known.velocity_rows.size and self.form == "index3":
            name = known.constraint_name(int(known.velocity_rows[0]))
            raise InputError(f'IDA: form "index3" has no equation for the velocity row {name}; use form "ggl2", the default')

    def largest_order(self, model: Model) -> int:
        """The largest BDF order used on this model."""
        return self.max_order or (2 if model.flexible else 5)

    def require_reach(self, model: Model, state: State, t_end: float) -> None:
        """Raise InputError if the distance of adjacent floating-point times near t_end does not resolve the model's motion."""
        length, speed = typical_sizes(model, state, t_end - state.t)
        if math.ulp(t_end) > length / speed:
            apart = f"times there are {math.ulp(t_end):.2g} s apart, and the model moves within {length / speed:.2g} s"
            raise InputError(f"IDA: t_end = {t_end:g} s is too far: {apart}")

    def steps(self, model: Model, state: State, t_end: float, counts: Counts) -> Iterator[State]:
        """Accepted States after `state` (consistent), one for each internal step, the last at t_end. Raises StepFailure.

        At a kink of the model a step ends and IDA starts anew from the state consistent with the far side. State.memory: "mu" of the
        stabilised forms, and "sizes", "rtol" and "tolerances", which a run that goes on keeps. With "polynomials" in the memory of the first state
        each has the polynomial of its step until the next one is taken.
        """
        return States(self._stretches(model, state, t_end, counts), counts)

    def _stretches(self, model, state, t_end, counts):
        sizes = sizes_of_run(model, state, t_end)
        run, cells = _Run(self, model, sizes, counts, "polynomials" in state.memory), sampling(math.inf, t_end - state.t)
        for begin, end in pairwise(edges(model, state.t, t_end)):
            limits = time_limits(model, begin, end)
            state = far_side(model, state, limits[0]) if limits[0] > begin else behind_samples(model, state)
            for stretch in run.piece(state, begin, stop_times(model, state, begin, end, *cells), limits):
                yield stretch
            state = stretch.last


def _check(name, value, good, expected):
    if not good:
        raise InputError(f"IDA: {name} {value} {expected}")


class _Run:
    """One run of IDA: the solver of the binding with its callbacks, and the counts.

    looked_into: True if states within steps are asked for. standing: number of steps in a row within the round-off of t. attempts: times that the
    present step was tried, each at another end, the last at `tried`. stop: the time that IDA does not pass.
    """

    def __init__(self, settings, model, sizes, counts, looked_into):
        with loading:
            from sksundae.ida import IDA as Solver
            from sksundae.ida import IDAJacTimes

        self.settings, self.model, self.counts, self.looked_into = settings, model, counts, looked_into
        rtol, *atol = settings.tolerances(model, sizes)
        self.sizes, self.memory = sizes, {"sizes": sizes, "rtol": settings.relative(model, sizes)}
        self.memory |= {"max_order": settings.largest_order(model)} | ({} if settings.atol else {"tolerances": np.array([rtol, *atol])})
        self.system = System(model, settings.form, settings.baumgarte_rate)
        self.system.exact = model.slipping and np.min(rtol) < EXACT
        self.linear = Correction(self.system, counts, settings.largest_order(model), settings.linear, settings.scaling)
        self.steps, self.standing, self.attempts = 0, 0, 0
        self.tried, self.last_step = math.nan, math.nan
        self.refused, self.not_finite = None, ""  # (t, q) at which F was not finite since the last step, and what was not
        self.solver = Solver(
            self._residual,
            rtol=rtol,
            atol=self.system.tolerances(*atol, 0.0 if settings.atol else sizes[1]),
            max_order=settings.largest_order(model),
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
            self.refused, self.not_finite = (t, np.array(y[: self.model.n])), self.model.not_finite

    def piece(self, state, begin, times, limits):
        """Stretches of accepted states on the smooth piece from begin to the last of `times`; a step ends at each of these.

        The model's time is clamped to `limits`. A stretch takes no longer than LONGEST, because progress and Ctrl-C wait for its end.
        """
        self.system.limits = limits
        y, yp = self.system.pack(state)
        self.linear.begin(begin, y)
        self.solver.init_step(begin, y, yp)
        self.last_step, self.stop = math.inf, begin
        self.t, self.q, most = begin, state.q, 1 if self.model.switching or self.looked_into else INSTANTS
        for end in times:
            while self.t < end:
                states, until = [], time.perf_counter() + LONGEST
                try:
                    with _error_lines as printed:
                        while self.t < end and len(states) < most and (not states or time.perf_counter() < until):
                            self._step(end, printed, states)
                except BaseException:
                    if states:
                        work = self._work()
                        yield self._stretch(states)
                        vars(self.counts).update(work)
                    raise
                if states:
                    yield self._stretch(states)

    def _stretch(self, states):
        work, *rows = zip(*states)
        return AcceptedStates(self.system, self.memory, work, *map(np.array, rows), self._within if self.looked_into else None)

    def _within(self, end, t):
        """The State at t in the step to `end`, by the polynomial of IDA; None if a later step has been taken."""
        if end != self.t:
            return None
        result = self.solver.step(t, method="normal")
        q, v, a, lam, _ = (None if x is None else x.copy() for x in self.system.split(result.y, result.yp))
        self.solver.step(self.t, method="normal")  # the next step goes on from there
        return State(t, q, v, a, lam, restart=False)

    def _work(self):
        """The counts except the steps, which are counted when the states are taken."""
        return {name: count for name, count in vars(self.counts).items() if name != "steps"}

    def _step(self, end, printed, states):
        """Take a step. One within the round-off of t gives no state."""
        if self.steps >= self.settings.max_num_steps:
            raise self._failure("too many steps", f"more than {self.steps} steps (max_num_steps)")
        if self.standing >= STANDSTILL:
            raise self._failure("step too small", "the step has shrunk to the round-off of t")
        self.attempts, self.tried = 0, math.nan
        stop = self._stop(end)
        try:
            result = self.solver.step(end, method="onestep", tstop=stop)
        except KeyError as error:
            if not _of_binding(error):
                raise
            flag = f"IDA returned the flag {error.args[0]}, of which the binding knows no text"
            raise self._failure("ida", printed.message.rstrip(".") or flag) from None
        if result.status < 0:
            reason = (printed.message or result.message).rstrip(".")
            raise self._failure(STATUS.get(result.status, "ida"), reason)
        t, y, yp = float(result.t), result.y, result.yp
        self.linear.accept(t, y)
        q, self.last_step = y[: self.model.n], t - self.t
        self.steps += 1
        self.counts.steps += 1
        self.counts.rejected += max(self.attempts - 1, 0)
        self.standing = self.standing + 1 if self.last_step < 16 * math.ulp(t) else 0
        if self.linear.objects and (objection := self.system.rejection_reason(t, q)):
            raise self._failure("objection", objection)
        if drift := self.system.drift(t, q, DRIFT * self.sizes[0]):
            raise self._failure("drift", f"{drift}; a form that holds phi, or a tighter rtol, keeps it closed")
        self.refused = self.refused if self.standing else None
        if t > self.t:
            self.t, self.q = t, q
            states.append((self._work(), t, y, yp))

    def _stop(self, end):
        """The time that the next step must not pass, so that no very short step is left before `end`.

        The errors of v over a very short step would be in v' and the multipliers of that step. IDA at most doubles a step, and it shortens
        the next one already if a stop lies within it: a stop once given stays until it is reached, or the rest would be halved without end.
        """
        if not self.t < self.stop < end:
            rest = end - self.t
            pieces = next((k for k in range(1, APPROACH + 1) if rest <= k * self.last_step), 0)
            self.stop = end - rest * (pieces - 1) / pieces if pieces else end + self.last_step
        return self.stop

    def _failure(self, status, reason):
        """StepFailure at the last accepted state, with the step that was tried and the constraint with the largest violation."""
        if self.refused:
            objection = self.model.rejection_reason(*self.refused)
            status, cause = ("objection", objection) if objection else (status, self.not_finite or "the residual is not finite")
            reason = f"{cause}; {reason}"
        phi = np.abs(self.model.phi(self.t, self.q))
        tried = float(self.tried - self.t)
        seen = {"steps": self.steps, "step": tried if tried > 0 else self.last_step}
        if phi.size:
            seen |= {"worst constraint": self.model.constraint_name(int(phi.argmax())), "|phi|": float(phi.max())}
        return StepFailure(status, f"IDA: {reason}", self.t, **seen)


def _of_binding(error):
    """True if the binding itself raised an error, not a function of a user that it called."""
    return extract_tb(error.__traceback__)[-1].filename.endswith("_cy_ida.pyx")


class _ErrorLines:
    """Replaces sys.stdout while a thread is within it: the error line that the binding prints becomes a message, other text passes through.

    It returns an object whose `message` is the thread's last error line, or empty.
    """

    def __init__(self):
        self.lock, self.users, self.stream, self.printed = threading.Lock(), 0, None, threading.local()

    def __enter__(self):
        with self.lock:
            self.users += 1
            if sys.stdout is not self:
                self.stream, sys.stdout = sys.stdout, self
        self.printed.message, self.printed.line_ends = "", False
        return self.printed

    def __exit__(self, *error):
        with self.lock:
            self.users -= 1
            if not self.users and sys.stdout is self:
                sys.stdout = self.stream

    def write(self, text):
        match = ERROR_LINE.search(text)
        if match:
            self.printed.message, self.printed.line_ends = " ".join(match[1].split()), True
        elif text == "\n" and getattr(self.printed, "line_ends", False):
            self.printed.line_ends = False
        else:
            self.stream.write(text)
        return len(text)

    def __getattr__(self, name):
        return getattr(self.stream, name)


_error_lines = _ErrorLines()
