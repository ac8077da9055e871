"""`error_of`: the error of a quantity of a run and where it comes from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from polyida.adjoint.alpha_errors import FAST, AlphaErrors
from polyida.adjoint.gradient import adjoint_of
from polyida.adjoint.other_runs import solved_again, time_again
from polyida.adjoint.parameter import parts_with, with_part
from polyida.adjoint.run import given_velocity, together
from polyida.assembly.scene_model import SceneModel
from polyida.body.reduced import Reduced, missing_fields
from polyida.environment import one_blas_thread
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.state import Counts, State
from polyida.io.layout import MEMORY_LIMIT
from polyida.mesh import PolygonMesh
from polyida.mesh.refinement import remeshed
from polyida.model.guarded import guard
from polyida.objective.objective import Objective, require_objective
from polyida.progress import backward, require_progress
from polyida.trajectory import Trajectory
from polyida.validation import is_flag, is_number, is_one_of, named_keywords, require_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PARTS = ("time", "newton", "mesh", "modes")
REMAINDER = 0.5  # of the error of a mesh: an estimate that second-order terms may change by more is not within a factor of two
FIELDS = 3  # that a reduced plate is enriched by
SAME = 0.5, 2.0  # ratio of two estimates that agree


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
    modes : float or None
        Error of the modes of reduced plates, from a run with three more fields each; with `again=True`.
    again : float or None
        Error of the time steps from two other runs; with `again=True`. It is trusted if both agree.
    mesh_again : float or None
        Error of the meshes from a run with half the cells; with `again=True`. It misleads where errors of one mesh cancel.
    reasons : dict of str to tuple of str
        {part: why its estimate is missing or not trusted}; "again" and "mesh_again" too.
    fast_share : float
        Largest relative change of `time` by another phase of the vibrations whose phase is lost with steps of this size; above 0.45 it is
        not trusted.
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
    modes: float | None = None
    again: float | None = None
    mesh_again: float | None = None
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
            raise InputError("h_for: no constant step or no error of time; it takes estimates of runs of GeneralizedAlpha with fixed steps")
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
        from polyida.show.styles import line_style, on_axes

        with on_axes(axes) as axis:
            axis.plot(self.t, np.cumsum(self.steps), label="up to t", **line_style(0))
            axis.plot(self.t, self.steps, label="of a step", **line_style(1))
            axis.set(xlabel="t, s", ylabel="error of time", title=f"J = {self.value:.6g}, error of time {_number(self.time)}")
            axis.legend(loc="best")
            return axis

    def __repr__(self):
        """A line for each part of the error, with the reasons why it is not trusted."""
        lines = [f"ErrorBars: J = {self.value:.9g}, corrected {self.corrected:.9g}"]
        for part in PARTS:
            why = "; ".join(self.reasons.get(part, ()))
            error = getattr(self, part)
            if error is not None or why:
                lines.append(
                    f"  {part:7s}{_number(error):>11s}" + (f"  {'not trusted' if error is not None else 'none'}: {why}" if why else "")
                )
        for part, name, error in (("time", "again", self.again), ("mesh", "mesh_again", self.mesh_again)):
            if error is not None:
                why = "; ".join(self.reasons.get(name, ()))
                lines.append(f"  {part:7s}{_number(error):>11s}  from other runs" + (f", not trusted: {why}" if why else ""))
        if self.mesh_again is None:
            lines += [f"  mesh             -  no run with half the cells: {why}" for why in self.reasons.get("mesh_again", ())]
        return "\n".join(lines)

    def plot_cells(self, name: str, mesh: PolygonMesh, axes: Axes | None = None) -> Axes:
        """Draw the shares of the cells of a plate in the error of the mesh on its polygons.

        Parameters
        ----------
        name : str
            Of the plate.
        mesh : PolygonMesh
            Its mesh.
        axes : Axes, optional
            New pyplot axes if None.

        Returns
        -------
        axes : Axes

        Raises
        ------
        InputError
            If the plate has no estimate, or if the mesh is another one.
        """
        from polyida.show.plates import draw_mesh
        from polyida.show.styles import literal, on_axes

        if not is_one_of(name, self.cells):
            raise InputError(f"plot_cells: no shares of {name!r}; known: {', '.join(map(repr, self.cells)) or 'none'}")
        shares = self.cells[name]
        if not isinstance(mesh, PolygonMesh) or mesh.n_cells != len(shares):
            raise InputError(f"plot_cells: mesh must be the mesh of {name!r}, of {len(shares)} cells")
        with on_axes(axes) as axis:
            draw_mesh(axis, mesh, shares, "share of a cell" if axes is None else "", symmetric=True)
            axis.set_title(f"error of the mesh of {literal(name)}")
            return axis


def _number(error):
    """An error as text with sign and four digits, such as "+1.235e-03"; "-" for None."""
    return "-" if error is None else f"{error:+.3e}"


@named_keywords
def error_of(
    run: Trajectory,
    objective: Objective,
    again: bool = False,
    memory_limit: float = MEMORY_LIMIT,
    progress: Callable[[float], object] | bool | None = None,
) -> ErrorBars:
    """Estimate the error of a quantity of a run and its parts, without a reference: by the adjoint of GeneralizedAlpha or by further runs.

    Parameters
    ----------
    run : Trajectory
        Of GeneralizedAlpha; with `again=True` of any integrator, an own one too: with constant steps it needs the attribute `order`.
    objective : Objective
        The quantity J, one of `pi.objective`.
    again : bool
        True: solve the run again with h / 2 and 2 h, h / 4 for orders above 2, or 1/10 and 1/100 of the tolerances, with three more fields
        in each reduced plate (`pi.missing_fields`), and with half the cells of full plates that begin at rest in the
        reference configuration.
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
        For another type of run, objective or integrator; for runs with located events, whose times have errors of their own; for runs of
        which `pi.gradient` has no adjoint; and if a further run fails.

    Notes
    -----
    The error of time is that of the equations of the meshes. Its estimate has the ratio 1 to the error if the steps resolve the motion that
    J depends on; lost phases of vibrations are recognised by `fast_share`. Vibrations that are damped away within a step are not seen. A
    UserObjective is taken for what its function computes; means over time of `pi.objective` are compared with the integral.

    The cost is that of `pi.gradient` and of one residual of each step; `studies/error_bars.py` measures it. It is twice that of a run in
    which contacts open: the estimate is trusted if both slopes that their forces have there lead to about the same.

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
    if not is_flag(again):
        raise InputError(f"error_of: again = {again!r} must be True or False")
    with one_blas_thread():
        model = run.known_model("error_of")
        if run.events.given or len(run.events):
            raise InputError("error_of: the run has events or impacts, whose times have errors of their own that are not estimated")
        if isinstance(run.integrator, GeneralizedAlpha):
            adjoint_of("error_of", run)
            with backward(progress, run) as tell:
                bars = _estimate(run, objective, memory_limit, tell)
        else:
            bars = _without_estimate(run, objective, again)
        return _with_other_runs(run, model, objective, bars) if again else bars


