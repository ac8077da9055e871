"""Functions of users as machine code: the decorator `polyida.compiled`, and C functions that compiled code calls by address.

Each C function has the signature `int64 f(int64 data, int64 instant, int64 x 6)` of a model's table (polyida.system). `data` is the address
of the values that the function reads from `self`: numbers and arrays as words of one block, profiles as their values at the time of the call.
The last argument is the address of the result.
"""

import ctypes
import hashlib
import math
import re
from contextlib import suppress
from functools import cache, update_wrapper
from types import CellType, CodeType, FunctionType
from typing import Any

import numba
import numpy as np
from numba import NumbaError, TypingError, carray, types
from numba.extending import intrinsic

from polyida.clock import loading
from polyida.errors import DONE, RAISED, WRONG_SHAPE, InputError
from polyida.fingerprint import is_dispatcher, machine_code_fingerprint, of_polyida
from polyida.jit import c_address, own_address, own_part, part
from polyida.jit import cache as kernel_cache
from polyida.jit.intrinsics import ARGUMENTS, integers, pointer, real
from polyida.validation import named_keywords

CALLBACK = ctypes.CFUNCTYPE(*[ctypes.c_int64] * (ARGUMENTS + 1))
SIGNATURE = types.int64(*[types.int64] * ARGUMENTS)
_converted: dict = {}  # {(function, its mark): the function that numba compiles}


@part
def fill_vector(out, found, factor):
    """out = factor * found. numba compiles loops in a fraction of the time of an assignment of arrays."""
    for i in range(out.shape[0]):
        out[i] = factor * found[i]


@part
def fill_matrix(out, found, factor):
    """out = factor * found for matrices of the same shape."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = factor * found[i, j]


FILL = "", "fill_vector", "fill_matrix"  # by the dimensions of the result


@cache
def table_address(function, kind):
    """The address, an integer, of a compiled entry `f(workspace, 7 numbers or addresses)` as a C function.

    kind: numba type of the workspace.
    """
    return c_address(function, types.int64(kind, *[types.int64] * (ARGUMENTS - 1)))


@named_keywords
def compiled(given: Any) -> Any:
    """Decorator: numba compiles the functions of a Model, ForceElement or Body, or one function, and steps call no Python of them.

    Parameters
    ----------
    given : type or callable
        A subclass of Model, ForceElement or Body, or a function.

    Returns
    -------
    type or callable
        The class itself, or an object that is called like the function.

    Raises
    ------
    InputError
        If `given` is anything else. Also when a run begins or a scene is built, if numba cannot compile a function, or if its result is
        no real array of the right dimension; the message names the function.

    Notes
    -----
    The functions are plain numpy code, as far as numba compiles it. They read numbers, arrays, profiles (`self.profile(t)`) and compiled
    functions from `self`, with the values at the start of a run. They may call functions of their module, but not each other through
    `self`. Missing derivatives are differences, formed in compiled code; derivatives that a ForceElement or a Body writes serve Python only.
    If a function raises, or returns an array of another shape, the run ends at that time. Profiles, `until`, sensors and functions of state
    take a compiled function in place of a plain one. The machine code is kept on disk; it is compiled again if the functions change, or a
    value or function that they name. With scenes, and with models of up to 50 coordinates and constraints, GeneralizedAlpha, RadauIIA and
    EnergyMomentum call no Python in a step. With larger models only the functions are compiled. IDA calls Python once an iteration.
    """
    if isinstance(given, type) and hasattr(given, "by_numba"):
        given.by_numba = True
        return given
    if isinstance(given, FunctionType):
        return CompiledFunction(given)
    raise InputError(f"compiled: {given!r:.100} must be a function, or a subclass of polyida.Model, ForceElement or Body")


class CompiledFunction:
    """A function that Python calls unchanged; compiled code gets its machine code from `for_numba`."""

    def __init__(self, function):
        """Take the Python function, its name and its docstring."""
        update_wrapper(self, function)
        self.function = function

    def __call__(self, *arguments):
        """Call the Python function and return its result."""
        return self.function(*arguments)

    def __reduce__(self):
        """Pickle the function by its qualified name in its module."""
        return self.__qualname__


def is_compiled(function):
    """True if a function is compiled by `compiled` or numba.njit."""
    return isinstance(function, CompiledFunction) or is_dispatcher(function)


def for_numba(original):
    """A function in the form that numba compiles; the functions that it names are converted too. An index out of bounds raises.

    The values that the function names are read anew for each mark, even if numba has compiled the function before.
    """
    if is_dispatcher(original) and not _is_function(original):
        return original
    key = original, machine_code_fingerprint(original)
    if key not in _converted:
        function = original.function if isinstance(original, CompiledFunction) else getattr(original, "py_func", original)
        names, cells = dict(function.__globals__), [CellType(cell.cell_contents) for cell in function.__closure__ or ()]
        names["__name__"] = __name__  # cached code imports its module: the module of the function may be missing in another process
        copy = FunctionType(function.__code__, names, function.__name__, function.__defaults__, tuple(cells))
        copy.__kwdefaults__ = function.__kwdefaults__
        _converted[key] = numba.jit(**original.targetoptions)(copy) if is_dispatcher(original) else own_part(copy, not of_polyida(function))
        for name in names_of(function.__code__):
            if _is_function(value := names.get(name)):
                names[name] = for_numba(value)
        for cell in cells:
            if _is_function(cell.cell_contents):
                cell.cell_contents = for_numba(cell.cell_contents)
    return _converted[key]


def _is_function(value):
    """True for what `for_numba` converts: a Python function, a CompiledFunction, or a user's function of numba.njit without fixed types."""
    return isinstance(value, FunctionType | CompiledFunction) or is_dispatcher(value) and not of_polyida(value) and value._can_compile


