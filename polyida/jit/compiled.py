"""Functions of users that numba compiles: `polyida.compiled`, and what such a function gives at many arguments at once."""

from functools import update_wrapper
from types import CellType, CodeType, FunctionType
from typing import Any

import numba

from polyida.errors import InputError
from polyida.jit import own_part
from polyida.mark import is_dispatcher, machine_mark_of, of_polyida
from polyida.validation import named_keywords


@named_keywords
def compiled(given: Any) -> Any:
    """Decorator of a Model, ForceElement or Body, or of a function: numba compiles it, and steps call no Python of it.

    The functions of a class are the same plain numpy code as without the decorator, as far as numba compiles that. They read numbers, arrays,
    profiles (`self.profile(t)`) and compiled functions of `self`, with the values at the start of a run, and may call functions of their
    module, but not each other through `self`. Derivatives that are not written are formed by differences in compiled code; those that
    a ForceElement or a Body writes are for Python alone. A function that raises, or returns an array of another shape, ends the run at
    that time. A compiled function is taken where a plain one is: by profiles, `until`, sensors, and functions of state of forces.
    The machine code is kept on disk. It is compiled anew if the functions change, or a value or function that they name.
    GeneralizedAlpha, RadauIIA and EnergyMomentum call no Python in a step of scenes, and of models of up to 50 coordinates and constraints;
    of larger ones the functions are compiled, and the rest of the step is not. IDA's binding calls Python once an iteration.

    given: a subclass of Model, ForceElement or Body, or a function. Returns the class itself, or what is called as the function is.
    Raises InputError for anything else and, where a run begins or a scene is built, for a function that numba cannot compile or whose result
    is no real array of the right dimension; the message names the function.
    """
    if isinstance(given, type) and hasattr(given, "by_numba"):
        given.by_numba = True
        return given
    if isinstance(given, FunctionType):
        return CompiledFunction(given)
    raise InputError(f"compiled: {given!r:.100} must be a function, or a subclass of polyida.Model, ForceElement or Body")


class CompiledFunction:
    """A function that Python calls as it is, and compiled code as `dispatcher`."""

    def __init__(self, function):
        update_wrapper(self, function)
        self.function = function

    def __call__(self, *given):
        return self.function(*given)

    def __reduce__(self):
        return self.__qualname__


def is_compiled(given):
    """Whether a function is compiled, by `compiled` or numba.njit."""
    return isinstance(given, CompiledFunction) or is_dispatcher(given)


_made: dict = {}  # {(function, its mark): what compiled code calls of it}


def for_numba(given):
    """A function as numba takes it, with functions that it names compiled too; a user's index out of bounds raises.

    numba compiles it from the values that it names now, also if it was compiled before from others.
    """
    if is_dispatcher(given) and not _is_function(given):
        return given
    key = given, machine_mark_of(given)
    if key not in _made:
        function = given.function if isinstance(given, CompiledFunction) else getattr(given, "py_func", given)
        own, cells = dict(function.__globals__), [CellType(cell.cell_contents) for cell in function.__closure__ or ()]
        own["__name__"] = __name__  # kept code imports its module: that of the function may be missing in another process
        made = FunctionType(function.__code__, own, function.__name__, function.__defaults__, tuple(cells))
        made.__kwdefaults__ = function.__kwdefaults__
        _made[key] = numba.jit(**given.targetoptions)(made) if is_dispatcher(given) else own_part(made, not of_polyida(function))
        for name in names_of(function.__code__):
            if _is_function(value := own.get(name)):
                own[name] = for_numba(value)
        for cell in cells:
            if _is_function(cell.cell_contents):
                cell.cell_contents = for_numba(cell.cell_contents)
    return _made[key]


def _is_function(value):
    return isinstance(value, FunctionType | CompiledFunction) or is_dispatcher(value) and not of_polyida(value) and value._can_compile


def names_of(code):
    """Names that a function uses, with those of functions within it."""
    inner = (name for inner in code.co_consts if isinstance(inner, CodeType) for name in names_of(inner))
    return dict.fromkeys([*code.co_names, *inner])
