"""The values that users' compiled functions read from `self`: numbers, arrays, profiles and other compiled functions.

A C function of `function(self, ...)` gets the address of these values, as float64 words of one block; a profile is its value at the time of
the call (`polyida.jit.user_functions`).
"""

import re
from collections import namedtuple
from functools import cache, cached_property
from inspect import signature
from types import FunctionType

import numpy as np
from numba import types
from numba.extending import intrinsic, lower_builtin, models, overload_method, register_model

from polyida.errors import DONE, RAISED, WRONG_SHAPE, InputError
from polyida.fingerprint import machine_code_fingerprint
from polyida.jit.user_functions import FILL, argument_of, c_function_of, for_numba, is_compiled, names_of
from polyida.profile import Profile

DTYPES = {
    "b": np.bool_,
    "i": np.int64,
    "u": np.int64,
    "f": np.float64,
    "c": np.complex128,
}  # how values of self are stored, by numpy's kind


def _names_read(function, visited):
    """Names in a function and in the functions of its module that it calls."""
    visited.add(function)
    for name in names_of(function.__code__):
        yield name
        called = function.__globals__.get(name)
        if isinstance(called, FunctionType) and called not in visited:
            yield from _names_read(called, visited)


class OwnData:
    """The values that functions read from an object, the owner, as `self`.

    words: the values as float64 words, to be read when all are added. profiles: [(index of the word of its value, Profile)]. python: True if a
    field is a Python function.
    """

    def __init__(self, owner, functions, helpers=()):
        """Find the fields that the functions read from the owner, and those of functions that they call."""
        self.owner, self.python, self.fields, self.functions, self.profiles, self._words = owner, False, {}, [], [], []
        self.helpers = helpers  # (name, compiled function) that source texts call
        for name in dict.fromkeys(name for function in functions for name in _names_read(function, set())):
            value = getattr(owner, name, None)
            if name in getattr(owner, "__dict__", ()) or not callable(value):
                if (field := self._field(value)) is not None:
                    self.fields[name] = field
                elif callable(value):
                    self.python = True

    @cached_property
    def words(self):
        """The stored values as an array of float64 words, (words,), of which there is at least one."""
        return np.frombuffer(b"".join(self._words) or bytes(8)).copy()

    def _field(self, value):
        """Source text of a field of self; None if machine code cannot hold it."""
        if is_compiled(value):
            self.functions.append(value)
            return f"function{len(self.functions) - 1}"
        if isinstance(value, Profile):
            self.profiles.append((len(self._words), value))
            return f"profile(({self.view(np.zeros(()))}, real(t)))"
        if isinstance(value, tuple | list) and any(isinstance(one, Profile) for one in value):
            fields = [self._field(one) for one in value]
            return None if None in fields else f"({', '.join(fields)},)"
        try:
            array = np.asarray(value)
        except ValueError:
            return None
        return self.view(array.astype(DTYPES[array.dtype.kind])) if array.dtype.kind in DTYPES else None

    def view(self, array):
        """Append the words of an array; source text of the array, or of the number."""
        at, content = f"data + {8 * len(self._words)}", array.tobytes()
        content += bytes(-len(content) % 8)
        self._words += [content[k : k + 8] for k in range(0, len(content), 8)]
        if array.dtype == float:
            return argument_of(at, array.shape)
        words = f"carray(pointer({at}), ({max(1, len(content) // 8)},)).view(np.{array.dtype})"
        return f"frozen({words}[:{array.size}].reshape({array.shape}))" if array.ndim else f"{words}[0]"

    def c_function(self, function, arguments, shape, factor=1.0, of_complex=False, store="", other=None):
        """The address of the C function of `function(self, ...)`. Raises InputError.

        arguments: {argument: (its name in `data, instant, t, b, c, d, e, out`, its shape, True if it is complex), or its source text}. shape: of
        the result, () of a number. factor: of the stored result. store: source text that stores `found`, and `also`, the value of another function `other(self, ...)`.
        """

        def listed(function):
            """Source text of the arguments of a call of a function. Raises InputError for an argument that is not known."""
            used = list(signature(function).parameters)[1:]
            if wrong := [name for name in used if name not in arguments]:
                raise InputError(f"{function.__qualname__}: its arguments must be (self, {', '.join(arguments)}), not {wrong[0]!r}")
            texts = [text if isinstance(text := arguments[name], str) else argument_of(*text) for name in used]
            return f"Own({', '.join(self.fields.values()) or '0.0'}), {', '.join(texts)}"

        out = argument_of("out", shape or (1,), of_complex).removeprefix("frozen")
        check = f"if found.shape != {shape}:\n        return {WRONG_SHAPE}\n    " if shape else ""
        source = f"""def called(data, instant, t, b, c, d, e, out):
    try:
        found = inner({listed(function)})
        {f"also = other({listed(other)})" if other else ""}
    except Exception:
        return {RAISED}
    require_result(found)
    {check}{store or (f"{FILL[len(shape)]}({out}, found, {factor})" if shape else f"{out}[0] = found")}
    return {DONE}
"""
        mark = machine_code_fingerprint(*filter(None, (function, other)), *self.functions)
        try:
            return _c_function(
                function, other, mark, source, tuple(self.fields), tuple(self.functions), len(shape), of_complex, self.helpers
            )
        except InputError as error:
            if not (unknown := re.search(r"Unknown attribute '(\w+)' of type self\(", str(error.__context__))):
                raise
            name, owner = unknown[1], self.owner
            reason = f"`self.{name}` cannot be read in compiled code; numbers, arrays, profiles and compiled functions can"
            if not hasattr(owner, name):
                reason = f"{type(owner).__name__} has no field `{name}`; its fields: {', '.join(getattr(owner, '__dict__', ())) or 'none'}"
            raise InputError(f"{function.__qualname__}: {reason}") from None