def names_of(code):
    """Names in the code of a function and of the functions defined inside it."""
    inner = (name for inner in code.co_consts if isinstance(inner, CodeType) for name in names_of(inner))
    return dict.fromkeys([*code.co_names, *inner])


@loading
def c_function_of(label, inner, mark, source, names, dimensions, of_complex=False):
    """Compile the C function `called` of a source that calls `inner`; return its address. Raises InputError.

    mark: identifies all that the machine code depends on besides the source, for the cache on disk; None if this is unknown.
    dimensions: of the array that `inner` must return; 0 for a number.
    """
    kinds, wrong = (types.Float, types.Integer, types.Complex)[: 3 if of_complex else 2], []

    @intrinsic
    def require_result(typing, result):
        """Raise TypingError while compiling if the result has another type; it does nothing in machine code."""
        number = result.dtype if isinstance(result, types.Array) and result.ndim == dimensions > 0 else result
        if not isinstance(number, kinds) or (number is result) == (dimensions > 0):
            wrong.append(result)
            raise TypingError("a wrong result")
        return types.none(result), lambda context, builder, sig, args: context.get_dummy_value()

    names |= {"__name__": __name__, "np": np, "carray": carray, "pointer": pointer, "integers": integers, "real": real, "frozen": frozen}
    names |= {"inner": inner, "require_result": require_result, "fill_vector": fill_vector, "fill_matrix": fill_matrix}
    digest = hashlib.sha256(f"{mark} {dimensions} {of_complex} {source}".encode()).hexdigest()[:32]
    kernel_cache.remove_old_own(__name__.rpartition(".")[2])

    def address_of(source, name, cached):
        """Address of the function `called` of a source, under a name by which its machine code is cached."""
        exec(source, names)
        called = names["called"]
        called.__code__ = called.__code__.replace(co_filename=__file__)  # numba compares the time of this file, not of the user's
        called.__qualname__ = name
        return own_address(called, SIGNATURE, cached)

    try:
        return address_of(source, digest, mark is not None)
    except Exception as error:  # noqa: BLE001 numba raises more than NumbaError, AssertionError and AttributeError for example
        if wrong:
            number = "complex" if of_complex else "real"
            array = f"an array of {dimensions} dimension{'s' * (dimensions > 1)} of {number} numbers" if dimensions else "a number"
            raise InputError(f"{label} must return {array}, not {wrong[0]}") from None
        writes = None
        with suppress(Exception):  # a function that compiles if its arguments are not read-only writes into them
            writes = address_of(source.replace("frozen(", "("), f"{digest} writable", False)
        if writes:
            raise InputError(f"{label} writes into its arguments, or into arrays of self; take a copy first") from None
        kind = "" if isinstance(error, NumbaError) else f"{type(error).__name__}: "
        # numba's text goes on with the place of each call, down to the C function
        text = re.sub(r"Failed in \w+ mode pipeline \(step: nopython frontend\)", "", str(error)).partition("\nDuring:")[0]
        advice = "leave out @polyida.compiled, or rewrite the function so that numba compiles it"
        raise InputError(f"{label} cannot be compiled by numba: {kind}{' '.join(text.split()):.600}; {advice}") from None


