"""`condition_number` of the scaled iteration matrix of an integrator at a state, and `conditioning`: against the step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from inspect import signature
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.environment import one_blas_thread
from polyida.errors import InputError
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida import tables as of_ida
from polyida.integrate.ida.forms import System
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau import matrices as of_radau
from polyida.integrate.radau.matrices import Rows, lift
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.radau.tableau import radau
from polyida.integrate.sizes import weights
from polyida.integrate.start import require_state
from polyida.integrate.state import State, declared
from polyida.linear.lu import condition, scaled
from polyida.linear.saddle import assemble, scaling_size
from polyida.model import Model
from polyida.model.guarded import guard, require_functions
from polyida.progress import teller
from polyida.reprs import shown
from polyida.show.axes import finish
from polyida.show.styles import literal, marker_style, on_axes
from polyida.study.ivp import require_labels, resolve_model, step_list
from polyida.study.result import Result
from polyida.study.rows import fit_slope, pick
from polyida.validation import flag, is_one_of, named_keywords, one_of, positive

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DECADES = tuple(10.0**-k for k in range(1, 10))
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
    """Return the condition number of an integrator's iteration matrix at a state.

    Parameters
    ----------
    model : Model
    integrator : GeneralizedAlpha, IDA or RadauIIA
    state : State
    scaling : str, optional
        A scaling that the integrator knows, in place of its own.
    unknown : {"q", "v", "a"}
        Unknowns of GeneralizedAlpha: (dq, dlam), or the increments of v = gamma' q or a = beta' q in place of dq.
    h : float, s, optional
        Step in place of the integrator's own; required for IDA, cj = 1/h.
    exact : bool, optional
        True: in the 2-norm, from a dense inverse, accurate also far beyond 1e16 (default up to 2000 unknowns). False: an estimate of the
        condition number in the 1-norm from a sparse factor, mostly within a factor of 10.
    mode : {"real", "complex"}, optional
        Mode of the stages of RadauIIA; by default the real one, which two stages do not have.

    Returns
    -------
    float
        The condition number, inf for a singular matrix.

    Raises
    ------
    InputError
        For an integrator, scaling, unknown, mode or step that does not exist.

    Notes
    -----
    GeneralizedAlpha: `[[S, phi_q^T], [phi_q, 0]]`, `S = beta' M + gamma' C + K`. IDA: `dF/dy + cj dF/dy'` of its form. RadauIIA: the matrix of
    its form for one mode of the stages.

    Higham, Tisseur, SIAM J. Matrix Anal. Appl. 21 (2000) 1185-1201, for the estimate.
    """
    if exact is not None:
        flag("condition_number", "exact", exact)
    with one_blas_thread():  # a second thread costs more than it saves in small matrices
        return condition(iteration_matrix(model, integrator, state, scaling, unknown, h, mode), exact)


def iteration_matrix(model, integrator, state, scaling=None, unknown="q", h=None, mode=None):
    """The scaled matrix of one Newton iteration, with the arguments of `condition_number`: CSC if the model's matrices are sparse, else dense."""
    model = guard(model, "condition_number")
    _require_options(integrator, unknown, mode)
    h = None if h is None else positive("condition_number", "h", h, "seconds")
    state = require_state("condition_number", model, state)
    require_functions(model, state.t, state.q, state.v)
    integrator = integrator if scaling is None else replace(integrator, scaling=scaling)
    if isinstance(integrator, IDA):
        if h is None:
            raise InputError(f"condition_number: h = {h!r} must be a positive step in s: IDA has none of its own")
        return _matrix_of_ida(model, integrator, state, h)
    integrator = integrator if h is None else replace(integrator, h=h)
    if integrator.h is None:
        raise InputError(f"condition_number: h = None must be a positive step in s: {type(integrator).__name__} has none of its own")
    if isinstance(integrator, RadauIIA):
        return _matrix_of_radau(model, integrator, state, mode)
    return _matrix_of_alpha(model, integrator, state, unknown)


