"""Models of a user's own whose functions numba compiles: no Python is in a step."""

import types as python_types
from functools import cache
from inspect import signature
from typing import TypeVar

import numba
import numpy as np
from numba import carray, types
from numba.core.errors import NumbaError

from polyida.errors import InputError
from polyida.keywords import named_keywords
from polyida.model import Model
from polyida.model.guarded import OF_CONSTRAINTS, writes
from polyida.system.table import ARGUMENTS, DONE, RAISED, WRONG_SHAPE, pointer

M = TypeVar("M", bound=Model)
NUMBERS = types.Array(types.float64, 1, "C", readonly=True)
SIGNATURE = types.int64(*[types.int64] * ARGUMENTS)
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


@named_keywords
def compiled(cls: type[M]) -> type[M]:
    """Class decorator of a Model: numba compiles its functions, and steps call no Python.

    The functions are the same plain numpy code as without it, as far as numba compiles that. They read numbers and arrays of `self`, with the
    values at the start of a run, and may call functions of their module, but not each other through `self`. Derivatives that are not
    written are formed by differences in compiled code. A function that raises, or returns an array of another shape, ends the run at that
    time. GeneralizedAlpha, RadauIIA and EnergyMomentum (with a `potential`) call no Python in a step of models of up to 50 coordinates and
    constraints; IDA's binding calls Python once an iteration. Larger models are called in Python.

    cls: a subclass of Model. Returns cls itself. Raises InputError if cls is no subclass of Model and, where a run begins, for a function that
    numba cannot compile or whose result is no real array of the right dimension; the message names the function.
    """
    if not (isinstance(cls, type) and issubclass(cls, Model)):
        raise InputError(f"compiled: {cls!r:.100} must be a subclass of polyida.Model")
    cls.by_numba = True
    return cls


class Compiled:
    """The C functions that a model writes, {name: address}, and what they read as self; kept as long as this. Raises InputError."""

    def __init__(self, model, wanted=OF_STEPS):
        names = [name for name in wanted if writes(model, name) and (model.m or name not in OF_CONSTRAINTS)]
        self.values = _values(model, names)
        own = numba.from_dtype(self.values.dtype)
        self.addresses = {name: _c_function(model, name, own).address for name in names}

    @property
    def data(self):
        """Address of the values."""
        return self.values.ctypes.data


def _values(model, names):
    """What the functions read of self, as a record of numbers and arrays."""
    found = {}
    for name in names:
        for used in _names(getattr(type(model), name).__code__):
            value = np.asarray(getattr(model, used, None))
            if value.dtype.kind in "biuf":
                found[used] = value.astype({"f": float, "b": bool}.get(value.dtype.kind, np.int64))
    found = found or {"nothing": np.zeros(())}
    values = np.zeros(1, np.dtype([(name, value.dtype, value.shape) for name, value in found.items()], align=True))
    for name, value in found.items():
        values[name][0] = value
    return values


def _names(code):
    """Names that a function uses, with those of functions within it."""
    return dict.fromkeys(
        [*code.co_names, *(name for inner in code.co_consts if isinstance(inner, python_types.CodeType) for name in _names(inner))]
    )


def _c_function(model, name, own):
    return _kept(getattr(type(model), name), name, own, model.n, model.m)


def _made(function, name, own, n, m):
    """A C function of the signature of a table's, for arguments (self, 0, t, q, v, a, lam, out)."""
    given, label = list(signature(function).parameters)[1:], function.__qualname__
    sizes = {"n": n, "m": m}
    shape = tuple(sizes[letter] for letter in SHAPES[name])
    kinds = (own, *(types.float64 if argument == "t" else NUMBERS for argument in given))
    inner = numba.njit(error_model="numpy")(_with_compiled_globals(function))
    try:
        inner.compile(kinds)
    except (NumbaError, KeyError) as error:
        text = " ".join(str(error).split()) if isinstance(error, NumbaError) else f"self.{error.args[0]} is neither a number nor an array"
        raise InputError(
            f"{label} cannot be compiled by numba: {text:.600}; leave out @polyida.compiled, or write it as numba wants"
        ) from None
    found = inner.overloads[kinds].signature.return_type
    if not shape and isinstance(found, types.Float | types.Integer):
        return _c_entry(inner, own, given, sizes, "", "filled = carray(pointer(out), (1,))\n    filled[0] = found")
    if not shape:
        raise InputError(f"{label} must return a number, not {found}")
    if not (isinstance(found, types.Array) and found.ndim == len(shape) and isinstance(found.dtype, types.Float | types.Integer)):
        raise InputError(f"{label} must return an array of {len(shape)} dimension{'s' * (len(shape) > 1)} of real numbers, not {found}")
    checked = f"if found.shape != {shape}:\n        return WRONG_SHAPE\n    "
    return _c_entry(inner, own, given, sizes, checked, f"filled = carray(pointer(out), {shape})\n    filled[...] = found")


def _c_entry(inner, own, given, sizes, checked, filled):
    """The C function around a compiled one."""
    places = {
        "t": "carray(pointer(t), (1,))[0]",
        **{x: f"carray(pointer({x}), ({sizes[s]},))" for x, s in zip(("q", "v", "a", "lam"), "nnnm")},
    }
    source = f"""def called(data, instant, t, q, v, a, lam, out):
    own = carray(record(data), (1,))[0]
    try:
        found = inner(own, {", ".join(places[argument] for argument in given)})
    except Exception:
        return RAISED
    {checked}{filled}
    return DONE
"""
    made: dict = {}
    names = {"carray": carray, "pointer": pointer, "record": _record_pointer(own), "inner": inner}
    exec(source, names | {"RAISED": RAISED, "WRONG_SHAPE": WRONG_SHAPE, "DONE": DONE}, made)
    return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy")(made["called"])


_kept = cache(_made)  # a class is compiled once for models of one shape


@cache
def _record_pointer(own):
    """A function of compiled code: an address as a pointer to records."""
    from numba.extending import intrinsic

    @intrinsic
    def record(typing, number):
        def make(context, builder, sig, args):
            return builder.inttoptr(args[0], context.get_value_type(types.CPointer(own)))

        return types.CPointer(own)(types.int64), make

    return record


def _with_compiled_globals(function, known=None):
    """The function with plain functions of its module compiled too."""
    known = {} if known is None else known
    if function in known:
        return known[function]
    names = function.__globals__
    own = dict(names)
    made = python_types.FunctionType(function.__code__, own, function.__name__, function.__defaults__, function.__closure__)
    known[function] = made
    for name in _names(function.__code__):
        value = names.get(name)
        if isinstance(value, python_types.FunctionType):
            own[name] = numba.njit(error_model="numpy")(_with_compiled_globals(value, known))
    return made
