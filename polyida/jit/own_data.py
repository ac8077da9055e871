"""Functions of a class, a user's or polyida's own, as C functions: compiled code calls them by their addresses, and no Python is in a step.

Each has the signature `int64 f(int64 data, int64 instant, int64 x 6)`, as of a model's table. data is the address of what the function reads
of `self`: numbers and arrays are words of one block, profiles their values at the time of the call. The last argument is the address of its result.
"""

import ctypes
import hashlib
import math
import types as python_types
from collections import namedtuple
from functools import cache
from inspect import signature

import numpy as np
from numba import NumbaError, TypingError, carray, types
from numba.extending import intrinsic, lower_builtin, models, overload_method, register_model

from polyida.errors import DONE, RAISED, WRONG_SHAPE, InputError
from polyida.jit import cache as kernel_cache
from polyida.jit import own_address
from polyida.jit.compiled import for_numba, is_compiled, names_of
from polyida.jit.intrinsics import integers, pointer, real
from polyida.mark import machine_mark_of
from polyida.profile import Profile

ARGUMENTS = 8
CALLBACK = ctypes.CFUNCTYPE(*[ctypes.c_int64] * (ARGUMENTS + 1))
SIGNATURE = types.int64(*[types.int64] * ARGUMENTS)
KINDS = {"b": np.bool_, "i": np.int64, "u": np.int64, "f": np.float64, "c": np.complex128}


def _read(function, seen):
    """Names that a function uses, with those of functions of its module that it calls."""
    seen.add(function)
    for name in names_of(function.__code__):
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
        if is_compiled(value):
            self.functions.append(value)
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
        """The address of the C function of `function(self, ...)`.

        given: {argument: (its name in `data, instant, t, b, c, d, e, out`, its shape, whether it is complex)}. shape: of what it
        returns, () of a number. Raises InputError.
        """
        arguments = list(signature(function).parameters)[1:]
        if wrong := [name for name in arguments if name not in given]:
            raise InputError(f"{function.__qualname__}: its arguments must be (self, {', '.join(given)}), not {wrong[0]!r}")
        listed = "".join(f"{argument_of(*given[name])}, " for name in arguments)
        out = argument_of("out", shape or (1,), of_complex).removeprefix("frozen")
        own = ", ".join(self.fields.values()) or "0.0"
        check = f"if found.shape != {shape}:\n        return {WRONG_SHAPE}\n    " if shape else ""
        source = f"""def called(data, instant, t, b, c, d, e, out):
    try:
        found = inner(Own({own}), {listed})
    except Exception:
        return {RAISED}
    require_result(found)
    {check}{out}[...] = {result}
    return {DONE}
"""
        mark = machine_mark_of(function, *self.functions)
        return _made(function, mark, source, tuple(self.fields), tuple(self.functions), len(shape), of_complex)


def argument_of(at, shape=(), of_complex=False):
    """The array, or the number, at an address, in a C function's source."""
    if not shape:
        return f"real({at})"
    view = f"carray(pointer({at}), ({2 * shape[0]},)).view(np.complex128)" if of_complex else f"carray(pointer({at}), {shape})"
    return f"frozen({view})"


@cache
def _made(function, mark, source, fields, functions, dimensions, of_complex):
    """The address of the C function, compiled once for data of one form."""
    Own = namedtuple("self", [f"f{k}" for k in range(len(fields) or 1)])
    Own._fields = fields or Own._fields  # whose names may begin with an underscore
    names = {f"function{k}": for_numba(one) for k, one in enumerate(functions)} | {"Own": Own, "profile": as_profile}
    return _address(function.__qualname__, for_numba(function), (mark, fields), source, names, dimensions, of_complex)


