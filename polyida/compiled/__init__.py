"""How compiled code is compiled: entry points, cached on disk, and the parts that only they call."""

import numba

from polyida.compiled import cache as kernel_cache

_COMMON = {"nogil": True, "error_model": "numpy"}  # releases the GIL, divides by zero as numpy does


def entry(function, **options):
    """What Python calls: cached in `cache.folder()`."""
    with kernel_cache.kept() as cached:
        return numba.njit(cache=cached, **_COMMON, **options)(function)


def part(function, **options):
    """What only compiled code calls: cached within its callers. It has no wrapper for Python: a call from there crashes."""
    return numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **_COMMON, **options)(function)


def leaf(function):
    """A part that inner loops call with a scene's arrays: handing these over would cost more than the work."""
    return part(function, forceinline=True)