def _require_options(integrator, unknown, mode):
    """Raise InputError unless this is one of the three integrators, and has these unknowns and modes."""
    if not isinstance(integrator, (GeneralizedAlpha, IDA, RadauIIA)):
        raise InputError(f"condition_number: integrator {shown(integrator)} must be GeneralizedAlpha, IDA or RadauIIA")
    name = type(integrator).__name__
    one_of("condition_number", "unknown", unknown, UNKNOWNS)
    if unknown != "q" and not isinstance(integrator, GeneralizedAlpha):
        raise InputError(f"condition_number: unknown = {unknown!r} must be 'q' for {name}, which has q and v at once")
    if mode is not None and not isinstance(integrator, RadauIIA):
        raise InputError(f"condition_number: mode = {mode!r} must be None for {name}: RadauIIA has them")
    if mode is not None and not is_one_of(mode, MODES):
        raise InputError(f"condition_number: mode = {mode!r} must be one of {', '.join(MODES)}, or None")
    if mode == "real" and integrator.stages == 2:
        raise InputError("condition_number: mode = 'real' must be 'complex' for RadauIIA of two stages, which has no other")


def _matrix_of_ida(model, integrator, state, h):
    """The scaled `dF/dy + cj dF/dy'` of IDA's form, cj = 1 / h."""
    system = System(model, integrator.form, integrator.baumgarte_rate)
    matrix, s = of_ida.whole_matrix(system, state.t, *system.pack(state), 1 / h)
    return scaled(matrix, *of_ida.sizes(integrator.scaling, system.form, model.n, model.m, 1 / h, s))


def _matrix_of_radau(model, integrator, state, mode):
    """The scaled matrix of one mode of Radau IIA's stages; of form "ggl" with mu also if a run leaves mu out because phi is linear in q."""
    t, q, v, a, lam = state.t, state.q, state.v, state.a, state.lam
    tied = integrator.form == "ggl"
    rows = Rows(model, t, q, v, lam, lift(model, weights(model, q)) if tied else None)
    c = radau(integrator.stages).modes[-1 if mode == "complex" else 0].value / integrator.h
    slope = c * model.mass(q) + model.force_v(t, q, v) if model.needs.velocity_forces else c * model.mass(q)
    matrix, s = of_radau.whole_matrix(c, model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0), slope, rows)
    return scaled(matrix, *of_radau.sizes(integrator.scaling, c, s, model.n, model.m, tied))


def _matrix_of_alpha(model, integrator, state, unknown):
    """The scaled `[[S, phi_q^T], [phi_q, 0]]` of generalized-alpha, `S = beta' M + gamma' C + K`, for increments of q, v or a."""
    coefficients, h = integrator.coefficients, integrator.h
    to_a, to_v = coefficients.rates(h)
    tangent = model.tangent(state.t, state.q, state.v, state.a, state.lam, to_a, to_v, 1.0)
    size = scaling_size(integrator.scaling, coefficients.beta * h * h, tangent)
    matrix = assemble(tangent, model.phi_q(state.t, state.q), size)
    columns = np.ones(matrix.shape[0])
    columns[: model.n] = 1 / {"q": 1.0, "v": to_v, "a": to_a}[unknown]
    return scaled(matrix, np.ones(matrix.shape[0]), columns)


