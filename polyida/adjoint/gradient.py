"""`gradient`: the value of an objective and its slopes in all parameters of the model, of whatever was solved.

Of an equilibrium, and of modes, by one transposed solve:

    [[K^T, B^T], [B, 0]] (w, mu) = (-j_q, -j_lam),   dJ/dp = w . dr/dp + mu . dphi/dp + what J says of p itself

K, B, r and phi are those at the equilibrium; of one for small displacements those of what it solves, `r = g_0 + K_0 q + B_0^T lam`,
`phi = phi_0 + B_0 q`, all at q = 0. What J says of parameters by itself is the modes' at their state; where this is an equilibrium of
`pi.static`, which moves with parameters, its adjoint adds what J says of q and lam. Any other state is held as it is.
"""

import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, overload

import numpy as np

from polyida.adjoint.alpha import AlphaAdjoint
from polyida.adjoint.jumps import TIME_STEPPING, gradients_of_events
from polyida.adjoint.parameter import AdjointMultipliers, Parameter
from polyida.adjoint.radau import RadauAdjoint
from polyida.adjoint.run import Gradient, Totals
from polyida.environment import one_blas_thread
from polyida.errors import InputError, StepFailure
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.loose import FREE
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.state import Counts
from polyida.integrate.static import Equilibrium, Loading
from polyida.io.layout import MEMORY_LIMIT
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT
from polyida.modal.modes import Modes
from polyida.model.guarded import guard
from polyida.model.row_laws import require_no_laws
from polyida.objective.objective import Objective, along_way, slopes_at, terms_of
from polyida.objective.peak_stress import PeakStress, StrainEnergy
from polyida.objective.structure import Frequency
from polyida.progress import backward, require_progress
from polyida.trajectory import Trajectory
from polyida.validation import named_keywords, require_bytes

OF_LAWS = "there is no adjoint of impacts and stick yet"
ELASTIC = (Frequency, PeakStress, StrainEnergy)
ADJOINTS = {GeneralizedAlpha: AlphaAdjoint, RadauIIA: RadauAdjoint}
Names = Sequence[str] | None
Progress = Callable[[float], object] | bool | None
WHY = {"IDA": "has no adjoint here: that of its steps is SUNDIALS' IDAS, which scikit-sundae does not have"}


@overload
def gradient(run: Any, objective: Objective, parameters: Names = ..., memory_limit: float = ..., progress: Progress = ...) -> Gradient:
    """Return the Gradient of one objective."""


@overload
def gradient(
    run: Any, objective: Sequence[Objective], parameters: Names = ..., memory_limit: float = ..., progress: Progress = ...
) -> list[Gradient]:
    """Of several objectives: a list of their Gradients."""


