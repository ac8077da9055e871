"""One run of SUNDIALS' IDA on a model: its steps, one by one, as stretches of accepted states, and what a failure says.

`Run.piece` integrates a smooth piece. IDA calls back for its residual (`_residual`), which `Correction` (ida/newton.py) computes; each `_step` ends
at a time that leaves no very short step before the next one at which a step must end (`_stop`).
"""

import math
import time

import numpy as np

from polyida.clock import loading
from polyida.errors import StepFailure
from polyida.integrate.ida.error_lines import error_lines, raised_by_binding
from polyida.integrate.ida.forms import AcceptedStates, System
from polyida.integrate.ida.newton import Correction
from polyida.integrate.state import State
from polyida.system import INSTANTS

EXACT = 1e-8  # rtol below which a factor in single precision shows: friction that slips brings its errors of lam, 1e-7, into the motion
DRIFT = 1e-2  # of the model's length: a constraint that has drifted further ends the run
LONGEST = 5e-3  # s of computing time for a stretch of states, unless one step takes longer
APPROACH = 3  # steps before a time at which a step must end are chosen so that they end there
STANDSTILL = 20  # steps in a row that hardly change t and so end the run; IDA alone would not end
STATUS = {-2: "accuracy", -3: "error test", -4: "newton", -6: "linear setup", -7: "linear solve"}
STATUS |= {-8: "residual", -9: "residual", -12: "residual", -22: "input"}


class Run:
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
