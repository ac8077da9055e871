"""How compiled code is compiled: entry points, cached on disk, and the parts that they are made of."""

from functools import partial, update_wrapper
from inspect import signature

import numba

from polyida.jit import cache as kernel_cache
from polyida.jit.linked import Entry, EntryCompiler, PartCompiler
from polyida.jit.pack import pack
from polyida.jit.shared import Call, SharedCompiler

__all__ = ["entry", "leaf", "pack", "part", "shared"]

_COMMON = {"nogil": True, "error_model": "numpy"}  # releases the GIL, divides by zero as numpy does


def entry(function, c=False, **options):
    """What Python calls: cached in `cache.folder()`. Compiled code that calls it takes it in as a part. c: with a C function beside it."""
    inner = part(function, **options)
    return _entry(function, inner, EntryCompiler, inner, options | {"no_cfunc_wrapper": not c})


def shared(function, **options):
    """An entry that compiled code calls where it is: for what is large, and needed by several."""
    result = _entry(function, part(function, **options), SharedCompiler, None, options)
    result.part = _internal(function, partial(Call, result), options)
    return result


def _entry(function, inner, compiler, part, options):
    """A function that calls `inner`, for Python; for compiled code it stands for `part`."""
    names, made = ", ".join(signature(function).parameters), {}
    exec(f"def outer({names}):\n    return inner({names})", {"inner": inner}, made)
    outer, at = update_wrapper(made["outer"], function), function.__code__
    outer.__code__ = outer.__code__.replace(co_filename=at.co_filename, co_firstlineno=at.co_firstlineno)
    del outer.__wrapped__
    result = Entry(outer, part, {"nopython": True, "no_cfunc_wrapper": True, **_COMMON, **options}, compiler)
    with kernel_cache.kept() as cached:
        if cached:
            kernel_cache.keep(result)
    return result


def part(function, **options):
    """What only compiled code calls: cached within its callers. It has no wrapper for Python: a call from there crashes."""
    return _internal(function, PartCompiler, options)


def leaf(function):
    """A part that inner loops call with a scene's arrays: handing these over would cost more than the work."""
    return part(function, forceinline=True)


def _internal(function, compiler, options):
    return numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=compiler, **_COMMON, **options)(function)
