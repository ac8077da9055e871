"""The parameters of models of one's own: attributes that they name."""

from functools import partial
from typing import Any

import numpy as np

from polyida.adjoint.parameters.parameter import Parameter
from polyida.errors import InputError
from polyida.given import floats
from polyida.model import NEARBY
from polyida.model.guarded import guard


class OfOwnModel(Parameter):
    """An attribute of a model, a number or an array."""

    def work(self, work):
        """By the model's residual_p and phi_p; the slopes of rate and bias by differences."""
        result, model = np.zeros(np.shape(self.value)), guard(self.model)
        phi = lambda t, q, v: self.model.phi_p(self.name, t, q)  # noqa: E731
        rate, bias = (partial(self._slope, function) for function in ("phi_rate", "phi_bias"))
        for k, state in enumerate(zip(work.t.tolist(), work.q, work.v, work.a, work.lam)):
            result = result + work.w[k] @ model.residual_p(self.name, *state)
            for given, slope in ((work.mu, phi), (work.kappa, rate), (work.nu, bias)):
                if given is not None and given[k].any():
                    result = result + given[k] @ slope(*state[:3])
        return result if result.ndim else float(result)

    def _slope(self, function, t, q, v):
        return self.model.slope_p(self.name, lambda model: getattr(model, function)(t, q, v), t)

    def of_model(self, function):
        """By differences of copies of the model."""
        slope = self.model.slope_p(self.name, lambda model: np.array([function(model)]))[0]
        return slope if np.ndim(slope) else float(slope)

    def replaced(self, value):
        """The model with the attribute changed."""
        return self.model.replaced(self.name, value)

    def start(self, t, q, bar):
        """By differences of the velocities that the model gives."""
        found = bar @ self.model.slope_p(self.name, lambda model: model.initial_velocity(t, q))
        return found if found.any() else None

    def kinks(self, t0, t1):
        """By differences of the model's kinks."""
        if np.ndim(self.value):
            return {}
        step = NEARBY * (abs(self.value) or 1.0)
        near = [self.replaced(self.value + s).kinks(t0, t1) for s in (-step, step)]
        known = self.model.kinks(t0, t1)
        if not len(near[0]) == len(near[1]) == len(known):
            raise InputError(f"{self.name}: the model's kinks between {t0:g} and {t1:g} s come and go where it changes a little")
        moved = np.subtract(near[1], near[0]) / (2 * step)
        return {kink: speed for kink, speed in zip(known, moved.tolist()) if speed}


def of_own(model: Any) -> list[Parameter]:
    """A Parameter for each name that a model lists. Raises InputError for one that is no number or array of numbers."""
    if isinstance(model.parameters, str):
        raise InputError(f"{model!r}: parameters = {model.parameters!r} must be a tuple of names, such as ({model.parameters!r},)")
    return [OfOwnModel(name, _value(model, name), model) for name in model.parameters]


def _value(model, name):
    value = floats(model.parameter(name))
    if value is None:
        raise InputError(f"{model!r}: its parameter {name!r} must be an attribute that is a number or an array of numbers")
    return value if value.ndim else float(value)
