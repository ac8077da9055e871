"""How compiled code is compiled: entry points, cached on disk, and the parts that they are made of.

All of it goes through numba's public decorators. With a numba of a version in TESTED, `jit/compilers.py` hands these a compiler that does
the same in less time (studies/start.py), by numba's inside. POLYIDA_PLAIN_NUMBA=1 in the environment leaves it out.
"""

import warnings
from functools import lru_cache, update_wrapper
from hashlib import sha256
from inspect import signature

import numba

from polyida.jit import cache as kernel_cache
from polyida.jit.pack import pack

__all__ = ["FAST", "bound", "c_address", "entry", "fast", "leaf", "own_address", "own_part", "pack", "part", "shared", "typed"]

TESTED = (0, 63), (0, 68)  # first and last version of numba that compilers.py is known to work with
FAST = {"contract", "reassoc", "nsz"}  # not "nnan": NaN must be found
_COMMON = {"nogil": True, "error_model": "numpy"}  # releases the GIL, divides by zero as numpy does
_INNER = _COMMON | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _optional():
    """The module of the faster compilers; None if it is not wanted or does not know this numba."""
    if kernel_cache.PLAIN or not TESTED[0] <= numba.version_info.short <= TESTED[1]:
        return None
    try:
        from polyida.jit import compilers
    except (ImportError, AttributeError):  # a numba that was changed within its version
        return None
    return compilers


compilers = _optional()
_parts = {"pipeline_class": compilers.PartCompiler} if compilers else {}


def entry(function, **options):
    """What Python calls: cached in `cache.folder()`. Compiled code that calls it takes it in as a part."""
    if compilers:
        inner = part(function, **options)
        return compilers.entry(_around(function, inner), inner, compilers.EntryCompiler, _COMMON | options)
    with kernel_cache.kept() as cached:
        return numba.njit(cache=cached, no_cfunc_wrapper=True, **_COMMON, **options)(function)


def shared(function, **options):
    """An entry that compiled code calls where it is: for what is large, and needed by several."""
    return (
        compilers.shared(_around(function, part(function, **options)), function, _COMMON | options)
        if compilers
        else entry(function, **options)
    )


def part(function, **options):
    """What only compiled code calls: cached within its callers. It has no wrapper for Python: a call from there crashes."""
    return numba.njit(**_INNER, **_parts, **options)(function)


def fast(function):
    """A part whose sums may be reordered, so that they are taken several numbers at once."""
    return part(function, fastmath=FAST)


def leaf(function):
    """A part that inner loops call with a scene's arrays: handing these over would cost more than the work."""
    return part(function, forceinline=True)


@lru_cache(None)
def c_address(inner, kinds):
    """The address of an entry or a part as a C function of a numba signature; cached like an entry."""
    outer = _around(inner.py_func, inner)
    if compilers:
        return compilers.c_address(outer, inner, kinds, _COMMON)
    outer.__qualname__ += sha256(repr(kinds).encode()).hexdigest()[:16]  # files of its own, see `cache.Files`
    with kernel_cache.kept() as cached:
        made = numba.cfunc(kinds, cache=cached, nopython=True, **_COMMON)(outer)
    _c_functions.append(made)
    return made.address


def own_part(function, boundscheck):
    """A part of a user's: numba compiles all that it knows of Python in it."""
    options = {"pipeline_class": compilers.OwnPartCompiler} if compilers else {}
    return numba.njit(**_INNER, boundscheck=boundscheck, **options)(function)


def own_address(function, kinds, kept):
    """The address of a function that calls own parts as a C function; kept: whether its name tells it from all others, for the files.

    Without the faster compilers it is compiled in each process: code that numba keeps prints arrays as nothing.
    """
    if compilers:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Cannot cache compiled function")  # it holds addresses of this process
            return compilers.c_address(function, None, kinds, _COMMON, compilers.OwnCompiler, kept)
    made = numba.cfunc(kinds, nopython=True, **_COMMON)(function)
    _c_functions.append(made)
    return made.address


_c_functions: list = []  # kept, for their addresses are in use


def bound(entry, *args):
    """The compiled function of an entry for arguments of these very types."""
    return entry.compile(tuple(map(numba.typeof, args)))


def typed(entry):
    """An entry for arguments whose types are those of its first call, and not looked at again: that costs as much as a small kernel."""
    compiled = None

    def call(*args):
        nonlocal compiled
        if compiled is None:
            compiled = bound(entry, *args)
        return compiled(*args)

    return call


def _around(function, inner):
    """A function that calls `inner`, with the name, the place and the arguments of `function`."""
    names, made, at = ", ".join(signature(function).parameters), {}, function.__code__
    exec(f"def outer({names}):\n    return inner({names})", {"inner": inner}, made)
    outer = update_wrapper(made["outer"], function)
    outer.__code__ = outer.__code__.replace(co_filename=at.co_filename, co_firstlineno=at.co_firstlineno)
    del outer.__wrapped__
    return outer
