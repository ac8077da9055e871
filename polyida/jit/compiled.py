"""Functions of users that numba compiles: `polyida.compiled`, and what such a function gives at many arguments at once."""

import math
import types as python_types
from functools import cache, cached_property, update_wrapper
from typing import Any

import numba
import numpy as np
from numba import NumbaError, types

from polyida.errors import InputError
from polyida.given import read_only
from polyida.keywords import named_keywords

ARGUMENTS = 8


@named_keywords
def compiled(given: Any) -> Any:
    """Decorator of a Model, ForceElement or Body, or of a function: numba compiles it, and steps call no Python of it.

    The functions of a class are the same plain numpy code as without the decorator, as far as numba compiles that. They read numbers, arrays,
    profiles (`self.profile(t)`) and compiled functions of `self`, with the values at the start of a run, and may call functions of their
    module, but not each other through `self`. Derivatives that are not written are formed by differences in compiled code; those that
    a ForceElement or a Body writes are for Python alone. A function that raises, or returns an array of another shape, ends the run at
    that time. A compiled function is taken where a plain one is: by profiles, `until`, sensors, and functions of state of forces.
    GeneralizedAlpha, RadauIIA and EnergyMomentum call no Python in a step of scenes, and of models of up to 50 coordinates and constraints;
    of larger ones the functions are compiled, and the rest of the step is not. IDA's binding calls Python once an iteration.

    given: a subclass of Model, ForceElement or Body, or a function. Returns the class itself, or what is called as the function is.
    Raises InputError for anything else and, where a run begins or a scene is built, for a function that numba cannot compile or whose result
    is no real array of the right dimension; the message names the function.
    """
    if isinstance(given, type) and hasattr(given, "by_numba"):
        given.by_numba = True
        return given
    if isinstance(given, python_types.FunctionType):
        return CompiledFunction(given)
    raise InputError(f"compiled: {given!r:.100} must be a function, or a subclass of polyida.Model, ForceElement or Body")


class CompiledFunction:
    """A function that Python calls as it is, and compiled code as `dispatcher`."""

    def __init__(self, function):
        update_wrapper(self, function)
        self.function = function

    def __call__(self, *given):
        return self.function(*given)

    def __reduce__(self):
        return self.__qualname__

    @cached_property
    def dispatcher(self):
        """The function for compiled code."""
        return for_numba(self.function)


def dispatcher_of(given):
    """What compiled code calls of a function that is compiled, by `compiled` or numba.njit; None of any other."""
    if isinstance(given, CompiledFunction):
        return given.dispatcher
    return given if hasattr(given, "py_func") else None


def compiled_for(label, function, *kinds):
    """The type that a function of numba's returns for arguments of these types. Raises InputError naming it."""
    try:
        function.compile(kinds)
    except NumbaError as error:
        text = " ".join(str(error).replace("Failed in nopython mode pipeline (step: nopython frontend)", "").split())
        advice = "leave out @polyida.compiled, or write it as numba wants"
        raise InputError(f"{label} cannot be compiled by numba: {text:.600}; {advice}") from None
    return function.overloads[kinds].signature.return_type


def for_numba(function, known=None):
    """A function as numba takes it, with plain functions of its module compiled too; a user's index out of bounds raises."""
    known, ours = {} if known is None else known, function.__module__.startswith("polyida.")
    if function not in known:
        own = dict(function.__globals__)
        made = python_types.FunctionType(function.__code__, own, function.__name__, function.__defaults__, function.__closure__)
        known[function] = numba.njit(error_model="numpy", nogil=True, boundscheck=not ours)(made)
        for name in names_of(function.__code__):
            if isinstance(value := own.get(name), python_types.FunctionType):
                own[name] = for_numba(value, known)
            elif isinstance(value, CompiledFunction):
                own[name] = value.dispatcher
    return known[function]


def names_of(code):
    """Names that a function uses, with those of functions within it."""
    inner = (name for inner in code.co_consts if isinstance(inner, python_types.CodeType) for name in names_of(inner))
    return dict.fromkeys([*code.co_names, *inner])


@cache
def _filling(label, function, dimensions, shape):
    """A function of numba's that fills row after row of an array with what a function of rows gives, of a shape."""
    names = [f"x{k}" for k in range(len(dimensions))]
    row = f"if found.shape != {shape}:\n            raise ValueError\n        out[k] = found.ravel()" if shape else "out[k, 0] = found"
    source = f"""def fill({", ".join(names)}, out):
    for k in range(len(out)):
        found = function({", ".join(f"{name}[k]" for name in names)})
        {row}
"""
    made: dict = {"function": function}
    exec(source, made)
    fill = numba.njit(error_model="numpy")(made["fill"])
    kinds = [types.Array(types.float64, dimension, "C", readonly=True) for dimension in dimensions]
    compiled_for(f"{label} {function.__name__}", fill, *kinds, types.float64[:, ::1])
    return fill


def over(label, function, *given, shape=()):
    """What a compiled function gives, of a shape, at each of the rows of arrays, (rows, numbers); None if it is Python, or raises.

    Raises InputError where numba does not compile it.
    """
    dispatcher, found = dispatcher_of(function), np.empty((len(given[0]), math.prod(shape)))
    if dispatcher is None:
        return None
    fill = _filling(label, dispatcher, tuple(x.ndim for x in given), shape)
    try:
        fill(*(read_only(np.ascontiguousarray(x)) for x in given), found)
    except Exception:  # noqa: BLE001 the function is then called at one row after the other, which names the one
        return None
    return found