@named_keywords
def gradient(
    run: Any,
    objective: Objective | Sequence[Objective],
    parameters: Sequence[str] | None = None,
    memory_limit: float = MEMORY_LIMIT,
    progress: Callable[[float], object] | bool | None = None,
) -> Gradient | list[Gradient]:
    """Return the value of an objective and its slopes dJ/dp in the parameters of the model.

    The slopes of a run come from the discrete adjoint of GeneralizedAlpha or RadauIIA, those of an equilibrium and of modes from one
    transposed solve.

    Parameters
    ----------
    run : Trajectory, Equilibrium or Modes
        Result of `pi.solve`, `pi.static` or `pi.modes`.
    objective : Objective or list of Objective
        From `pi.objective`. Several share one backward sweep: frames are read once, steps taken again once, factors made once.
    parameters : list of str, optional
        Names. By default all whose slopes cost next to nothing: of plates `stiffness` and `mass` (factors of each cell), `E`, `thickness`,
        `rho`, and `prony` of viscoelastic ones; `mass` of point masses; the numbers of the profiles of motors and loads (`motor.end`,
        `motor.duration`, `load.amplitude`); velocities of bodies and `v0`; of a user's model what its `parameters` names. By name also the
        numbers of bodies, plates, forces and driven joints, such as `spring.stiffness`; not the places of bodies, lengths of joints, and
        laws of contact and friction.
    memory_limit : float, bytes
        Memory for the steps of the run. A longer run keeps checkpoints and is solved a third time between them.
    progress : function or bool, optional
        Called with t, s, during the backward sweep. True: a bar of tqdm.

    Returns
    -------
    gradient : Gradient or list of Gradient
        Value and slopes; `left_out` has the parameters without a slope, with the reason. A list, in the order of the objectives, if
        `objective` is a list.

    Raises
    ------
    InputError
        For another type of run, objective or integrator, for an unknown parameter or one that moves the constraints of a held state, for a
        run that continues from a state of another run, for frames between steps (`output`, `until`, `extrapolate`), and for
        forces that jump where a gap switches; for impacts of time stepping, and events without an adjoint (Notes); for velocity rows in
        form "stabilised", in equilibria and in modes.

    Notes
    -----
    The gradient is exact for the steps of the run up to the error that Newton's tolerance left: below 1e-9 in q and up to 2e-7 in lam and a
    at a tolerance of 1e-10; about 1e-4 and 2e-2 at the default of GeneralizedAlpha (studies/gradient_errors.py); 1e-8 to 1e-6 at the
    default of RadauIIA with fixed steps. With adaptive steps of RadauIIA the error is about rtol, and up to 70 times that for PeakStress
    and PeakReaction, since Newton's method leaves more of stiff modes. A tolerance of rtol^2 of the model's length leaves at most 3 rtol
    for 20 to 50 % more solves, `tolerance=1e-12` at most 1e-6 for 50 to 70 %.

    The cost does not depend on the number of parameters: 0.9 to 1.7 runs of plates by generalized-alpha (studies/gradient_over_run.py),
    more runs of small models, whose steps take microseconds, and of RadauIIA. A run whose frames are not all of its steps is solved again
    from its start.

    Times of kinks that depend on a parameter are differentiated; the steps between two kinks stretch evenly. A run that is solved again
    with adaptive steps chooses other steps: its means over time differ by up to some hundredths in parameters that move a kink.

    A run with located events is solved again, motion by motion from one event to the next, and the slopes jump at the events as the motion
    does (saltation). The value and the slopes are those of these motions, which differ from the run by the error of the method. Included
    are contact, constant friction and sticking rows, and events of the user, whatever they do; a part counts in the motions in which it
    acts. Refused are slip with friction that pressure gives, events at one time that do not cause each other, an event that ends the run,
    and parameters that move kinks. Functions of the user are taken to depend on no parameter but by what the state gives them: its vectors,
    and `position`, `velocity` and `reaction`. Models of the user in `then` share the parameters of equal names and values.

    The following are held constant. (1) A given initial state (`solve(..., state=pi.static(model))`), and the start of a run at which a
    motor begins. (2) The times at which contacts and other gaps switch, which is right if the forces are continuous there. The slopes are
    then as accurate as the steps in the contact: for a bar on a stop of 1e6 N/m^1.5, dJ/dstiffness has an error of 7 % with
    GeneralizedAlpha(h=5e-3), 0.1 % with rtol=1e-6, 8 % with RadauIIA(rtol=1e-6) and 0.1 % with rtol=1e-8.

    The model is used as it is now: if it was changed after its run, the gradient is another one. A run that failed gives a warning; J is
    then that of its frames.

    Examples
    --------
    >>> result = pi.gradient(run, pi.objective.Deviation("tip", path))
    >>> result.value, result["arm.stiffness"]
    """
    several = isinstance(objective, (list, tuple))
    objectives: list = list(objective) if several else [objective]  # type: ignore[arg-type]
    _require_objectives(objectives)
    names = _names(parameters)
    _require_elastic(run, objectives)
    if progress is not None:
        require_progress("gradient", progress)
    require_bytes("gradient", memory_limit)
    with one_blas_thread():
        if isinstance(run, (Equilibrium, Modes)):
            gradients = gradients_of_state(run, objectives, names)
        elif isinstance(run, Trajectory):
            gradients = _gradients_of_run(run, objectives, names, memory_limit, progress)
        else:
            raise InputError(f"gradient: {run!r:.80} is no run, no equilibrium of static, and no modes")
    return gradients if several else gradients[0]


