"""`error_of`: the error of a quantity of a run and where it comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from polyida.adjoint.alpha_errors import AlphaErrors
from polyida.adjoint.gradient import adjoint_of
from polyida.environment import one_blas_thread
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.state import Counts
from polyida.io.layout import MEMORY_LIMIT
from polyida.objective.objective import Objective, require_objective
from polyida.progress import over_time, require_progress
from polyida.trajectory import Trajectory
from polyida.validation import is_number, named_keywords, require_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PARTS = ("time", "newton", "mesh")


@named_keywords
@dataclass(frozen=True, eq=False)
class ErrorBars:
    """Estimated errors of a quantity J of a run: what must be added to J, signed, by cause.

    Parameters
    ----------
    value : float
        J of the run.
    time : float or None
        Error of the time steps. None where there is no estimate.
    newton : float or None
        What Newton's tolerance left.
    mesh : float or None
        Error of the meshes of full plates, within about a factor of two.
    reasons : dict of str to tuple of str
        {part: why its estimate is missing or not trusted}.
    fast_share : float
        Share of `time` that comes from vibrations whose phase is lost with steps of this size; above 0.45 it is not trusted.
    t : (steps,) float, s
        Ends of the steps.
    steps : (steps,) float
        Share of each step in `time`.
    cells : dict of str to (cells,) float
        {plate: share of each cell in `mesh`}.
    h : float or None, s
        The constant step.
    counts : Counts
        Work of the backward sweep.
    """

    value: float
    time: float | None = None
    newton: float | None = None
    mesh: float | None = None
    reasons: dict[str, tuple[str, ...]] = field(default_factory=dict)
    fast_share: float = 0.0
    t: NDArray = field(default_factory=lambda: np.zeros(0))
    steps: NDArray = field(default_factory=lambda: np.zeros(0))
    cells: dict[str, NDArray] = field(default_factory=dict)
    h: float | None = None
    counts: Counts = field(default_factory=Counts)

    @property
    def trusted(self) -> bool:
        """True if there is an estimate of the error of time and no reason against it."""
        return self.time is not None and not self.reasons.get("time")

    @property
    def corrected(self) -> float:
        """The value with all errors that are trusted added."""
        parts = {part: getattr(self, part) for part in PARTS}
        return self.value + sum(error for part, error in parts.items() if error is not None and not self.reasons.get(part))

    def h_for(self, aim: float) -> float:
        """Return the step with which the error of time is `aim`, `h (aim / |time|)^(1/2)`.

        Parameters
        ----------
        aim : float
            Wanted size of the error, in the unit of J.

        Returns
        -------
        float, s
            The step.

        Raises
        ------
        InputError
            If aim is not positive, and if the run has no constant step or no estimate.
        """
        if not (is_number(aim) and aim > 0):
            raise InputError(f"h_for: aim = {aim!r} must be a positive number in the unit of J")
        if self.h is None or not self.time:
            raise InputError("h_for: the run has no constant step or no error of time; estimate the error of a run with fixed steps")
        return self.h * float(np.sqrt(aim / abs(self.time)))

    def plot_steps(self, axes: Axes | None = None) -> Axes:
        """Draw the error of time summed up to each step, and the shares of the steps.

        Parameters
        ----------
        axes : Axes, optional
            New pyplot axes if None.

        Returns
        -------
        axes : Axes
        """
        from polyida.show.style import line_style, on_axes

        with on_axes(axes) as axis:
            axis.plot(self.t, np.cumsum(self.steps), label="up to t", **line_style(0))
            axis.plot(self.t, self.steps, label="of a step", **line_style(1))
            axis.set(xlabel="t, s", ylabel="error of time", title=f"J = {self.value:.6g}, error of time {_number(self.time)}")
            axis.legend(loc="best")
            return axis

    def __repr__(self):
        lines = [f"ErrorBars: J = {self.value:.9g}, corrected {self.corrected:.9g}"]
        for part in PARTS:
            why = "; ".join(self.reasons.get(part, ()))
            error = getattr(self, part)
            if error is not None or why:
                lines.append(
                    f"  {part:7s}{_number(error):>11s}" + (f"  {'not trusted' if error is not None else 'none'}: {why}" if why else "")
                )
        return "\n".join(lines)


def _number(error):
    return "-" if error is None else f"{error:+.3e}"


@named_keywords
def error_of(
    run: Trajectory, objective: Objective, memory_limit: float = MEMORY_LIMIT, progress: Callable[[float], object] | bool | None = None
) -> ErrorBars:
    """Estimate the error of a quantity of a run of GeneralizedAlpha and its parts, without a reference.

    Parameters
    ----------
    run : Trajectory
        With fixed or adaptive steps.
    objective : Objective
        The quantity J, one of `pi.objective`.
    memory_limit : float, bytes
        As of `pi.gradient`.
    progress : function or bool, optional
        As of `pi.gradient`.

    Returns
    -------
    bars : ErrorBars
        `print(bars)` says which estimate is not trusted, and why.

    Raises
    ------
    InputError
        For another type of run, objective or integrator; for runs with located events, whose times have errors of their own; and for runs
        of which `pi.gradient` has no adjoint.

    Notes
    -----
    The error of time is that of the equations of the meshes. Its estimate has the ratio 1 to the error if the steps resolve the motion that J
    depends on; lost phases of vibrations are recognised by `fast_share`. Vibrations that are damped away within a step are not seen. A
    UserObjective is taken for what its function computes; means over time of `pi.objective` are compared with the integral.

    The cost is about that of `pi.gradient`.

    Examples
    --------
    >>> bars = pi.error_of(run, pi.objective.Deviation("tip", path))
    >>> bars.value, bars.time, bars.trusted
    """
    require_objective("error_of", objective)
    if not isinstance(run, Trajectory):
        raise InputError(f"error_of: {run!r:.80} is no run of solve")
    if progress is not None:
        require_progress("error_of", progress)
    require_bytes("error_of", memory_limit)
    with one_blas_thread():
        if not isinstance(run.integrator, GeneralizedAlpha):
            raise InputError(f"error_of: {type(run.integrator).__name__} has no estimate; run polyida.GeneralizedAlpha(...)")
        adjoint_of("error_of", run)
        if run.events.given or len(run.events):
            raise InputError("error_of: the run has located events, whose times have errors of their own that are not estimated")
        if progress is not True:
            return _estimate(run, objective, memory_limit, progress or (lambda t: None))
        begin, end = float(run.t[0]), float(run.t[-1])
        with over_time(progress, begin, end) as tell:
            return _estimate(run, objective, memory_limit, lambda t: tell(begin + end - t))


def _estimate(run, objective, memory_limit, progress):
    """The ErrorBars of a run of generalized-alpha."""
    sweep = AlphaErrors(run, objective, memory_limit)
    sweep.sweep_backward(progress)
    time, steps = sweep.of_time()
    share, why = sweep.reasons(time)
    cells = {name: mesh.cells for name, mesh in sweep.meshes.items()}
    return ErrorBars(
        value=sweep.objective_slopes.value,
        time=time,
        newton=sweep.newton,
        mesh=float(sum(shares.sum() for shares in cells.values())) if cells else None,
        reasons={"time": why, "mesh": sweep.reasons_of_mesh()},
        cells=cells,
        fast_share=share,
        t=sweep.t,
        steps=steps,
        h=run.integrator.fixed_step() or None,
        counts=sweep.counts,
    )
