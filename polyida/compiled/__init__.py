"""How compiled code is compiled: entry points, cached on disk, and the parts that they are made of."""

from functools import update_wrapper
from inspect import signature

import numba

from polyida.compiled import cache as kernel_cache
from polyida.compiled.linked import Entry, PartCompiler
from polyida.compiled.pack import pack

__all__ = ["entry", "leaf", "pack", "part"]

_COMMON = {"nogil": True, "error_model": "numpy"}  # releases the GIL, divides by zero as numpy does


def entry(function, **options):
    """What Python calls: cached in `cache.folder()`. Compiled code that calls it takes it in as a part."""
    inner, names, made = part(function, **options), ", ".join(signature(function).parameters), {}
    exec(f"def outer({names}):\n    return inner({names})", {"inner": inner}, made)
    outer, at = update_wrapper(made["outer"], function), function.__code__
    outer.__code__ = outer.__code__.replace(co_filename=at.co_filename, co_firstlineno=at.co_firstlineno)
    del outer.__wrapped__
    result = Entry(outer, inner, {"nopython": True, "no_cfunc_wrapper": True, **_COMMON, **options})
    with kernel_cache.kept() as cached:
        if cached:
            result.enable_caching()
    return result


def part(function, **options):
    """What only compiled code calls: cached within its callers. It has no wrapper for Python: a call from there crashes."""
    return numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=PartCompiler, **_COMMON, **options)(function)


def leaf(function):
    """A part that inner loops call with a scene's arrays: handing these over would cost more than the work."""
    return part(function, forceinline=True)
