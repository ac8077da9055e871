"""`gradient`: the value of an objective and its slopes in all parameters of the model, of whatever was solved.

Of an equilibrium, and of modes, by one transposed solve:

    [[K^T, B^T], [B, 0]] (w, mu) = (-j_q, -j_lam),   dJ/dp = w . dr/dp + mu . dphi/dp + what J says of p itself

K, B, r and phi are those at the equilibrium; of one for small displacements those of what it solves, `r = g_0 + K_0 q + B_0^T lam`,
`phi = phi_0 + B_0 q`, all at q = 0. What J says of parameters by itself is the modes' at their state; where this is an equilibrium of
`pi.static`, which moves with parameters, its adjoint adds what J says of q and lam. Any other state is held as it is.
"""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from polyida.adjoint.alpha import AlphaAdjoint
from polyida.adjoint.parameter import AdjointMultipliers
from polyida.adjoint.radau import RadauAdjoint
from polyida.adjoint.totals import Gradient, Totals
from polyida.environment import one_blas_thread
from polyida.errors import InputError, StepFailure
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.state import Counts
from polyida.integrate.static import FREE, Equilibrium
from polyida.io.layout import MEMORY_LIMIT, require_bytes
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT
from polyida.modal.modes import Modes
from polyida.model.guarded import guard
from polyida.objective.objective import Objective, along_way
from polyida.progress import over_time, require_progress
from polyida.trajectory import Trajectory
from polyida.validation import named_keywords

ADJOINTS = {GeneralizedAlpha: AlphaAdjoint, RadauIIA: RadauAdjoint}
WHY = {"IDA": "has no adjoint here: that of its steps is SUNDIALS' IDAS, which scikit-sundae does not have"}


@named_keywords
def gradient(
    run: Any,
    objective: Objective,
    parameters: Sequence[str] | None = None,
    memory_limit: float = MEMORY_LIMIT,
    progress: Callable[[float], object] | bool | None = None,
) -> Gradient:
    """The Gradient of an objective of a run, of an equilibrium of `pi.static`, or of `pi.modes`: its value and dJ/dp by name.

    Of a run by the discrete adjoint of GeneralizedAlpha or RadauIIA: exact for the steps that were taken (sizes, cuts, kinks, beginnings),
    up to what Newton's tolerance left in them: at a tolerance of 1e-10 below 1e-9 for what q says and up to 2e-7 for lam and a, by default
    about 1e-4 and 2e-2 (studies/gradient_errors.py); of RadauIIA's own choice 1e-8 to 1e-6 with fixed steps. With adaptive ones Newton's
    method leaves more: the errors are about rtol, and up to 70 times that for PeakStress and PeakReaction, which see what it leaves of
    stiff modes, as where a load begins late. No tolerance that costs next to nothing helps: rtol^2 of the model's length leaves at most 3
    rtol of these for 20 to 50 % more solves, and tolerance=1e-12 at most 1e-6 for 50 to 70 %. Cost, whatever the number of parameters: 0.9
    to 1.7 runs of plates by generalized-alpha (studies/gradient_over_run.py); more runs of small models, whose steps take microseconds, and
    of RadauIIA, whose steps back are taken in Python. A run whose frames are not all of its steps is taken again from
    its beginning; its steps are held in memory up to `memory_limit` bytes, beyond that as checkpoints between which it is taken a third
    time.

    With adaptive steps the slopes are those of these very steps, stretched between kinks. A run that is solved again chooses others, and
    means over time are sums over frames: differences of such runs are up to some hundredths off in what moves a kink, steps of constant h
    are not.

    A state that the run was begun from (`solve(..., state=pi.static(model))`) is held as it is, and so is the beginning where a motor
    begins with the run: the slope in its begin is that with the start where it was. The model is taken as it is now: one that was changed
    since its run gives another gradient. The times at which contacts and other gaps switch are held, which is right where forces are
    continuous there. Slopes then are as good as the steps within the contact. A bar that swings on a stop of 1e6 N/m^1.5: dJ/dstiffness is
    7 % off with GeneralizedAlpha(h=5e-3), 0.1 % with rtol=1e-6; 8 % with RadauIIA(rtol=1e-6), 0.1 % with rtol=1e-8. `check_gradient` takes
    its differences with these times held too: behind a stiff contact they are worse than the gradient. A run that failed comes with a
    warning: J is of the frames that it has.

    parameters: names, or None for all that cost next to nothing: of plates `stiffness` and `mass` (a factor of each cell), `E`,
    `thickness`, `rho`; `mass` of point masses; of motors and loads the numbers of their profiles (`motor.end`, `motor.duration`,
    `load.amplitude` ...); velocities of bodies and `v0`; of models of one's own what their `parameters` names. By name also any number of a
    part, `spring.stiffness`; `left_out` of the result names those that were not taken, with the reason. progress: called with t as it goes
    back, or True for a bar of tqdm. Raises InputError for what is none of these, for another integrator's run, for a run that begins in a
    state of another run, for what moves the constraints of a held state, for frames between steps (`output`, `until`, `extrapolate`), for
    forces that jump where a gap switches, and for an unknown parameter.

        found = pi.gradient(run, pi.objective.Deviation("tip", path))
        found.value, found["arm.stiffness"]
    """
    if not isinstance(objective, Objective):
        raise InputError(
            f"gradient: {objective!r:.80} is no objective; use one of polyida.objective, or objective.UserObjective(value, slopes)"
        )
    names = _names(parameters)
    require_progress("gradient", progress)
    require_bytes("gradient", memory_limit)
    with one_blas_thread():
        if isinstance(run, (Equilibrium, Modes)):
            return gradient_of_state(run, objective, names)
        if not isinstance(run, Trajectory):
            raise InputError(f"gradient: {run!r:.80} is no run, no equilibrium of static, and no modes")
        run.known_model("gradient")
        begin, end = float(run.t[0]), float(run.t[-1])
        kinds = (adjoint for kind, adjoint in ADJOINTS.items() if isinstance(run.integrator, kind))
        if (kind := next(kinds, None)) is None:
            name = type(run.integrator).__name__
            why = WHY.get(name, "has no adjoint here")
            raise InputError(f"gradient: {name} {why}; run polyida.GeneralizedAlpha(...) or polyida.RadauIIA(...)")
        kind.require_settings(run.integrator)
        if run.plan.get("began") == "run":
            raise InputError(
                "gradient: the run goes on from a state of another one, which depends on parameters too; solve from the start of that"
            )
        if len(run) < 2:
            raise InputError("gradient: the run has no step")
        if not run.success:
            warnings.warn(f"gradient: the run ended early ({run.status}, t = {run.t[-1]:.6g} s): J is of its frames alone", stacklevel=4)
        adjoint = kind(run, objective, names, memory_limit)
        if progress is not True:
            return adjoint.gradient(progress or (lambda t: None))
        with over_time(progress, begin, end) as tell:
            return adjoint.gradient(lambda t: tell(begin + end - t))


