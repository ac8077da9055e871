"""Radau IIA of order 5 and 3 (Hairer and Wanner 1996) on the stabilised index-2 form, or on index 3."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from polyida.fields import above_zero, check, check_fields, must_be, none_or, not_negative
from polyida.integrate.discontinuities import PARTS, pieces, run_interval, sampling, time_limits
from polyida.integrate.radau.pieces import adaptive_steps, fixed_steps, stored_controller
from polyida.integrate.radau.steps import Steps
from polyida.integrate.sizes import relative_tolerance, rtol_message, sizes_of_run
from polyida.integrate.start import behind_samples, far_side
from polyida.integrate.state import Counts, Integrator, State, States
from polyida.linear.saddle import SCALINGS
from polyida.model import Model
from polyida.validation import LEAST_RTOL, flag, is_number, is_whole, named_keywords, one_of

FORMS = ("ggl", "index3")
LINEAR = ("auto", "kkt")
DEFAULT_RTOL = 1e-5  # for a motion over at most FREE_LENGTHS of its own length; the error is then about ten times that
FREE_LENGTHS = 30.0
FIRST_STEP_SHARE = 0.3  # of length over speed: the first step for rtol = 1
RTOL = f"between {LEAST_RTOL:.2g}, which double precision resolves, and 1, or None: by the run"


@named_keywords
@dataclass(frozen=True)
class RadauIIA(Integrator):
    """Radau IIA: implicit Runge-Kutta method by collocation, stiffly accurate and L-stable, of order 5 (three stages) or 3 (two stages).

    At the nodes t_i = t_0 + c_i h of polynomials q and v of degree s: `q' - v + D^-1 B^T mu = 0`, `M v' + g + B^T lam = 0`, `phi = 0`,
    `B v + phi_t = 0`, with B = phi_q and D = diag M.

    Parameters
    ----------
    rtol : float, optional
        Relative tolerance of q, at least 8.9e-16. By default 1e-5, or less if the motion covers its own length more than 30 times, for an error of about
        1e-4 of that length. The summary of the run names the chosen value.
    atol : float, m, optional
        Absolute tolerance of q. By default rtol times the model's length (integrate/sizes.py).
    h : float, s, optional
        Fixed step. Each piece of a run between kinks takes the largest step not above h that divides it evenly. By default steps follow
        from the local error.
    stages : {3, 2}
        Number of stages s; the order is 2 s - 1.
    form : {"ggl", "index3"}
        "ggl": stabilised form of index 2 (Gear, Gupta, Leimkuhler 1985). "index3": without `B v + phi_t = 0` and mu.
    project : bool
        True: in form "index3", v of accepted states is projected onto its constraint. Without it, v is at most of order 3.
    linear : {"auto", "kkt"}
        "auto": the model's step matrices with a border of its constraints; "kkt": the whole matrix of both for each eigenvalue of A^-1,
        in Python.
    scaling : {"physical", "bottasso", "none"}
        Scaling of the whole matrix of `linear="kkt"` (integrate/radau/matrices.py).
    tolerance : float, optional
        Newton's tolerance, of q. By default min(0.05, rtol^0.6) times (atol + rtol |q|); with fixed steps 0.05 (e/L)^0.6 e, with the local
        error e of the step before and the model's length L.
    max_iterations : int
        Largest number of iterations of one Newton solve.
    max_step : float, s
        Largest step of step control; 0: no limit.
    first_step : float, s
        First step of step control; 0: chosen by the method.
    max_halvings : int
        A fixed step that fails is repeated in 2, 4, ... 2^max_halvings parts.
    max_num_steps : int
        Largest number of steps of a run with step control, rejected ones included. The run fails beyond it.

    Raises
    ------
    InputError
        For a setting out of range.

    Notes
    -----
    The nodes and coefficients are those of Hairer and Wanner, Solving ODEs II (1996), IV.5. a and lam of a state follow from its q and v by
    `[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`: they have the order of q and v. Between two states, the collocation polynomial is of
    order s + 1 in q and v and s in a and lam.

    Step control keeps the local error of q, compared with a method of order s, below atol + rtol |q|. The norm is the root mean square,
    weighted by the mass of each coordinate. The global error of q is commonly 1 to 100 times rtol with three stages, and up to 500 times
    with two.

    Newton's default tolerance with fixed steps is strict, because its error adds up in v over all steps. Flexible scenes accept much more:
    3e-3 h^2 takes 1 to 1.5 iterations a step from 200 steps a second on, and is erratic with longer steps.

    The method damps mesh modes that a step does not resolve. Do not use it for the energy of long runs without damping: the double plate
    loses 0.41 J in 10 s at 5 ms, and generalized-alpha 0.005 J at 1 ms (studies/energy.py).
    """

    rtol: float | None = field(default=None, metadata=must_be(RTOL, none_or(lambda rtol: is_number(rtol) and LEAST_RTOL <= rtol < 1)))
    atol: float | None = field(
        default=None, metadata=must_be("a positive number (of q), or None: rtol times the model's length", none_or(above_zero))
    )
    h: float | None = field(default=None, metadata=must_be("a positive step in s, or None: by the local error", none_or(above_zero)))
    stages: int = field(default=3, metadata=must_be("2 or 3", lambda stages: is_whole(stages, 2, 3)))
    form: str = field(default="ggl", metadata=check(one_of, FORMS))
    project: bool = field(default=True, metadata=check(flag))
    linear: str = field(default="auto", metadata=check(one_of, LINEAR))
    scaling: str = field(default="physical", metadata=check(one_of, SCALINGS))
    tolerance: float | None = field(
        default=None, metadata=must_be("a positive number (of q), or None: by rtol and atol", none_or(above_zero))
    )
    max_iterations: int = field(default=12, metadata=must_be("a positive whole number", is_whole))
    max_step: float = field(default=0.0, metadata=must_be("a step in s, or 0", not_negative))
    first_step: float = field(default=0.0, metadata=must_be("a step in s, or 0", not_negative))
    max_halvings: int = field(default=6, metadata=must_be("a whole number from 0 to 20", lambda count: is_whole(count, 0, 20)))
    max_num_steps: int = field(default=1_000_000, metadata=must_be("a positive whole number", is_whole))
    trusted = True

    @property
    def order(self) -> int:  # type: ignore[override]  # it depends on the stages
        """2 s - 1 of s stages."""
        return 2 * self.stages - 1

    def __post_init__(self):
        """Check the settings. Raises InputError for a setting out of range."""
        check_fields(self, self.class_name())

    @property
    def adaptive(self) -> bool:
        """True if the step follows the local error."""
        return self.h is None

    def relative(self, sizes: np.ndarray) -> float:
        """rtol, or the default for a run of these sizes (length, speed, time, number of lengths covered)."""
        return relative_tolerance(DEFAULT_RTOL, FREE_LENGTHS, float(sizes[3])) if self.rtol is None else self.rtol

    def absolute(self, sizes: np.ndarray) -> float:
        """atol, or the default for a run of these sizes."""
        return self.relative(sizes) * float(sizes[0]) if self.atol is None else self.atol

    def relative_tolerance(self) -> float | None:
        """rtol with step control, None with fixed steps."""
        return self.rtol if self.adaptive else None

    def without_halving(self) -> "RadauIIA":
        """The integrator with max_halvings = 0 if its steps are fixed; itself if they are adaptive."""
        return self if self.adaptive else replace(self, max_halvings=0)

    def settings_used(self, memory: dict) -> dict:
        """{name of a setting: value} of a run, with the rtol and atol that step control used.

        memory: the `memory` of a State of the run.
        """
        used = super().settings_used(memory)
        if self.adaptive and "sizes" in memory:
            used |= {"rtol": float(self.relative(memory["sizes"])), "atol": float(self.absolute(memory["sizes"]))}
        return used

    def summary_of_steps(self, memory: dict) -> str:
        """Words of a summary on the tolerances chosen by default; memory: of a state of the run."""
        if not self.adaptive or "sizes" not in memory:
            return ""
        sizes, rtol = memory["sizes"], self.relative(memory["sizes"])
        words = [] if self.rtol else [rtol_message(rtol, sizes[3])]
        return ", ".join(words + ([f"atol {rtol * sizes[0]:.1e} of q"] if self.atol is None else []))

    def steps(self, model: Model, state: State, t_end: float, counts: Counts) -> Iterator[State]:
        """Accepted States after `state` up to t_end, one a step. Raises StepFailure.

        A step ends at each kink of the model; the next one starts from the state that is consistent behind it.
        """
        return States(self._stretches(model, state, t_end, counts), counts)

    def _stretches(self, model, state, t_end, counts):
        """Stretches of accepted states, one piece between kinks after the other. Raises StepFailure."""
        sizes, run = sizes_of_run(model, state, t_end), run_interval(state, t_end)
        engine = Steps(self, model, counts, sizes, run)
        most_steps = counts.steps + counts.rejected + self.max_num_steps
        controller = stored_controller(state, self._first(sizes, t_end - state.t))
        longest = self.h or self.max_step or np.inf
        state = state if np.shape(state.memory.get("stages_e", ())) == (self.stages, model.n) else restarted(state)
        engine.begin(state)
        h, fine = (self.h, PARTS) if self.h else sampling(longest, np.ptp(run))
        for begin, end, most in pieces(model, run[0], t_end, h, fine, now=state.t):
            engine.limits = time_limits(model, begin, end)
            if engine.limits[0] > begin:
                state = restarted(far_side(model, state, engine.limits[0]))
            elif (behind := behind_samples(model, state)) is not state:
                state = restarted(behind)
            if self.h:
                piece = fixed_steps(engine, self, model, state, begin, end, min(self.h, most), counts)
            else:
                piece = adaptive_steps(engine, self, model, state, begin, end, min(longest, most), counts, controller, most_steps)
            for stretch in piece:
                yield stretch
                state = stretch.last

    def _first(self, sizes, span):
        """The first step, s: `first_step`, or by the tolerance and the model's length and speed, at most span."""
        length, speed = sizes[:2]
        return self.first_step or min(span, FIRST_STEP_SHARE * length / speed * self.relative(sizes) ** (1 / (self.stages + 1)))


def restarted(state):
    """The state without the polynomial of the last step, which is invalid behind a kink or with another number of stages."""
    of_step = "stages_e", "stages_v", "a_end", "stages_lam", "step", "error", "phi", "rate", "radau_piece"
    gone = *of_step, "misses", "miss_e", "miss_lam", "mu"  # the polynomial, and its prediction errors
    memory = {name: value for name, value in state.memory.items() if name not in gone}
    return State(state.t, state.q, state.v, state.a, state.lam, memory)