def _require_objectives(objectives):
    """Raise InputError for an empty list, and for what is no objective."""
    if not objectives:
        raise InputError("gradient: the list of objectives is empty; give at least one")
    for one in objectives:
        if not isinstance(one, Objective):
            raise InputError(
                f"gradient: {one!r:.80} is no objective; use one of polyida.objective, or objective.UserObjective(value, slopes)"
            )


def _names(parameters):
    """The requested names and Parameters as a list, None for all. Raises InputError for anything else."""
    if parameters is None:
        return None
    names = list(parameters) if np.iterable(parameters) and not isinstance(parameters, str) else None
    if names is None or not all(isinstance(name, (str, Parameter)) for name in names):
        raise InputError(f"gradient: parameters = {parameters!r:.80} must be a list of names, or None for all")
    return names


def _require_elastic(run, objectives):
    """Raise InputError for viscoelastic plates in a state that is no run, and for objectives of elastic bodies in their runs."""
    model = run.model if isinstance(run, (Trajectory, Equilibrium, Modes)) else None
    relaxing = [body.name for body in model.all_bodies if body.prony] if model is not None and model.is_scene else []
    if not relaxing:
        return
    names = ", ".join(map(repr, relaxing))
    if not isinstance(run, Trajectory):
        raise InputError(f"gradient: {names}: equilibria and modes of viscoelastic plates have no adjoint yet, runs have")
    for _, one in (term for each in objectives for term in terms_of(each)):
        if isinstance(one, ELASTIC):
            raise InputError(f"gradient: {type(one).__name__} is of elastic bodies, and {names} viscoelastic")


def _gradients_of_run(run, objectives, names, memory_limit, progress):
    """The Gradient of each objective of a run; one that depends on no frame takes no sweep."""
    kind = adjoint_of("gradient", run)
    moving = [one for one in objectives if one.of_frames]
    if len(moving) < len(objectives):
        swept = iter(_gradients_of_run(run, moving, names, memory_limit, progress) if moving else ())
        return [next(swept) if one.of_frames else _of_model(run, one, names) for one in objectives]
    gradients = partial(gradients_of_events, kind) if run.events.given else kind.gradients
    with backward(progress, run) as tell:
        return gradients(run, objectives, names, memory_limit, tell)


def _of_model(run, objective, names):
    """The Gradient of an objective that depends on no frame."""
    totals = Totals(run.model, names, run.plan.get("began") != "state")
    totals.add_own(slopes_at(objective, objective.slopes(run), run, slice(0, len(run))))
    if totals.with_v0:
        totals.sums["v0"] = np.zeros(run.model.n)
    return Gradient(objective(run), totals.slopes(), Counts(), totals.left_out)


def adjoint_of(part, run):
    """The RunAdjoint of a run's integrator. Raises InputError, in the name of `part`, if the run has no adjoint."""
    model = run.known_model(part)
    if not run.events.given:
        require_no_laws(part, guard(model), TIME_STEPPING)
    if model.is_scene and model.controllers:
        raise InputError(f"{part}: outputs of a sampled Controller have no slopes; use a continuous one, such as polyida.PID")
    kinds = (adjoint for kind, adjoint in ADJOINTS.items() if isinstance(run.integrator, kind))
    if (kind := next(kinds, None)) is None:
        name = type(run.integrator).__name__
        why = WHY.get(name, "has no adjoint here")
        raise InputError(f"{part}: {name} {why}; run polyida.GeneralizedAlpha(...) or polyida.RadauIIA(...)")
    kind.require_settings(run.integrator)
    if getattr(run.integrator, "form", "") == "stabilised":
        _require_no_velocity_rows(part, guard(model), 'form "stabilised" has', 'form "index3" has')
    if run.plan.get("began") == "run":
        raise InputError(
            f"{part}: the run goes on from a state of another one, which depends on parameters too; solve from the start of that"
        )
    if len(run) < 2:
        raise InputError(f"{part}: the run has no step")
    if not run.success:
        warnings.warn(f"{part}: the run ended early ({run.status}, t = {run.t[-1]:.6g} s): J is of its frames alone", stacklevel=5)
    return kind