def _names(parameters):
    if parameters is None:
        return None
    names = list(parameters) if np.iterable(parameters) and not isinstance(parameters, str) else None
    if names is None or not all(isinstance(name, str) for name in names):
        raise InputError(f"gradient: parameters = {parameters!r:.80} must be a list of names, or None for all")
    return names


def gradient_of_state(subject, objective, names=None):
    """The Gradient of an objective of an Equilibrium, or of Modes. Raises StepFailure where the structure can move freely."""
    totals, counts = Totals(subject.model, names), Counts()
    own = objective.slopes(subject)(slice(0, 1))
    totals.own(own)
    equilibrium = subject.state if isinstance(subject, Modes) else subject
    if isinstance(equilibrium, Equilibrium) and any(slope is not None and slope.any() for slope in (own.q, own.lam)):
        _add_static(equilibrium, own, totals, counts)
    return Gradient(objective(subject), totals.slopes(), counts, totals.left_out)


def _add_static(equilibrium, own, totals, counts):
    """Add to the totals what an objective's own Slopes in an equilibrium say by its adjoint."""
    model, t, lam = guard(equilibrium.model), equilibrium.t, equilibrium.lam
    j_q, j_lam = (np.zeros(x.shape) if slope is None else slope[0] for x, slope in ((equilibrium.q, own.q), (lam, own.lam)))
    still, none = np.zeros(model.n), np.zeros(model.m)
    about = (still, none) if equilibrium.linear else (equilibrium.q, lam)
    K = model.tangent(t, about[0], still, still, about[1], 0.0, 0.0, 1.0)
    counts.tangents, counts.factorizations, counts.solves = 1, 1, 1
    try:
        w, mu = KKT(K, model.phi_q(t, about[0])).solve(j_q, j_lam, transposed=True)
    except SingularSystem:
        raise StepFailure("singular", FREE, t) from None
    entry = (t, about[0], still, still, lam, w, mu)
    totals.add(AdjointMultipliers(*(np.asarray(x, float)[None] for x in entry)))
    if equilibrium.linear:
        totals.add(AdjointMultipliers(*along_way(model, t, still, none, equilibrium.q, w, mu)))