class Conditioning(Result):
    """Result of `conditioning`: a row for each integrator, state and step."""

    title = "condition number of the iteration matrix against the step"
    columns = {
        "integrator": ("integrator", "{}"),
        "state": ("state", "{}"),
        "t": ("t, s", "{:.3g}"),
        "h": ("h, s", "{:.3g}"),
        "condition": ("condition number", "{:.2e}"),
    }

    @property
    def slopes(self) -> dict[str, float]:
        """{label: slope of the condition number over h} on logarithmic axes, for the finer half of the steps; the steepest of all states."""
        slopes: dict[str, list] = {}
        for label, state in product(self.labels, self._states()):
            rows = sorted(pick(self.rows, integrator=label, state=state), key=lambda row: row["h"])
            finer = rows[: max(2, (len(rows) + 1) // 2)]
            slopes.setdefault(label, []).append(fit_slope([row["h"] for row in finer], [row["condition"] for row in finer]))
        return {label: min(values) for label, values in slopes.items()}

    @property
    def figures(self) -> dict[str, float]:
        """Slopes and largest condition numbers, with names such as "slope alpha" and "worst alpha"."""
        worst = {f"worst {label}": max(row["condition"] for row in pick(self.rows, integrator=label)) for label in self.labels}
        return {f"slope {label}": value for label, value in self.slopes.items()} | worst

    @named_keywords
    def plot(self, axes: Axes | None = None, title: str | None = None, labels: dict[str, str] | None = None) -> Axes:
        """Draw the condition numbers against h, a line for each integrator and state.

        Parameters
        ----------
        axes : Axes, optional
            New pyplot axes if None.
        title : str, optional
            None: no title.
        labels : {label of a line: what the legend shows}, optional

        Returns
        -------
        axes : Axes
        """
        with on_axes(axes) as axis:
            for i, (label, state) in enumerate(product(self.labels, self._states())):
                rows = sorted(pick(self.rows, integrator=label, state=state), key=lambda row: row["h"])
                name = literal(f"{label}, state {state}" if len(self._states()) > 1 else label)
                axis.loglog([row["h"] for row in rows], [row["condition"] for row in rows], label=name, **marker_style(i))
            axis.set(xlabel="h, s", ylabel="condition number")
            return finish(axis, title, labels)

    def pictures(self) -> dict:
        """Return {file name: (caption, function that draws the figure)} of the pictures for a report."""
        return {"condition": ("Condition number of the iteration matrix against the step.", self.plot)}

    def _states(self):
        """The sorted values of "state" in the rows, each once."""
        return sorted({row["state"] for row in self.rows})


@named_keywords
def conditioning(
    model: object,
    states: State | list[State],
    integrators: dict[str, Any],
    *,
    h: ArrayLike = DECADES,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> Conditioning:
    """Compute the condition number of every integrator's iteration matrix at every state for every step.

    Parameters
    ----------
    model : Model, Scene, Problem or str
        A string is the name of a problem.
    states : State or list of State
        For example `run.state` or `consistent_state(model)`.
    integrators : {label: integrator, class or function of h}
        GeneralizedAlpha, IDA (h is 1/cj) and RadauIIA with any `scaling=` and form, as in `condition_number`, or a user's integrator with
        `iteration_matrix(model, state, h)`.
    h : (k,) float, s
        The steps.
    progress : callable or bool, optional
        Function of (done, total, text); by default a bar at a terminal and in a notebook; False: none.

    Returns
    -------
    result : Conditioning
        A row for each integrator, state and step.

    Raises
    ------
    InputError
        For other models, states and integrators.
    """
    built = guard(resolve_model("conditioning", model)[1], "conditioning")
    states = [require_state("conditioning", built, state) for state in (states if isinstance(states, (list, tuple)) else [states])]
    if not states:
        raise InputError("conditioning: states has no state in it")
    steps = step_list("conditioning", h)
    require_labels("conditioning", integrators, "integrator")
    for label, value in integrators.items():
        if not hasattr(value, "steps") and not callable(value):
            raise InputError(f"conditioning: integrators[{label!r}] = {value!r} must be an integrator, or a class or function of h")
    rows: list[dict] = []
    with teller("conditioning", progress) as report:
        for (label, value), (number, state) in product(integrators.items(), enumerate(states)):
            report(len(rows), len(integrators) * len(states) * len(steps), f"{label}, t = {state.t:g} s")
            for step in steps:
                if isinstance(value, type):
                    integrator = value(h=step) if "h" in signature(value).parameters else value()
                else:
                    integrator = value if hasattr(value, "steps") else value(step)
                own_matrix = declared(integrator, "conditioning").iteration_matrix
                number_of = condition(own_matrix(built, state, step)) if own_matrix else condition_number(built, integrator, state, h=step)
                rows.append({"integrator": label, "state": number, "t": float(state.t), "h": step, "condition": float(number_of)})
    return Conditioning(rows)