def _without_estimate(run, objective, again):
    """ErrorBars with J of a run alone, of an integrator that has no adjoint; their reasons say why `newton` and `mesh` are missing.

    again: True if the run is solved again later, which gives the error of time. Raises InputError if it is False, and for a run without
    steps or that failed.
    """
    name = type(run.integrator).__name__
    if not again:
        raise InputError(f"error_of: {name} has no estimate by an adjoint; give again=True, which solves the run again")
    if len(run) < 2 or not run.success:
        raise InputError("error_of: the run has no step, or failed")
    return ErrorBars(objective(run), reasons={part: (f"{name} has no estimate",) for part in ("newton", "mesh")})


def _with_other_runs(run, model, objective, bars):
    """The ErrorBars with what other runs say: with other steps, more deformation fields and fewer cells. Raises InputError if one fails."""
    second, changes = time_again(run, objective, bars.value), {}
    bars = replace(bars, again=second.error, time=second.error if bars.time is None else bars.time, reasons=_verdicts(bars, second))
    if any(isinstance(model.parts[placed.name], Reduced) for placed in model.reduced_bodies):
        changes["modes"] = _modes_again(run, objective) - bars.value
    if model.is_scene and model.bodies:
        changes |= _mesh_again(run, objective, bars)
    return replace(bars, **changes)


def _verdicts(bars, second):
    """Reasons of bars and of an Again: it is the estimate of time where there is no other, and contradicts an estimate if it is trusted
    itself.
    """
    of_time = bars.reasons.get("time", ())
    if bars.time is None:
        of_time = second.reasons
    elif not second.reasons and not SAME[0] <= second.error / (bars.time or np.nan) <= SAME[1]:
        of_time += (f"runs with other steps, which agree with each other, say {_number(second.error)}",)
    return bars.reasons | {"time": of_time, "again": second.reasons}


