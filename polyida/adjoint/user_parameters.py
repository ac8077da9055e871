"""The parameters of a user's model: its attributes that `parameters` names, with slopes by functions of the model or by differences."""

from functools import cached_property
from typing import Any

import numpy as np

from polyida.adjoint.parameter import Parameter, equation_values, select_entries
from polyida.errors import InputError
from polyida.model import NEARBY
from polyida.model.functions import writes
from polyida.model.guarded import guard, unguarded
from polyida.validation import floats, read_only


class UserModelParameter(Parameter):
    """An attribute of a user's model, a number or an array."""

    @cached_property
    def _values(self):
        """{value: `equation_values` of the copy of the model with it}."""
        return {}

    def slope(self, work):
        """The model's residual_p and phi_p if it has them, else differences of copies of the model."""
        result, own = np.zeros(np.shape(self.value)), unguarded(self.model)
        if writes(own, "residual_p"):
            result = result + self._by_model_functions("residual_p", work.w, work.t, work.q, work.v, work.a, work.lam)
            work = work._replace(w=np.zeros_like(work.w))
        if writes(own, "phi_p") and work.mu is not None:
            result = result + self._by_model_functions("phi_p", work.mu, work.t, work.q)
            work = work._replace(mu=None)
        near = work.t if writes(own, "kinks") else np.zeros(0)
        for t in np.unique(near).tolist():
            result = result + self._by_differences(select_entries(work, near == t), t)
        result = result if len(near) else result + self._by_differences(work, None)
        return result if result.ndim else float(result)

    def _by_model_functions(self, function, factors, times, *states):
        """Slope of entries by a function (name, t, *states) of the model: residual_p or phi_p. factors (entries, rows) multiply its results.

        The guarded function is called only if the results of the model's own are wrong: it explains what is wrong.
        """
        which = np.flatnonzero(factors.any(axis=1))
        at = list(zip(times[which].tolist(), *(read_only(x[which]) for x in states)))
        shape, own = (len(which), factors.shape[1], *np.shape(self.value)), unguarded(self.model)
        slopes = floats([getattr(own, function)(self.name, *state) for state in at])
        if slopes is None or slopes.shape != shape:
            slopes = np.array([getattr(guard(self.model), function)(self.name, *state) for state in at]).reshape(shape)
        return np.tensordot(factors[which], slopes, 2)

    def _by_differences(self, work, t):
        """Slope of entries by differences of copies of the model, without the equations whose multipliers are all zero.

        t: time of the entries, whose side of a kink is kept; None if the model has no kinks.
        """
        of_rows = {name: None if x is None or not x.any() else x for name, x in (("mu", work.mu), ("kappa", work.kappa), ("nu", work.nu))}
        work = work._replace(**of_rows)
        work = work if work.w.any() else work._replace(w=np.zeros((0, work.w.shape[1])))
        weights = np.concatenate([x.ravel() for x in (work.w, work.mu, work.kappa, work.nu) if x is not None])
        if not weights.any():
            return 0.0

        def values(model):
            """The equations' values of a copy of the model at the entries."""
            key = np.asarray(model.parameter(self.name), float).tobytes()
            evaluate = self._values.get(key) or equation_values(guard(model))
            if t is None:  # the same few values for all entries
                self._values[key] = evaluate
            return evaluate(work)

        return np.tensordot(weights, self.model.slope_p(self.name, values, t), 1)

    def of_model(self, function):
        """The slope of a function of the model in the parameter, by differences of copies."""
        slope = self.model.slope_p(self.name, lambda model: np.array([function(model)]))[0]
        return slope if np.ndim(slope) else float(slope)

    def replaced(self, value):
        """A copy of the model with the attribute changed."""
        return self.model.replaced(self.name, value)

    def start(self, t, q, adjoint):
        """The slope of `adjoint . initial velocities` in the parameter, by differences of copies; None if it is zero."""
        slope = adjoint @ self.model.slope_p(self.name, lambda model: guard(model).initial_velocity(t, q))
        return slope if slope.any() else None

    def kinks(self, t0, t1):
        """{time of a kink in (t0, t1): its derivative in the parameter}, by differences of copies, without zeros."""
        if np.ndim(self.value):
            return {}
        step = NEARBY * (abs(self.value) or 1.0)
        near = [self.replaced(self.value + s).kinks(t0, t1) for s in (-step, step)]
        known = self.model.kinks(t0, t1)
        if not len(near[0]) == len(near[1]) == len(known):
            raise InputError(f"{self.name}: the model's kinks between {t0:g} and {t1:g} s come and go where it changes a little")
        moved = np.subtract(near[1], near[0]) / (2 * step)
        return {kink: speed for kink, speed in zip(known, moved.tolist()) if speed}


def user_model_parameters(model: Any) -> list[Parameter]:
    """The Parameters of the names in a user's `model.parameters`. Raises InputError for one that is no number or array of numbers."""
    if isinstance(model.parameters, str):
        raise InputError(f"{model!r}: parameters = {model.parameters!r} must be a tuple of names, such as ({model.parameters!r},)")
    return [UserModelParameter(name, _value(model, name), model) for name in model.parameters]


def _value(model, name):
    """The value of a named attribute, a float or an array. Raises InputError for anything else."""
    value = floats(model.parameter(name))
    if value is None:
        raise InputError(f"{model!r}: its parameter {name!r} must be an attribute that is a number or an array of numbers")
    return value if value.ndim else float(value)
