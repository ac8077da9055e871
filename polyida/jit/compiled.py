"""Functions of users, and of polyida's force elements, as C functions: compiled code calls them by their addresses, and no Python is in a step.

Each has the signature `int64 f(int64 data, int64 instant, int64 x 6)`, as of a model's table. data is the address of what the function reads
of `self`; the last argument that of its result.
"""

import hashlib
import math
import types as python_types
from collections import namedtuple
from functools import cache, cached_property, update_wrapper
from inspect import signature
from typing import Any

import numba
import numpy as np
from numba import NumbaError, carray, types
from numba.extending import intrinsic, lower_builtin, models, overload_method, register_model

from polyida.errors import InputError
from polyida.given import read_only
from polyida.jit import cache as kernel_cache
from polyida.jit.intrinsics import pointer, real
from polyida.keywords import named_keywords
from polyida.profile import Profile

ARGUMENTS = 8
DONE, RAISED, WRONG_SHAPE = 0, 8, 9  # as in system/table.py
SIGNATURE = types.int64(*[types.int64] * ARGUMENTS)
KINDS = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64, "c": np.complex128}


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
        for name in _names(function.__code__):
            if isinstance(value := own.get(name), python_types.FunctionType):
                own[name] = for_numba(value, known)
            elif isinstance(value, CompiledFunction):
                own[name] = value.dispatcher
    return known[function]


def _names(code):
    """Names that a function uses, with those of functions within it."""
    inner = (name for inner in code.co_consts if isinstance(inner, python_types.CodeType) for name in _names(inner))
    return dict.fromkeys([*code.co_names, *inner])


def _read(function, seen):
    """Names that a function uses, with those of functions of its module that it calls."""
    seen.add(function)
    for name in _names(function.__code__):
        yield name
        called = function.__globals__.get(name)
        if isinstance(called, python_types.FunctionType) and called not in seen:
            yield from _read(called, seen)


class OwnData:
    """What functions read of an object as self. words: of their data, float64; profiles: [(place of its value among them, Profile)].

    python: whether they use a function in Python that is among its fields.
    """

    def __init__(self, owner, functions):
        self.python, self.fields, self.functions, self.profiles, self._words = False, {}, [], [], []
        for name in dict.fromkeys(name for function in functions for name in _read(function, set())):
            value = getattr(owner, name, None)
            if name in getattr(owner, "__dict__", ()) or not callable(value):
                self._take(name, value)
        self.words = np.frombuffer(b"".join(self._words) or bytes(8)).copy()

    def _take(self, name, value):
        """A field of self, as an expression of the C function's source."""
        if (field := self._field(value)) is not None:
            self.fields[name] = field
        elif callable(value):
            self.python = True

    def _field(self, value):
        if function := dispatcher_of(value):
            self.functions.append(function)
            return f"function{len(self.functions) - 1}"
        if isinstance(value, Profile):
            self.profiles.append((len(self._words), value))
            return f"profile(({self._view(np.zeros(()))}, real(t)))"
        if isinstance(value, tuple | list) and any(isinstance(one, Profile) for one in value):
            fields = [self._field(one) for one in value]
            return None if None in fields else f"({', '.join(fields)},)"
        try:
            array = np.asarray(value)
        except ValueError:
            return None
        return self._view(array.astype(KINDS[array.dtype.kind])) if array.dtype.kind in KINDS else None

    def _view(self, array):
        """The words of an array, as an array or a number."""
        at, content = f"data + {8 * len(self._words)}", array.tobytes()
        content += bytes(-len(content) % 8)
        self._words += [content[k : k + 8] for k in range(0, len(content), 8)]
        if array.dtype == float:
            return f"frozen(carray(pointer({at}), {array.shape}))" if array.ndim else f"real({at})"
        words = f"carray(pointer({at}), ({max(1, len(content) // 8)},)).view(np.{array.dtype})"
        return f"frozen({words}[:{array.size}].reshape({array.shape}))" if array.ndim else f"{words}[0]"

    def c_function(self, function, given, shape, result="found", of_complex=False):
        """The C function of `function(self, ...)`.

        given: {argument: (its name in `data, instant, t, b, c, d, e, out`, its shape, whether it is complex)}. shape: of what it
        returns, () of a number. Raises InputError.
        """
        arguments = list(signature(function).parameters)[1:]
        if wrong := [name for name in arguments if name not in given]:
            raise InputError(f"{function.__qualname__}: its arguments must be (self, {', '.join(given)}), not {wrong[0]!r}")
        listed = "".join(f"{argument_of(*given[name])}, " for name in arguments)
        out = argument_of("out", shape or (1,), of_complex).removeprefix("frozen")
        own = ", ".join(self.fields.values()) or "0.0"
        call = f"inner(Own({own}), {listed})"
        check = f"if found.shape != {shape}:\n        return {WRONG_SHAPE}\n    " if shape else ""
        source = f"""def read(data, t, b, c, d, e):
    return {call}
def called(data, instant, t, b, c, d, e, out):
    try:
        found = read(data, t, b, c, d, e)
    except Exception:
        return {RAISED}
    {check}{out}[...] = {result}
    return {DONE}
"""
        return _made(function, source, tuple(self.fields), tuple(self.functions), len(shape), of_complex)


