"""The iteration matrix of an integrator at a state, as scaled, and its condition number."""

from dataclasses import replace

import numpy as np

from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida import whole as of_ida
from polyida.integrate.ida.forms import System
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau import matrices as of_radau
from polyida.integrate.radau.matrices import Rows, lift
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.radau.tableau import radau
from polyida.integrate.sizes import weights
from polyida.integrate.start import require_state
from polyida.integrate.state import State
from polyida.linear.lu import condition, scaled
from polyida.linear.saddle import assemble, scaling_size
from polyida.model import Model
from polyida.model.guarded import guard, require_functions
from polyida.validation import is_number, is_one_of, named_keywords

UNKNOWNS = ("q", "v", "a")
MODES = ("real", "complex")


@named_keywords
def condition_number(
    model: Model,
    integrator: GeneralizedAlpha | IDA | RadauIIA,
    state: State,
    scaling: str | None = None,
    unknown: str = "q",
    h: float | None = None,
    exact: bool | None = None,
    mode: str | None = None,
) -> float:
    """Condition number of the `iteration_matrix` of GeneralizedAlpha, IDA or RadauIIA at a state.

    exact: in the 2-norm, from a dense inverse, right also far beyond 1e16 (by default up to 2000 unknowns); otherwise an
    estimate of the condition number in the 1-norm, from a sparse factor (Higham, Tisseur 2000), which is within a factor
    of the number of unknowns of it and mostly within 10. Returns inf where the matrix is singular. Raises InputError as
    `iteration_matrix`.
    """
    return condition(iteration_matrix(model, integrator, state, scaling, unknown, h, mode), exact)


def iteration_matrix(model, integrator, state, scaling=None, unknown="q", h=None, mode=None):
    """The matrix of one Newton iteration at a state: CSC where the model's matrices are sparse, dense otherwise.

    GeneralizedAlpha: `[[S, B^T], [B, 0]]`, (n + m, n + m), `S = beta' M + gamma' C + K`; unknown: "q" for the unknowns (dq, dlam), or "v"
    or "a", whose increments are gamma' dq and beta' dq. IDA: the whole matrix `dF/dy + cj dF/dy'` of its form, cj = 1/h, (2n + m or 2n +
    2m)^2. RadauIIA: that of its form for one mode of the stages, of the same shape (radau/matrices.py); mode: "real" or "complex", by default
    the real one, which two stages do not have. scaling: the integrator's own, or any other that it knows. h: the step, s, in place of
    GeneralizedAlpha's and RadauIIA's own; IDA, and the others where none was given, have none. Raises InputError for an integrator, a
    scaling, an unknown, a mode or a step that there is not.
    """
    model = guard(model, "condition_number")
    if not isinstance(integrator, (GeneralizedAlpha, IDA, RadauIIA)):
        raise InputError(f"condition_number: integrator {integrator!r} must be GeneralizedAlpha, IDA or RadauIIA")
    _require_choice(integrator, unknown, mode)
    state = require_state("condition_number", model, state)
    require_functions(model, state.t, state.q, state.v)
    integrator = integrator if scaling is None else replace(integrator, scaling=scaling)
    if isinstance(integrator, IDA):
        return _ida(model, integrator, state, h)
    integrator = integrator if h is None else replace(integrator, h=h)
    return _radau(model, integrator, state, mode) if isinstance(integrator, RadauIIA) else _alpha(model, integrator, state, unknown)


def _require_choice(integrator, unknown, mode):
    name = type(integrator).__name__
    if not is_one_of(unknown, UNKNOWNS):
        raise InputError(f"condition_number: unknown = {unknown!r} must be one of {', '.join(UNKNOWNS)}")
    if unknown != "q" and not isinstance(integrator, GeneralizedAlpha):
        raise InputError(f"condition_number: unknown = {unknown!r} must be 'q' for {name}, which has q and v at once")
    if not isinstance(integrator, RadauIIA):
        if mode is not None:
            raise InputError(f"condition_number: mode = {mode!r} must be None for {name}: RadauIIA has them")
    elif mode is not None and not is_one_of(mode, MODES):
        raise InputError(f"condition_number: mode = {mode!r} must be one of {', '.join(MODES)}, or None")
    elif mode == "real" and integrator.stages == 2:
        raise InputError("condition_number: mode = 'real' must be 'complex' for RadauIIA of two stages, which has no other")


def _require_step(integrator):
    if integrator.h is None:
        raise InputError(f"condition_number: h = None must be a positive step in s: {type(integrator).__name__} has none of its own")


def _alpha(model, integrator, state, unknown):
    _require_step(integrator)
    c, h = integrator.coefficients, integrator.h
    to_a, to_v = c.rates(h)
    tangent = model.tangent(state.t, state.q, state.v, state.a, state.lam, to_a, to_v, 1.0)
    phi_q = model.phi_q(state.t, state.q)
    divided = {"q": 1.0, "v": to_v, "a": to_a}[unknown]
    matrix = assemble(tangent, phi_q, scaling_size(integrator.scaling, c.beta * h * h, tangent))
    columns = np.ones(matrix.shape[0])
    columns[: model.n] = 1 / divided
    return scaled(matrix, np.ones(matrix.shape[0]), columns)


def _ida(model, integrator, state, h):
    if not (is_number(h) and h > 0):
        raise InputError(f"condition_number: h = {h!r} must be a positive step in s: IDA has none of its own")
    system = System(model, integrator.form, integrator.rate)
    matrix, s = of_ida.whole_matrix(system, state.t, *system.pack(state), 1 / h)
    return scaled(matrix, *of_ida.sizes(integrator.scaling, system.form, model.n, model.m, 1 / h, s))


def _radau(model, integrator, state, mode):
    """Form "ggl" with its mu even where a run leaves it out, because phi is linear in q and mu is zero."""
    _require_step(integrator)
    t, q, v, tied = state.t, state.q, state.v, integrator.form == "ggl"
    rows = Rows(model, t, q, v, lift(model, weights(model, q)) if tied else None)
    K = model.tangent(t, q, v, state.a, state.lam, 0.0, 0.0, 1.0)
    c = radau(integrator.stages).modes[-1 if mode == "complex" else 0].value / integrator.h
    slope = c * model.mass(q) + model.force_v(t, q, v) if model.needs.velocity_forces else c * model.mass(q)
    matrix, s = of_radau.whole_matrix(c, K, slope, rows)
    return scaled(matrix, *of_radau.sizes(integrator.scaling, c, s, model.n, model.m, tied))