@cache
def _c_function(function, other, mark, source, fields, functions, dimensions, of_complex, helpers):
    """Address of the C function that calls `function` with data of an owner, compiled once for each form of data."""
    Own = namedtuple("self", [f"f{k}" for k in range(len(fields) or 1)])
    Own._fields = fields or Own._fields  # namedtuple itself refuses names that begin with an underscore
    names = {f"function{k}": for_numba(one) for k, one in enumerate(functions)} | {"Own": Own, "profile": as_profile}
    names |= ({"other": for_numba(other)} if other else {}) | dict(helpers)
    return c_function_of(function.__qualname__, for_numba(function), (mark, fields), source, names, dimensions, of_complex)


class ProfileType(types.Type):
    """A profile in compiled code: its value at one time, and that time."""

    def __init__(self):
        """Make the numba type, whose only name is "Profile"."""
        super().__init__("Profile")


PROFILE, PAIR = ProfileType(), types.UniTuple(types.float64, 2)


@register_model(ProfileType)
class _ProfileModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        """Take numba's data model manager and the type; a profile is stored like a pair of floats."""
        super().__init__(manager, kind, manager.lookup(PAIR).get_value_type())


@intrinsic
def as_profile(typing, pair):
    """Take a pair (value, time) of floats as a profile in compiled code."""
    return PROFILE(PAIR), lambda context, builder, sig, args: args[0]


@intrinsic
def as_pair(typing, profile):
    """Take a profile in compiled code as the pair (value, time)."""
    return PAIR(PROFILE), lambda context, builder, sig, args: args[0]


def _value_at(profile, t):
    """The value of a profile at its own time; numba raises for any other."""
    value, time = as_pair(profile)
    if t != time:
        raise ValueError("a compiled function may call a profile at its own time t only")
    return value


overload_method(ProfileType, "value")(lambda profile, t: _value_at)
overload_method(ProfileType, "__call__")(lambda profile, t: _value_at)
lower_builtin(PROFILE, ProfileType, types.Float)(
    lambda context, builder, sig, args: context.compile_internal(builder, _value_at, sig, args)
)
