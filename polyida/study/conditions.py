"""`conditioning`: the condition number of iteration matrices against the step."""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from itertools import product
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.integrate.iteration_matrix import condition_number
from polyida.integrate.start import require_state
from polyida.integrate.state import State, declared
from polyida.linear.lu import condition
from polyida.model.guarded import guard
from polyida.progress import teller
from polyida.show.style import literal, marker_style, on_axes
from polyida.study.ivp import require_labels, resolve_model, step_list
from polyida.study.result import Result
from polyida.study.rows import fit_slope, pick
from polyida.validation import named_keywords

if TYPE_CHECKING:
    from matplotlib.axes import Axes

DECADES = tuple(10.0**-k for k in range(1, 10))


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

    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the condition numbers against h, a line for each integrator and state.

        Parameters
        ----------
        axes : Axes, optional
            New pyplot axes if None.

        Returns
        -------
        axes : Axes
        """
        with on_axes(axes) as axis:
            for i, (label, state) in enumerate(product(self.labels, self._states())):
                rows = pick(self.rows, integrator=label, state=state)
                name = literal(f"{label}, state {state}" if len(self._states()) > 1 else label)
                axis.loglog([row["h"] for row in rows], [row["condition"] for row in rows], label=name, **marker_style(i))
            axis.set(xlabel="step h, s", ylabel="condition number", title=self.title)
            axis.legend(loc="best")
            return axis

    def pictures(self) -> dict:
        """The condition numbers against the step."""
        return {"condition": ("Condition number of the iteration matrix against the step.", self.plot)}

    def _states(self):
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
        Function of (done, total, text); True: a bar.

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
