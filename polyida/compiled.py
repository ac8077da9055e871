"""How compiled code is compiled: entry points, cached on disk, and the parts that only they call."""

import numba

# what Python calls: cached, releases the GIL, divides by zero as numpy does
entry = numba.njit(cache=True, nogil=True, error_model="numpy")

# what only compiled code calls: cached within its callers. It has no wrapper for Python: a call from there crashes
part = numba.njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)

# leaves of inner loops that take a scene's arrays: handing these over costs more than the work
leaf = numba.njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True, forceinline=True)