def _address(label, inner, mark, source, names, dimensions, of_complex=False):
    """The address of the C function `called` of a source that calls `inner`, whose mark tells all that the source does not, or is None."""
    names |= {"__name__": __name__, "np": np, "carray": carray, "pointer": pointer, "integers": integers, "real": real, "frozen": frozen}
    result = Result(dimensions, of_complex)
    exec(source, names | {"inner": inner, "require_result": result.required()}, names)
    called, digest = names["called"], hashlib.sha256(f"{mark} {dimensions} {of_complex} {source}".encode()).hexdigest()[:32]
    called.__code__ = called.__code__.replace(co_filename=__file__)  # not that of the function, whose time numba looks at
    called.__qualname__ = digest
    kernel_cache.remove_old_own(__name__.rpartition(".")[2])
    try:
        return own_address(called, SIGNATURE, mark is not None)
    except NumbaError as error:
        raise InputError(f"{label} {result.told(error)}") from None


class Result:
    """What a function must return: a number, or an array of so many dimensions."""

    def __init__(self, dimensions, of_complex):
        self.dimensions, self.wrong, self.what = dimensions, [], "complex" if of_complex else "real"
        self.kinds = (types.Float, types.Integer, types.Complex) if of_complex else (types.Float, types.Integer)

    def required(self):
        """A function of compiled code that takes nothing else."""

        @intrinsic
        def require_result(typing, found):
            number = found.dtype if isinstance(found, types.Array) and found.ndim == self.dimensions > 0 else found
            if not isinstance(number, self.kinds) or (number is found) == (self.dimensions > 0):
                self.wrong.append(found)
                raise TypingError("a wrong result")
            return types.none(found), lambda context, builder, sig, args: context.get_dummy_value()

        return require_result

    def told(self, error):
        """An error of numba in words."""
        if self.wrong:
            array = f"an array of {self.dimensions} dimension{'s' * (self.dimensions > 1)} of {self.what} numbers"
            return f"must return {array if self.dimensions else 'a number'}, not {self.wrong[0]}"
        text = " ".join(str(error).replace("Failed in nopython mode pipeline (step: nopython frontend)", "").split())
        return f"cannot be compiled by numba: {text:.600}; leave out @polyida.compiled, or write it as numba wants"


@cache
def _filling(label, function, dimensions, shape):
    """A C function that fills row after row of an array with what a compiled function gives of rows: its address, or None if it is Python."""
    rows = [f"frozen(carray(pointer(given[{2 * k + 1}]), (count{f', given[{2 * k}]' if d > 1 else ''})))" for k, d in enumerate(dimensions)]
    check = f"if found.shape != {shape}:\n                return {WRONG_SHAPE}" if shape else ""
    source = f"""def called(at, count, a, b, c, d, e, out):
    given = carray(integers(at), ({2 * len(dimensions)},))
    rows, filled = ({", ".join(rows)},), carray(pointer(out), (count, {math.prod(shape)}))
    try:
        for k in range(count):
            found = inner({", ".join(f"rows[{k}][k]" for k in range(len(dimensions)))})
            require_result(found)
            {check}
            filled[k] = {"found.ravel()" if shape else "found"}
    except Exception:
        return {RAISED}
    return {DONE}
"""
    mark, name = machine_mark_of(function), f"{label} {function.__name__}"
    return CALLBACK(_address(name, for_numba(function), mark, source, {}, len(shape)))


def over(label, function, *given, shape=()):
    """What a compiled function gives, of a shape, at each of the rows of arrays, (rows, numbers); None if it is Python, or raises.

    Raises InputError where numba does not compile it.
    """
    if not is_compiled(function):
        return None
    given, found = [np.ascontiguousarray(x) for x in given], np.empty((len(given[0]), math.prod(shape)))
    fill = _filling(label, function, tuple(x.ndim for x in given), shape)
    at = np.array([number for x in given for number in (x.size // max(1, len(x)), x.ctypes.data)], np.int64)
    ended = fill(at.ctypes.data, len(found), 0, 0, 0, 0, 0, found.ctypes.data)
    return found if ended == DONE else None


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
