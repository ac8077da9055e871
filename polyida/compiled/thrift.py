"""What numba spends again and again while it compiles, spared."""

import atexit
import gc
from contextlib import contextmanager
from functools import cache

from polyida.compiled.internals import BaseFunction, Flags


class Options(Flags):
    """Options of a compilation; numba compares them ten thousand times, each time all that there are."""

    def __hash__(self):
        return hash(tuple(sorted(self._values)))

    def __eq__(self, other):
        return self._values == other._values if isinstance(other, Flags) else NotImplemented


@contextmanager
def thrifty():
    """Python's search for cycles, a tenth of the time, waits, and operators are typed once; within another, nothing."""
    if BaseFunction.get_call_type is _typed:
        yield
        return
    running = gc.isenabled()
    gc.disable()
    BaseFunction.get_call_type = _typed
    _forgo_last_search()
    try:
        yield
    finally:
        BaseFunction.get_call_type = _ASK
        if running:
            _age()
            gc.enable()


def _age():
    """Put what was made with the old objects, that are looked through rarely; not where a caller keeps some frozen."""
    if not gc.get_freeze_count():
        gc.freeze()
        gc.unfreeze()


@cache
def _forgo_last_search():
    """A process that has compiled ends without a search through what numba made, a second; the system takes it all back."""
    atexit.register(gc.freeze)


_ASK = BaseFunction.get_call_type


def _typed(function, context, args, kws):
    """Signature of a builtin for types of arguments, asked for once: numba tries all versions of an operator, each time it meets one."""
    return _ASK(function, context, args, kws) if kws else _known(function, context, tuple(args))


@cache
def _known(function, context, args):
    return _ASK(function, context, args, {})
