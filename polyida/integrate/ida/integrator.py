"""IDA of SUNDIALS: variable-step, variable-order BDF on a stabilised form of the model's equations."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from polyida.clock import loading
from polyida.errors import InputError, StepFailure
from polyida.fields import check, check_fields, not_negative
from polyida.integrate.discontinuities import edges, sampling, stop_times, time_limits
from polyida.integrate.ida.error_lines import error_lines, raised_by_binding
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

BETWEEN = f"must lie between {LEAST_RTOL:.2g}, which double precision resolves, and 1"


def _must(expected, good):
    """Metadata of a field: unless `good(value)`, the message says what is expected."""
    return check(_require, expected, good)


def _require(label, name, value, expected, good):
    """Return the value. Raise InputError, "label: name value expected", unless `good(value)`."""
    if not good(value):
        raise InputError(f"{label}: {name} {value} {expected}")
    return value


def _known_form(label, name, value):
    """Return the name of a form. Raise InputError, with all of them, for anything else."""
    if not is_one_of(value, FORMS):
        raise InputError(f"{label}: {name} {value!r} is unknown; there are {', '.join(FORMS)}")
    return value


def _positive_entries(label, name, value):
    """Return None, a positive number, or positive numbers as a tuple of floats. Raise InputError for anything else."""
    if value is None:
        return None
    if not is_number(value):
        entries = floats(value)
        _require(label, name, value, "must be a number, a pair or a list of numbers", lambda _: entries is not None and entries.ndim == 1)
        value = tuple(entries.tolist())
    entries = value if isinstance(value, tuple) else (value,)
    return _require(label, name, value, "must be positive", lambda _: len(entries) >= 1 and all(is_number(x) and x > 0 for x in entries))


def _is_rtol(value):
    """True for None and for a relative tolerance that double precision resolves."""
    return value is None or (is_number(value) and LEAST_RTOL <= value < 1)


OPTIONAL_RTOL = _must(BETWEEN, _is_rtol)
NOT_NEGATIVE = _must("must be a finite number, not negative", not_negative)


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

    rtol: float | None = field(default=None, metadata=OPTIONAL_RTOL)
    atol: float | tuple | None = field(default=None, metadata=check(_positive_entries))
    max_order: int | None = field(default=None, metadata=_must("must be 1, 2, 3, 4 or 5", lambda k: k is None or is_whole(k, 1, 5)))
    form: str = field(default="ggl2", metadata=check(_known_form))
    max_step: float = field(default=0.0, metadata=NOT_NEGATIVE)
    max_num_steps: int = field(default=200_000, metadata=_must("must be a positive whole number", is_whole))
    first_step: float = field(default=0.0, metadata=NOT_NEGATIVE)
    baumgarte_rate: float = field(default=10.0, metadata=NOT_NEGATIVE)
    linear: str = field(default="auto", metadata=_must(f"must be one of {', '.join(LINEAR)}", lambda name: is_one_of(name, LINEAR)))
    scaling: str = field(
        default="characteristic", metadata=_must(f"must be one of {', '.join(SCALINGS)}", lambda name: is_one_of(name, SCALINGS))
    )
    ida_rtol: float | None = field(default=None, metadata=OPTIONAL_RTOL)
    trusted = True

    def __post_init__(self):
        check_fields(self, "IDA")
        if self.rtol is not None and self.ida_rtol is not None:
            raise InputError(f"IDA: ida_rtol {self.ida_rtol} stands beside rtol {self.rtol}: give what is asked or what is passed")

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
        if len(self.atol) != 2 * n:
            raise InputError(f"IDA: atol of {len(self.atol)} entries {expected}")
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
        """Stretches of accepted states, one smooth piece after the other. Raises StepFailure."""
        sizes = sizes_of_run(model, state, t_end)
        run, cells = _Run(self, model, sizes, counts, "polynomials" in state.memory), sampling(math.inf, t_end - state.t)
        for begin, end in pairwise(edges(model, state.t, t_end)):
            limits = time_limits(model, begin, end)
            state = far_side(model, state, limits[0]) if limits[0] > begin else behind_samples(model, state)
            for stretch in run.piece(state, begin, stop_times(model, state, begin, end, *cells), limits):
                yield stretch
            state = stretch.last


class _Run:
    """One run of IDA: the solver of the binding with its callbacks, and the counts."""

    def __init__(self, settings, model, sizes, counts, looked_into):
        """Make the solver. sizes: of the run (integrate/sizes.py); looked_into: True if states within steps are asked for."""
        with loading:
            from sksundae.ida import IDA as Solver
            from sksundae.ida import IDAJacTimes

        self.settings, self.model, self.counts, self.looked_into = settings, model, counts, looked_into
        rtol, *atol = settings.tolerances(model, sizes)
        order = settings.largest_order(model)
        self.sizes = sizes
        self.memory = {"sizes": sizes, "rtol": settings.relative(model, sizes), "max_order": order}  # of all states of the run
        if not settings.atol:
            self.memory["tolerances"] = np.array([rtol, *atol])
        self.system = System(model, settings.form, settings.baumgarte_rate)
        self.system.exact = model.slipping and np.min(rtol) < EXACT
        self.linear = Correction(self.system, counts, order, settings.linear, settings.scaling)
        self.steps = 0  # taken
        self.standing = 0  # steps in a row within the round-off of t
        self.attempts = 0  # times that the present step was tried, each at another end
        self.tried = math.nan  # the last of these ends
        self.last_step = math.nan  # s
        self.refused = None  # (t, q) at which F was not finite since the last step
        self.not_finite = ""  # what was not
        self.solver = Solver(
            self._residual,
            rtol=rtol,
            atol=self.system.tolerances(*atol, 0.0 if settings.atol else sizes[1]),
            max_order=order,
            max_step=float(settings.max_step),
            first_step=float(settings.first_step),
            linsolver="gmres",
            krylov_dim=5,
            jactimes=IDAJacTimes(None, self.linear.product),
        )

    def _residual(self, t, y, yp, res):
        """Write J^-1 F at (t, y, y') to res, IDA's callback; NaN if the model refuses the state."""
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
        self.last_step = math.inf
        self.stop = begin  # the time that IDA does not pass
        self.t, self.q = begin, state.q
        most = 1 if self.model.switching or self.looked_into else INSTANTS  # states of a stretch
        for end in times:
            while self.t < end:
                states, until = [], time.perf_counter() + LONGEST
                try:
                    with error_lines as printed:
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
        """The AcceptedStates of a list of (counts, t, y, y')."""
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
        """Take a step towards `end` and append (counts, t, y, y'); one within the round-off of t gives no state. Raises StepFailure."""
        if self.steps >= self.settings.max_num_steps:
            raise self._failure("too many steps", f"more than {self.steps} steps (max_num_steps)")
        if self.standing >= STANDSTILL:
            raise self._failure("step too small", "the step has shrunk to the round-off of t")
        self.attempts, self.tried = 0, math.nan
        t, y, yp = self._taken(end, printed)
        self.linear.accept(t, y)
        q = y[: self.model.n]
        self.last_step = t - self.t
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

    def _taken(self, end, printed):
        """(t, y, y') at the end of IDA's next step; printed: the line that IDA printed, as `message`. Raises StepFailure."""
        stop = self._stop(end)
        try:
            result = self.solver.step(end, method="onestep", tstop=stop)
        except KeyError as error:
            if not raised_by_binding(error):
                raise
            flag = f"IDA returned the flag {error.args[0]}, of which the binding knows no text"
            raise self._failure("ida", printed.message.rstrip(".") or flag) from None
        if result.status < 0:
            reason = (printed.message or result.message).rstrip(".")
            raise self._failure(STATUS.get(result.status, "ida"), reason)
        return float(result.t), result.y, result.yp

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
