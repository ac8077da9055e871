"""Decorators of compiled functions: entries, which Python calls and which are cached on disk, and the parts of which they consist.

All of them use numba's public decorators. For numba versions in TESTED, `jit/compilers.py` adds compilers that do the same in less time
(studies/start.py) with numba's internals. POLYIDA_PLAIN_NUMBA=1 in the environment switches them off.
"""

import warnings
from contextlib import suppress
from functools import update_wrapper
from hashlib import sha256
from importlib import import_module
from inspect import signature
from typing import Any

import numba
from numba.core import event

from polyida.clock import Teller, loading
from polyida.jit import cache as kernel_cache
from polyida.jit.pack import pack

__all__ = ["FAST", "bound", "c_address", "entry", "fast", "leaf", "own_address", "own_part", "pack", "part", "served", "shared", "typed"]

TESTED = (0, 65), (0, 68)  # first and last version of numba with which compilers.py is tested
FAST = {"contract", "reassoc", "nsz"}  # without "nnan": kernels test for NaN
_COMMON = {"nogil": True, "error_model": "numpy"}  # release the GIL; division by zero as in numpy
_INNER = _COMMON | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


compilers: Any = None
if not kernel_cache.PLAIN and TESTED[0] <= numba.version_info.short <= TESTED[1]:
    with suppress(ImportError, AttributeError):  # of a numba that was changed within its version
        compilers = import_module("polyida.jit.compilers")
_parts = {"pipeline_class": compilers.PartCompiler} if compilers else {}


class _Listener(event.Listener):
    """Calls functions when numba begins and ends a kind of work."""

    def __init__(self, begin, end):
        """Store two functions (event), called when numba begins and when it ends a kind of work."""
        self.begin, self.end = begin, end

    def on_start(self, event):
        """Call `begin` when the work begins."""
        self.begin(event)

    def on_end(self, event):
        """Call `end` when the work ends."""
        self.end(event)


def _begin_to_compile(event):
    """Tell the Teller, for an event of numba, which function of which module begins to be compiled."""
    function = event.data["dispatcher"].py_func
    _teller.begin(function.__module__, function.__name__)


_teller = Teller(kernel_cache.folder)
# numba compiles and loads under this lock, also functions of users that Python calls
event.register("numba:compiler_lock", _Listener(lambda event: loading.begin(), lambda event: loading.end()))
event.register("numba:compile", _Listener(_begin_to_compile, lambda event: _teller.end()))


def entry(function, **options):
    """A function that Python calls, cached in `cache.folder()`. Compiled code that calls it takes it in as a part."""
    if compilers:
        inner = part(function, **options)
        return compilers.entry(_around(function, inner), inner, compilers.EntryCompiler, _COMMON | options)
    with kernel_cache.cache_folder() as cached:
        return numba.njit(cache=cached, no_cfunc_wrapper=True, **_COMMON, **options)(function)


def shared(function, **options):
    """A large entry that several entries call; its code is not copied into theirs."""
    if not compilers:
        return entry(function, **options)
    return compilers.shared(_around(function, part(function, **options)), function, _COMMON | options)


def part(function, **options):
    """A function that only compiled code calls, cached within its callers. It has no wrapper for Python: a call from Python crashes."""
    return numba.njit(**_INNER, **_parts, **options)(function)


def fast(function):
    """Make a part whose sums may be reordered, and so vectorised, by the compiler."""
    return part(function, fastmath=FAST)


def leaf(function):
    """A part that is always inlined: inner loops call it with a scene's arrays, and passing these would cost more than its work."""
    return part(function, forceinline=True)


def served(function, *shapes, first=None):
    """The part `f(workspace, instant, address x 6)`, an entry of a model's table, of a part `function(workspace, instant, *arguments)`.

    shapes: for each argument a part (workspace, address) that returns the array there, or None for a number. first: such a part for an entry that
    gets an address in place of the instant.
    """
    places = [f"place_{k}" for k in range(6)]
    arguments = [place if shape is None else f"shape_{k}(workspace, {place})" for k, (place, shape) in enumerate(zip(places, shapes))]
    names = {"inner": function, "first": first} | {f"shape_{k}": shape for k, shape in enumerate(shapes)}
    arguments = ["instant" if first is None else "first(workspace, instant)", *arguments]
    text = f"def outer(workspace, instant, {', '.join(places)}):\n    return inner(workspace, {', '.join(arguments)})"
    exec(text, names)
    return part(_in_place_of(names["outer"], function.py_func))


@loading
def c_address(inner, kinds):
    """The address of an entry or a part as a C function with a numba signature; cached like an entry."""
    outer = _around(inner.py_func, inner)
    if compilers:
        return compilers.c_address(outer, inner, kinds, _COMMON)
    outer.__qualname__ += sha256(repr(kinds).encode()).hexdigest()[:16]  # its own files, see `cache.Files`
    with kernel_cache.cache_folder() as cached:
        compiled_function = numba.cfunc(kinds, cache=cached, nopython=True, **_COMMON)(outer)
    _c_functions.append(compiled_function)
    return compiled_function.address


def own_part(function, boundscheck):
    """A part, to be called by compiled code, of a user's function, compiled with all passes of numba."""
    options = {"pipeline_class": compilers.OwnPartCompiler} if compilers else {}
    return numba.njit(**_INNER, boundscheck=boundscheck, **options)(function)


@loading
def own_address(function, kinds, cached):
    """The address of a function that calls own parts as a C function. cached: True if its name identifies it, so that files can be named.

    Without the faster compilers each process compiles it: code that numba caches prints arrays as nothing.
    """
    if compilers:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Cannot cache compiled function")  # because it contains addresses of this process
            return compilers.c_address(function, None, kinds, _COMMON, cached)
    compiled_function = numba.cfunc(kinds, nopython=True, **_COMMON)(function)
    _c_functions.append(compiled_function)
    return compiled_function.address


_c_functions: list = []  # whose addresses are in use


@loading
def bound(entry, *args):
    """Return the compiled function of an entry for arguments of the types of `args`."""
    return entry.compile(tuple(map(numba.typeof, args)))


def typed(entry):
    """An entry whose argument types are those of its first call: looking them up each time costs as much as a small kernel."""
    compiled = None

    def call(*args):
        """Call the entry, compiled for the types of the first call, without a search by types."""
        nonlocal compiled
        if compiled is None:
            compiled = bound(entry, *args)
        return compiled(*args)

    return call


def _around(function, inner):
    """A function that calls `inner`, with the name, the source position and the arguments of `function`."""
    names, namespace = ", ".join(signature(function).parameters), {}
    exec(f"def outer({names}):\n    return inner({names})", {"inner": inner}, namespace)
    return _in_place_of(namespace["outer"], function)


def _in_place_of(outer, function):
    """`outer` with the name and the source position of `function`, by which its machine code is cached."""
    outer, at = update_wrapper(outer, function), function.__code__
    outer.__code__ = outer.__code__.replace(co_filename=at.co_filename, co_firstlineno=at.co_firstlineno)
    del outer.__wrapped__
    return outer
