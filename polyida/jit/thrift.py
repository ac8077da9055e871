"""What numba spends again and again while it compiles, spared."""

import atexit
import gc
from contextlib import contextmanager
from functools import cache

from polyida.jit.internals import BaseContext, BaseFunction, Flags, Inst, Loc, Var


class Options(Flags):
    """Options of a compilation; numba compares them ten thousand times, each time all that there are."""

    def __hash__(self):
        return hash(tuple(sorted(self._values)))

    def __eq__(self, other):
        return self._values == other._values if isinstance(other, Flags) else NotImplemented


@contextmanager
def thrifty():
    """Python's search for cycles, a tenth of the time, waits, and numba is spared questions asked before; within another, nothing."""
    if BaseFunction.get_call_type is _typed:
        yield
        return
    running = gc.isenabled()
    gc.disable()
    _put(SPARED)
    _forgo_last_search()
    try:
        yield
    finally:
        _put(PLAIN)
        if running:
            _age()
            gc.enable()


def _put(methods):
    for (owner, name), method in methods.items():
        setattr(owner, name, method)


def _age():
    """Put what was made with the old objects, that are looked through rarely; not where a caller keeps some frozen."""
    if not gc.get_freeze_count():
        gc.freeze()
        gc.unfreeze()


@cache
def _forgo_last_search():
    """A process that has compiled ends without a search through what numba made, a second; the system takes it all back."""
    atexit.register(gc.freeze)


def _typed(function, context, args, kws):
    """Signature of a builtin for types of arguments, asked for once: numba tries all versions of an operator, each time it meets one."""
    return _ASK(function, context, args, kws) if kws else _signature(function, context, tuple(args))


@cache
def _signature(function, context, args):
    return _ASK(function, context, args, {})


def _found(context, key, sig, _firstcall=True):
    """The implementation of a function; of arrays' `__array__`, which has none, without a search through all registries at every use."""
    return _FIND(context, key, sig, _firstcall and key != "__array__")


@cache
def _sized(context, kind):
    """Bytes of a type in LLVM, which parses a module to tell."""
    return _SIZE(context, kind)


def _variables(self, value):
    """Variables within a value of numba's representation; most values are places in the source and names, which hold none."""
    kind = type(value)
    if kind is Var:
        return [value]
    if kind is Loc or kind is str or value is None:
        return []
    return _LIST(self, value)


PLAIN = {
    (owner, name): getattr(owner, name)
    for owner, name in (
        (BaseFunction, "get_call_type"),
        (BaseContext, "get_function"),
        (BaseContext, "get_abi_sizeof"),
        (Inst, "_rec_list_vars"),
    )
}
_ASK, _FIND, _SIZE, _LIST = PLAIN.values()
SPARED = dict(zip(PLAIN, (_typed, _found, _sized, _variables)))
