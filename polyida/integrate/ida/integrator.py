"""IDA of SUNDIALS: variable-step, variable-order BDF on a stabilised form of the model's equations."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.fields import check, check_fields, not_negative
from polyida.integrate.discontinuities import edges, sampling, stop_times, time_limits
from polyida.integrate.ida.forms import FORMS
from polyida.integrate.ida.run import Run
from polyida.integrate.ida.tables import SCALINGS
from polyida.integrate.sizes import relative_tolerance, rtol_message, sizes_of_run, typical_sizes
from polyida.integrate.start import behind_samples, far_side
from polyida.integrate.state import Counts, Integrator, State, States
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.validation import LEAST_RTOL, floats, is_number, is_one_of, is_whole, named_keywords

LINEAR = ("auto", "kkt", "whole")
# default rtol of a motion over that many lengths of the model; the error is about ten times
AIM, LENGTHS, FLEXIBLE_LENGTHS = 1e-5, 3.0, 30.0
VELOCITY_ATOL = 1e3  # 1/s: absolute tolerance of v over that of q, if atol is one number
LOOSE = 5.0  # times rtol: tolerance of v of flexible bodies

BETWEEN = f"must lie between {LEAST_RTOL:.2g}, which double precision resolves, and 1"


def _must(expected, good):
    """Metadata of a field: unless `good(value)`, the message says what is expected."""
    return check(_require, expected, good)


def _require(label, name, value, expected, good):
    """Return the value as it is; raise InputError, with the text "label: name value expected", unless `good(value)` is true."""
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
        """Check the settings. Raises InputError for one out of range, and if rtol and ida_rtol are both given."""
        check_fields(self, "IDA")
        if self.rtol is not None and self.ida_rtol is not None:
            raise InputError(f"IDA: ida_rtol {self.ida_rtol} stands beside rtol {self.rtol}: give what is asked or what is passed")

    def relative(self, model: Model, sizes: NDArray) -> float:
        """The relative tolerance that a run asks for: rtol if it is given, or that which ida_rtol stands for, or else a default.

        sizes: (length, speed, time, lengths) of the run; the default depends on the last one, the number of lengths that it moves.
        """
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
        """The exponent p: SUNDIALS gets rtol^p, a stricter one with flexible bodies."""
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
        run, cells = Run(self, model, sizes, counts, "polynomials" in state.memory), sampling(math.inf, t_end - state.t)
        for begin, end in pairwise(edges(model, state.t, t_end)):
            limits = time_limits(model, begin, end)
            state = far_side(model, state, limits[0]) if limits[0] > begin else behind_samples(model, state)
            for stretch in run.piece(state, begin, stop_times(model, state, begin, end, *cells), limits):
                yield stretch
            state = stretch.last