def argument_of(at, shape=(), of_complex=False):
    """Source text for the array, or the number, at an address."""
    if not shape:
        return f"real({at})"
    view = f"carray(pointer({at}), ({2 * shape[0]},)).view(np.complex128)" if of_complex else f"carray(pointer({at}), {shape})"
    return f"frozen({view})"


@cache
def _row_function(label, function, dimensions, shape):
    """A C function that evaluates a compiled function of numbers and vectors on row k of each of its arrays, k < count.

    label: begins its name. dimensions: of each array, 1 or 2: a row is a number or a vector. shape: of the result, () for a number. Row k
    of the array `out` of the C function, (count, size of the result), is overwritten.
    """
    rows = [f"frozen(carray(pointer(given[{2 * k + 1}]), (count{f', given[{2 * k}]' if d > 1 else ''})))" for k, d in enumerate(dimensions)]
    check = f"if found.shape != {shape}:\n                return {WRONG_SHAPE}" if shape else ""
    store = f"{FILL[len(shape)]}(filled[k].reshape({shape}), found, 1.0)" if shape else "filled[k, 0] = found"
    source = f"""def called(at, count, a, b, c, d, e, out):
    given = carray(integers(at), ({2 * len(dimensions)},))
    rows, filled = ({", ".join(rows)},), carray(pointer(out), (count, {math.prod(shape)}))
    try:
        for k in range(count):
            found = inner({", ".join(f"rows[{k}][k]" for k in range(len(dimensions)))})
            require_result(found)
            {check}
            {store}
    except Exception:
        return {RAISED}
    return {DONE}
"""
    mark, name = machine_code_fingerprint(function), f"{label} {function.__name__}"
    return CALLBACK(c_function_of(name, for_numba(function), mark, source, {}, len(shape)))


def over(label, function, *arrays, shape=()):
    """Values, of a shape, of a compiled function at each row of arrays: (rows, numbers). None if it is not compiled, or raises.

    Raises InputError if numba does not compile it.
    """
    if not is_compiled(function):
        return None
    arrays, values = [np.ascontiguousarray(x) for x in arrays], np.empty((len(arrays[0]), math.prod(shape)))
    fill = _row_function(label, function, tuple(x.ndim for x in arrays), shape)
    at = np.array([number for x in arrays for number in (x.size // max(1, len(x)), x.ctypes.data)], np.int64)
    return values if fill(at.ctypes.data, len(values), 0, 0, 0, 0, 0, values.ctypes.data) == DONE else None


@intrinsic
def frozen(typing, array):
    """Return the array with a read-only type, without a copy: code that writes into it does not compile."""
    return array.copy(readonly=True)(array), lambda context, builder, sig, args: args[0]
