"""C functions of a user's model that numba compiles."""

import numpy as np

from polyida.errors import DONE, REASONS, StepFailure
from polyida.jit.owner_data import OwnData
from polyida.jit.user_functions import CALLBACK
from polyida.model.functions import OF_CONSTRAINTS, OF_STEPS, SHAPES, arguments_of, writes
from polyida.model.states import HELPERS

MOST = 50  # coordinates and constraints of a model with compiled steps


def shape_of(name, model):
    """The shape of the array that a function of the user of Equations returns."""
    states = model.own_states.total if model.own_states else 0
    return tuple({"n": model.n - model.k, "m": model.m, "k": states}[letter] for letter in SHAPES[name])


class Compiled:
    """C functions of a user's model, and the values that they read from self. Raises InputError for what numba cannot compile.

    functions: {name: the user's function}. addresses: {name: address of its C function}. data: address of the values.
    whole: True if they have the arguments and results of the whole model, with the coordinates of states; otherwise x follows v in the memory.
    """

    def __init__(self, equations, names=OF_STEPS, whole=True):
        """Compile the functions `names` that the user of Equations writes."""
        model, own, m = equations.user, equations.own_states, equations.m
        n = equations.n - equations.k
        written = [name for name in names if writes(model, name) and (m or name not in OF_CONSTRAINTS)]
        self.functions = functions = {name: getattr(type(model), name) for name in written}
        self.own, self.equations = OwnData(model, functions.values(), HELPERS if own else ()), equations
        kinds = {"t": ("t",), "q": ("b", (n,)), "v": ("c", (n,)), "a": ("d", (n,)), "lam": ("e", (m,))}
        if own and "rates" in functions:
            kinds["x"] = own.states_source(self.own, functions["rates"], kinds, whole)
        self.addresses = {}
        for name, function in functions.items():
            extra = own.store_source(name, SHAPES[name], m, self.own, functions.get("rates")) if own and whole else {}
            self.addresses[name] = self.own.c_function(function, kinds, shape_of(name, equations), **extra)
        if whole:
            self.addresses.pop("rates", None)  # compiled alone for messages in its name, and within the other functions
        self.data = self.own.words.ctypes.data

    def calls(self):
        """{name: Python function that calls the C function}. They raise StepFailure."""
        return {name: self._call(name, self.functions[name].__qualname__, CALLBACK(address)) for name, address in self.addresses.items()}

    def _call(self, name, label, function):
        """The Python function that calls a C function with the arguments of the user's function `name`; label: its name in messages."""
        arguments, shape = arguments_of(name), shape_of(name, self.equations)
        places = ("t", "q", "v", "a", "lam")

        def call(*vectors):
            """The user's function by its C function. Raises StepFailure if it fails."""
            values = {argument: np.ascontiguousarray(value, float) for argument, value in zip(arguments, vectors)}
            if len(vectors) > len(arguments) or name == "rates":  # x is read behind v
                values["v"] = np.concatenate((values["v"], vectors[-1]))
            result = np.empty(shape)
            at = (values[place].ctypes.data if place in values else 0 for place in places)
            if (ended := function(self.data, 0, *at, result.ctypes.data)) != DONE:
                status, reason = REASONS[ended]
                raise StepFailure(status, f"{label}: {reason}", float(values.get("t", [np.nan])[0]))
            return result

        return call