def _require_no_velocity_rows(part, model, what, other):
    """Raise InputError if the model has a velocity row; what: the runs that have no adjoint with one, other: those that have."""
    if model.velocity_rows.size:
        name = model.constraint_name(int(model.velocity_rows[0]))
        raise InputError(f"{part}: {name} is a velocity row, for which {what} no adjoint; {other}")


def gradients_of_state(subject, objectives, names=None):
    """The Gradient of each objective of an Equilibrium or of Modes. Raises StepFailure if the structure can move freely."""
    require_no_laws("gradient", guard(subject.model), OF_LAWS)
    _require_no_velocity_rows("gradient", guard(subject.model), "equilibria and modes have", "runs have")
    totals, counts = Totals(subject.model, names), Counts()
    equilibrium = subject.state if isinstance(subject, Modes) else subject
    if isinstance(equilibrium, Equilibrium) and equilibrium.linear and guard(subject.model).k:
        raise InputError("gradient: small displacements of models with first-order states have no adjoint; leave out linear=True")
    system, gradients = lru_cache(maxsize=1)(partial(_static_system, equilibrium, counts)), []
    for objective in objectives:
        own, totals = slopes_at(objective, objective.slopes(subject), subject, slice(0, 1)), totals.empty()
        totals.add_own(own)
        if isinstance(equilibrium, Equilibrium) and any(slope is not None and slope.any() for slope in (own.q, own.lam)):
            _add_static(equilibrium, system(), own, totals, counts)
        gradients.append(Gradient(objective(subject), totals.slopes(), counts, totals.left_out))
    return gradients


def _about(equilibrium):
    """(q, lam) about which an equilibrium is linear."""
    return (np.zeros_like(equilibrium.q), np.zeros_like(equilibrium.lam)) if equilibrium.linear else (equilibrium.q, equilibrium.lam)


def _static_system(equilibrium, counts):
    """The factored KKT matrix of an equilibrium. Raises StepFailure if it is singular."""
    model, t, (q, lam) = guard(equilibrium.model), equilibrium.t, _about(equilibrium)
    none = np.zeros(model.n)
    counts.tangents, counts.factorizations = 1, 1
    try:  # the unknowns that belong to states are velocities
        return KKT(Loading(model, t, none, none, 1.0, 1).stiffness(q + equilibrium.v, lam), model.phi_q(t, q))
    except SingularSystem:
        raise StepFailure("singular", FREE, t) from None


def _add_static(equilibrium, system, own, totals, counts):
    """Add to the totals the slopes of an objective's q and lam in an equilibrium, by its adjoint."""
    model, t, lam = guard(equilibrium.model), equilibrium.t, equilibrium.lam
    j_q, j_lam = (np.zeros(x.shape) if slope is None else slope[0] for x, slope in ((equilibrium.q, own.q), (lam, own.lam)))
    still, none = np.zeros(model.n), np.zeros(model.m)
    counts.solves += 1
    w, mu = system.solve(j_q, j_lam, transposed=True)
    entry = (t, _about(equilibrium)[0], equilibrium.v, still, lam, w, mu)
    totals.add(AdjointMultipliers(*(np.asarray(x, float)[None] for x in entry)))
    if equilibrium.linear:
        totals.add(AdjointMultipliers(*along_way(model, t, still, none, equilibrium.q, w, mu)))
