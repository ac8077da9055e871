"""C functions of the functions of users: compiled once, kept between processes, and called row by row.

Each has the signature `int64 f(int64 data, int64 instant, int64 x 6)`, as of a model's table.
"""

import ctypes
import hashlib
import math
from functools import cache

import numpy as np
from numba import NumbaError, TypingError, carray, types
from numba.extending import intrinsic

from polyida.errors import DONE, RAISED, WRONG_SHAPE, InputError
from polyida.jit import cache as kernel_cache
from polyida.jit import own_address
from polyida.jit.compiled import for_numba, is_compiled
from polyida.jit.intrinsics import integers, pointer, real
from polyida.mark import machine_mark_of

ARGUMENTS = 8
CALLBACK = ctypes.CFUNCTYPE(*[ctypes.c_int64] * (ARGUMENTS + 1))
SIGNATURE = types.int64(*[types.int64] * ARGUMENTS)


def argument_of(at, shape=(), of_complex=False):
    """The array, or the number, at an address, in a C function's source."""
    if not shape:
        return f"real({at})"
    view = f"carray(pointer({at}), ({2 * shape[0]},)).view(np.complex128)" if of_complex else f"carray(pointer({at}), {shape})"
    return f"frozen({view})"


def c_function_of(label, inner, mark, source, names, dimensions, of_complex=False):
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
    return CALLBACK(c_function_of(name, for_numba(function), mark, source, {}, len(shape)))


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
