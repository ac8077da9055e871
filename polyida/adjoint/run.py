"""The gradient of a run: back through its steps by the adjoint of its integrator, then through its consistent start."""

import warnings

import numpy as np

from polyida.adjoint.alpha.backward import Backward
from polyida.adjoint.alpha.forward import beginning, first
from polyida.adjoint.parameters.parameter import Work, stacked
from polyida.adjoint.radau.backward import RadauBackward
from polyida.adjoint.result import Gradient
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.sizes import extent

MOVES = 1e-8  # of the size of the model: by so much a parameter of twice its value moves constraints that it does not change
ADJOINTS = {GeneralizedAlpha: Backward, RadauIIA: RadauBackward}
INSTEAD = "run polyida.GeneralizedAlpha(...) or polyida.RadauIIA(...)"
WHY = {"IDA": "has no adjoint here: that of its steps is SUNDIALS' IDAS, which scikit-sundae does not have"}


def gradient_of_run(run, objective, names, progress, memory_limit):
    """The Gradient of an objective of a run. Raises InputError for a run that has no adjoint here."""
    adjoint = _adjoint_of(run)
    if not run.success:
        warnings.warn(f"gradient: the run ended early ({run.status}, t = {run.t[-1]:.6g} s): J is of its frames alone", stacklevel=5)
    back = adjoint(run, objective, names, memory_limit)
    _settle_start(run, back, names)
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


def _settle_start(run, back, names):
    """Leave out parameters that move the constraints of the state that a run begins with where that is held, or where they change what
    coordinates mean: no run of another value begins there. Raises InputError where they were asked for by name.
    """
    totals, model, state = back.totals, back.model, beginning(back.course, back.course.pieces[0], None)
    if not model.m:
        return
    zero, none = np.zeros((1, model.n)), np.zeros((1, model.m))
    mu = np.random.default_rng(0).uniform(1.0, 2.0, none.shape)
    work = Work(np.array([state.t]), state.q[None], zero, zero, none, zero, mu)
    for name, parameter in list(totals.parameters.items()):
        if not (run.plan.get("began") == "state" or parameter.changes_coordinates):
            continue
        size = float(np.abs(parameter.value).max(initial=0.0)) or 1.0
        if size * np.abs(parameter.work(work)).max(initial=0.0) > MOVES * extent(model, state.q):
            why = "it moves the constraints of the state that the run begins with, so that no run of another value begins there"
            if names is not None:
                raise InputError(f"gradient: {name!r} has no slope: {why}; draw the scene where the run begins")
            del totals.parameters[name], totals.sums[name]
            back.moving.speeds.pop(name, None)
            totals.left_out[name] = why
