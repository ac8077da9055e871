"""Functions of a class, a user's or polyida's own, as C functions: compiled code calls them by their addresses, and no Python is in a step.

Each has the signature `int64 f(int64 data, int64 instant, int64 x 6)`, as of a model's table. data is the address of what the function reads
of `self`: numbers and arrays are words of one block, profiles their values at the time of the call. The last argument is the address of its result.
"""

import types as python_types
from collections import namedtuple
from functools import cache
from inspect import signature

import numpy as np
from numba import types
from numba.extending import intrinsic, lower_builtin, models, overload_method, register_model

from polyida.errors import DONE, RAISED, WRONG_SHAPE, InputError
from polyida.jit.compiled import for_numba, is_compiled, names_of
from polyida.jit.own_functions import argument_of, c_function_of
from polyida.mark import machine_mark_of
from polyida.profile import Profile

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


@cache
def _made(function, mark, source, fields, functions, dimensions, of_complex):
    """The address of the C function, compiled once for data of one form."""
    Own = namedtuple("self", [f"f{k}" for k in range(len(fields) or 1)])
    Own._fields = fields or Own._fields  # whose names may begin with an underscore
    names = {f"function{k}": for_numba(one) for k, one in enumerate(functions)} | {"Own": Own, "profile": as_profile}
    return c_function_of(function.__qualname__, for_numba(function), (mark, fields), source, names, dimensions, of_complex)


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
