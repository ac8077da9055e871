"""Models of a user's own whose functions numba compiles."""

from inspect import signature

import numpy as np

from polyida.errors import StepFailure
from polyida.jit.compiled import OwnData
from polyida.model import Model
from polyida.model.guarded import OF_CONSTRAINTS, writes
from polyida.system.table import DONE, REASONS

SHAPES = {  # of what the functions return, in n and m
    "mass": "nn",
    "force": "n",
    "phi": "m",
    "phi_q": "mn",
    "phi_t": "m",
    "residual": "n",
    "force_q": "nn",
    "force_v": "nn",
    "mass_a_q": "nn",
    "reaction_q": "nn",
    "phi_bias": "m",
    "potential": "",
}
OF_STEPS = tuple(name for name in SHAPES if name != "potential")  # which only the energy-momentum method asks for


class Compiled:
    """The C functions that a model writes, {name: address}, and `data`, the address of what they read as self. Raises InputError."""

    def __init__(self, guarded, wanted=OF_STEPS):
        model, n, m = guarded.user, guarded.n, guarded.m
        written = [name for name in wanted if writes(model, name) and (m or name not in OF_CONSTRAINTS)]
        self.functions = functions = {name: getattr(type(model), name) for name in written}
        self.own, self.sizes = OwnData(model, functions.values()), {"n": n, "m": m}
        given = {"t": ("t",), "q": ("b", (n,)), "v": ("c", (n,)), "a": ("d", (n,)), "lam": ("e", (m,))}
        self.kept = {name: self.own.c_function(function, given, self._shape(name)) for name, function in functions.items()}
        self.addresses, self.data = {name: made.address for name, made in self.kept.items()}, self.own.words.ctypes.data

    def _shape(self, name):
        return tuple(self.sizes[letter] for letter in SHAPES[name])

    def calls(self):
        """{name: function of Python that calls the C function}. They raise StepFailure."""
        return {name: self._call(name, self.functions[name].__qualname__, made.ctypes) for name, made in self.kept.items()}

    def _call(self, name, label, function):
        arguments, shape, places = list(signature(getattr(Model, name)).parameters)[1:], self._shape(name), ("t", "q", "v", "a", "lam")

        def call(*given):
            values = {argument: np.ascontiguousarray(value, float) for argument, value in zip(arguments, given)}
            found = np.empty(shape)
            at = (values[place].ctypes.data if place in values else 0 for place in places)
            if (ended := function(self.data, 0, *at, found.ctypes.data)) != DONE:
                status, reason = REASONS[ended]
                raise StepFailure(status, f"{label}: {reason}", float(values.get("t", [np.nan])[0]))
            return found

        return call