def argument_of(at, shape=(), of_complex=False):
    """The array, or the number, at an address, in a C function's source."""
    if not shape:
        return f"real({at})"
    view = f"carray(pointer({at}), ({2 * shape[0]},)).view(np.complex128)" if of_complex else f"carray(pointer({at}), {shape})"
    return f"frozen({view})"


@cache
def _made(function, source, fields, functions, dimensions, of_complex):
    """The C function, compiled once for data of one form."""
    Own = namedtuple("self", [f"f{k}" for k in range(len(fields) or 1)])
    Own._fields = fields or Own._fields  # whose names may begin with an underscore
    names: dict = {
        "__name__": function.__module__,
        "carray": carray,
        "pointer": pointer,
        "real": real,
        "frozen": frozen,
        "profile": as_profile,
        "np": np,
        "Own": Own,
    }
    names |= {f"function{k}": one for k, one in enumerate(functions)} | {"inner": for_numba(function)}
    exec(source, names)
    read, called = names["read"], names["called"]
    names["read"] = numba.njit(error_model="numpy")(read)
    label, ours = function.__qualname__, function.__module__.startswith("polyida.") and not functions
    if not ours:
        _require_result(label, compiled_for(label, names["read"], *[types.int64] * (ARGUMENTS - 2)), dimensions, of_complex)
    at, digest = function.__code__, hashlib.sha256(source.encode()).hexdigest()[:16]
    called.__code__ = called.__code__.replace(co_filename=at.co_filename, co_firstlineno=at.co_firstlineno)
    called.__qualname__ = f"{label}.{digest}"
    with kernel_cache.kept() as cached:
        return numba.cfunc(SIGNATURE, nopython=True, error_model="numpy", cache=ours and cached)(called)


def _require_result(label, found, dimensions, of_complex):
    """Raise InputError unless a type is a number's, or an array's of so many dimensions."""
    kinds = (types.Float, types.Integer, types.Complex) if of_complex else (types.Float, types.Integer)
    if not dimensions and not isinstance(found, kinds):
        raise InputError(f"{label} must return a number, not {found}")
    if dimensions and not (isinstance(found, types.Array) and found.ndim == dimensions and isinstance(found.dtype, kinds)):
        what = "complex" if of_complex else "real"
        raise InputError(f"{label} must return an array of {dimensions} dimension{'s' * (dimensions > 1)} of {what} numbers, not {found}")


@intrinsic
def frozen(typing, array):
    """An array of somebody else's memory, to read only."""
    return array.copy(readonly=True)(array), lambda context, builder, sig, args: args[0]


class ProfileType(types.Type):
    """A profile in compiled code: its value at the one time that it is asked for, and that time."""

    def __init__(self):
        super().__init__("Profile")


PROFILE, PAIR = ProfileType(), types.UniTuple(types.float64, 2)


@register_model(ProfileType)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, manager.lookup(PAIR).get_value_type())


@intrinsic
def as_profile(typing, given):
    """(value, time) as a profile."""
    return PROFILE(PAIR), lambda context, builder, sig, args: args[0]


@intrinsic
def as_pair(typing, given):
    """A profile as (value, time)."""
    return PAIR(PROFILE), lambda context, builder, sig, args: args[0]


def _at(profile, t):
    value, time = as_pair(profile)
    if t != time:
        raise ValueError("compiled functions know profiles at the time t that they are given")
    return value


overload_method(ProfileType, "value")(lambda profile, t: _at)
overload_method(ProfileType, "__call__")(lambda profile, t: _at)
lower_builtin(PROFILE, ProfileType, types.Float)(lambda context, builder, sig, args: context.compile_internal(builder, _at, sig, args))


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
