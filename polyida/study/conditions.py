"""The condition number of iteration matrices against the step."""

from collections.abc import Callable
from inspect import signature
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.integrate.iteration_matrix import condition_number
from polyida.integrate.start import require_state
from polyida.integrate.state import State, declared
from polyida.linear.lu import condition
from polyida.model.guarded import guard
from polyida.progress import teller
from polyida.show.style import on_axes, plain
from polyida.study.drawing import look
from polyida.study.result import Result
from polyida.study.rows import fitted
from polyida.study.subject import require_labels, steps_of, studied
from polyida.validation import named_keywords

DECADES = tuple(10.0**-k for k in range(1, 10))


class Conditioning(Result):
    """What `conditioning` found: a row for each integrator, state and step."""

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
        """{label: slope of the condition number over h on logarithmic axes}, of the finer half of the steps, the steepest of all states."""
        return {label: min((self._slope(label, state) for state in self._states()), default=np.nan) for label in self.labels}

    @property
    def figures(self) -> dict[str, float]:
        """Slopes and the largest condition numbers, by names such as "slope alpha"."""
        worst = {label: max(row["condition"] for row in self.rows if row["integrator"] == label) for label in self.labels}
        return {f"slope {label}": value for label, value in self.slopes.items()} | {
            f"worst {label}": value for label, value in worst.items()
        }

    def plot(self, axes=None):
        """Draw the condition numbers against h, a line for each integrator and state; returns the axes."""
        with on_axes(axes) as axis:
            for i, (label, state) in enumerate(product(self.labels, self._states())):
                rows = self._rows(label, state)
                name = plain(f"{label}, state {state}" if len(self._states()) > 1 else label)
                axis.loglog([row["h"] for row in rows], [row["condition"] for row in rows], label=name, **look(i))
            axis.set(xlabel="step h, s", ylabel="condition number", title=self.title)
            axis.legend(loc="best")
            return axis

    def pictures(self) -> dict:
        """The condition numbers against the step."""
        return {"condition": ("Condition number of the iteration matrix against the step.", self.plot)}

    def _states(self):
        return sorted({row["state"] for row in self.rows})

    def _rows(self, label, state):
        return [row for row in self.rows if row["integrator"] == label and row["state"] == state]

    def _slope(self, label, state):
        rows = sorted(self._rows(label, state), key=lambda row: row["h"])
        finer = rows[: max(2, (len(rows) + 1) // 2)]
        return fitted([row["h"] for row in finer], [row["condition"] for row in finer])


@named_keywords
def conditioning(
    model: object,
    states: State | list[State],
    integrators: dict[str, object],
    *,
    h: ArrayLike = DECADES,
    progress: Callable[[int, int, str], object] | bool | None = None,
) -> Conditioning:
    """The condition number of every integrator's iteration matrix at every state for every step h, s.

    model: a Model, a Scene, a Problem or the name of one. states: a State, or several, of one's own, `run.state` or
    `consistent_state(model)`. integrators: {label: integrator, its class, or function of h}: GeneralizedAlpha, IDA (h is 1/cj) and
    RadauIIA, with any `scaling=` and form, as `condition_number` takes them; one of a user's own where it has `iteration_matrix(model,
    state, h)`. Raises InputError for others.
    """
    built = guard(studied("conditioning", model)[1], "conditioning")
    chosen = [require_state("conditioning", built, state) for state in (states if isinstance(states, (list, tuple)) else [states])]
    if not chosen:
        raise InputError("conditioning: states has no state in it")
    steps = steps_of("conditioning", h)
    require_labels("conditioning", integrators, "integrator")
    for label, given in integrators.items():
        if not hasattr(given, "steps") and not callable(given):
            raise InputError(f"conditioning: integrators[{label!r}] = {given!r} must be an integrator, or a class or function of h")
    rows: list[dict] = []
    with teller("conditioning", progress) as tell:
        for label, given in integrators.items():
            for number, state in enumerate(chosen):
                tell(len(rows), len(integrators) * len(chosen) * len(steps), f"{label}, t = {state.t:g} s")
                rows += [
                    {"integrator": label, "state": number, "t": float(state.t), "h": step}
                    | {"condition": _condition(built, given, state, step)}
                    for step in steps
                ]
    return Conditioning(rows)


def _condition(model, given, state, h):
    """The condition number for an integrator, or for what a class or function makes of h."""
    if isinstance(given, type):
        integrator = given(h=h) if "h" in signature(given).parameters else given()
    else:
        integrator = given if hasattr(given, "steps") else given(h)
    own = declared(integrator, "conditioning").iteration_matrix
    return float(condition(own(model, state, h)) if own else condition_number(model, integrator, state, h=h))