def _modes_again(run, objective):
    """J of the run solved again with FIELDS more deformation fields in each reduced plate that is not viscoelastic. Raises InputError."""
    old = guard(run.model)
    names = [placed.name for placed in old.reduced_bodies if isinstance(old.parts[placed.name], Reduced) and placed.name not in old.strains]
    model = old
    for name in names:
        body = old.parts[name]
        own, missing = body.fields, missing_fields(run, name, FIELDS)
        model = with_part(model, name, replace(body, fields=missing if own is None else np.concatenate([own, missing])))
    sizes = {placed.name: placed.pairs for placed in model.all_bodies}
    moved = []
    for placed in old.all_bodies:
        first = sizes[placed.name].start
        moved += [(k, first + k - placed.pairs.start) for k in range(placed.pairs.start, placed.pairs.stop)]
    if len(moved) != old.n // 2:
        raise InputError("error_of: again=True cannot enrich reduced plates of a scene with first-order states")
    before, after = np.array(moved).T
    return solved_again(run, model, run.integrator, objective.named(old), (before, after))


def _mesh_again(run, objective, bars):
    """Changes of ErrorBars: the error of the meshes from a run with half the cells, or the reason why there is none."""
    old = guard(run.model)
    parts, start = dict(old.parts), State(float(run.t[0]), *(np.asarray(x[0], float) for x in (run.q, run.v, run.a, run.lam)))
    try:
        if start.q.any() or not given_velocity(old, start)[1]:
            raise InputError("the run does not begin as drawn")
        if any(np.ptp(factor) or factor[0] != 1.0 for body in old.bodies for factor in body.factors):
            raise InputError("cells have factors")
        for body in old.bodies:
            coarse = replace(parts[body.name], mesh=remeshed(body.mesh, max(1, body.mesh.n_cells // 2)))
            parts = parts_with(parts, body.name, coarse, lambda side, new: new.section(side.name))
        model = SceneModel(parts, old.gravity, old.treats_redundant)
        return {"mesh_again": bars.value - solved_again(run, model, run.integrator, objective.named(old), False)}
    except InputError as error:
        return {"reasons": bars.reasons | {"mesh_again": (str(error),)}}


def _estimate(run, objective, memory_limit, progress):
    """The ErrorBars of a run of generalized-alpha."""
    sweep = AlphaErrors(run, objective, memory_limit)
    together([sweep], progress)
    time, steps = sweep.of_time()
    share, why = sweep.reasons(time, steps)
    if sweep.far:
        near = AlphaErrors(run, objective, memory_limit, near_side=True)
        together([near], lambda t: None)
        if abs(near.of_time()[0] - time) > FAST * abs(time):
            why += (f"contacts open, where forces have two slopes: with those of the near side it is {_number(near.of_time()[0])}",)
    mesh, cells, left_out = _mesh_estimate(sweep)
    return ErrorBars(
        value=sweep.objective_slopes.value,
        time=time,
        newton=sweep.newton,
        mesh=mesh,
        reasons={"time": why, "mesh": left_out},
        cells=cells,
        fast_share=share,
        t=sweep.t,
        steps=steps,
        h=run.integrator.fixed_step() or None,
        counts=sweep.counts,
    )


def _mesh_estimate(sweep):
    """(error of the meshes or None, {plate: shares of its cells}, reasons why it is missing or not trusted) of AlphaErrors."""
    left_out = sweep.reasons_of_mesh()
    if not sweep.meshes:
        return None, {}, left_out
    of_integration, of_gaps = np.sum([mesh.parts.sum(axis=1) for mesh in sweep.meshes.values()], axis=0)
    works, gaps = np.sum([np.abs(mesh.three).sum(axis=1) for mesh in sweep.meshes.values()], axis=0)
    error, largest = of_integration + of_gaps, max(abs(of_integration), abs(of_gaps))
    if gaps * largest > REMAINDER * works * abs(error):
        left_out = (
            f"the errors of shape functions and of their integration cancel, {100 * abs(error) / largest:.0f} % are left, and "
            f"strains vary so much within cells that either is known to {100 * gaps / works:.0f} %",
        )
    return float(error), {name: mesh.parts.sum(axis=0) for name, mesh in sweep.meshes.items()}, left_out
