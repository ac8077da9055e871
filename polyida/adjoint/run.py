"""The gradient of a run: back through its steps by the adjoint of its integrator, then through its consistent start."""

import warnings

from polyida.adjoint.alpha.backward import Backward
from polyida.adjoint.alpha.beginning import first
from polyida.adjoint.alpha.forward import beginning
from polyida.adjoint.parameters.work import stacked
from polyida.adjoint.radau.backward import RadauBackward
from polyida.adjoint.result import Gradient
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.radau.radau_iia import RadauIIA

ADJOINTS = {GeneralizedAlpha: Backward, RadauIIA: RadauBackward}
INSTEAD = "run polyida.GeneralizedAlpha(...) or polyida.RadauIIA(...)"
WHY = {"IDA": "has no adjoint here: that of its steps is SUNDIALS' IDAS, which scikit-sundae does not have"}


def gradient_of_run(run, objective, names, progress, memory_limit):
    """The Gradient of an objective of a run. Raises InputError for a run that has no adjoint here."""
    adjoint = _adjoint_of(run)
    if not run.success:
        warnings.warn(f"gradient: the run ended early ({run.status}, t = {run.t[-1]:.6g} s): J is of its frames alone", stacklevel=5)
    back = adjoint(run, objective, names, memory_limit)
    sent, lam = back.through(progress)
    if run.plan.get("began") != "state":
        state = beginning(back.course, back.course.pieces[0], None)
        start = first(back.model, state, sent, lam)
        if work := stacked(start.entries):
            back.totals.work(work)
        back.totals.start(state, start.v0)
    return Gradient(back.own.value, back.totals.slopes(), back.counts, back.totals.left_out)


def _adjoint_of(run):
    """The class that goes through the run backwards. Raises InputError where there is none."""
    settings = run.integrator
    found = next((adjoint for kind, adjoint in ADJOINTS.items() if isinstance(settings, kind)), None)
    if found is None:
        name = type(settings).__name__
        raise InputError(f"gradient: {name} {WHY.get(name, 'has no adjoint here')}; {INSTEAD}")
    if getattr(settings, "extrapolate", False):
        raise InputError("gradient: extrapolate = True makes frames of two runs; take the gradient of one without")
    if run.plan.get("began") == "run":
        raise InputError(
            "gradient: the run goes on from a state of another one, which depends on parameters too; solve from the start of that"
        )
    if len(run) < 2:
        raise InputError("gradient: the run has no step")
    return found
