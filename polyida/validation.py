"""Validation of arguments: numbers, texts, arrays and keywords of public functions."""

import math
import operator
import os
import sys
from collections.abc import Callable
from functools import lru_cache, wraps
from importlib import import_module
from inspect import Parameter, isclass, signature
from numbers import Real
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from polyida.errors import InputError

Public = TypeVar("Public", bound=Callable[..., Any])

SMALLEST, LARGEST = 1e-150, 1e150  # of a quantity with a unit: its square, and one over it, are numbers too

TURN = np.array([[0.0, -1.0], [1.0, 0.0]])  # rotation by a right angle: the imaginary unit as a matrix of (x, y)
LEAST_RTOL = 4 * sys.float_info.epsilon  # least relative tolerance of a run: four units of round-off; SUNDIALS refuses less than one


def is_real(value):
    """True for a number (int, float, also of numpy), finite or not, not for a bool."""
    return isinstance(value, Real) and not isinstance(value, (bool, np.bool_))


def is_number(value):
    """True for a finite number, not for a bool."""
    return is_real(value) and abs(_as_float(value)) < math.inf


def _as_float(value):
    """The value as a float; infinity if it is no number or too large."""
    try:
        return float(value)
    except (OverflowError, ValueError, TypeError):
        return math.inf


def is_whole(value, least=1, most=2**62):
    """True for a whole number from `least` to `most`, not for a bool."""
    try:
        number = operator.index(value)
    except TypeError:
        return False
    return not isinstance(value, (bool, np.bool_)) and least <= number <= most


def is_one_of(value, known):
    """True if a value is a text and one of the texts `known`."""
    return isinstance(value, str) and value in known


def takes(function, count):
    """True if a function can be called with so many arguments, or if its signature is unknown."""
    bound = hasattr(function, "__self__") and hasattr(function, "__func__")
    return _takes(function.__func__, count + 1) if bound else _takes.__wrapped__(function, count)


@lru_cache
def _takes(function, count):
    """True if a function can be called with so many arguments, remembered by function."""
    try:
        signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:
        return True
    return True


def instance_of(kind):
    """Words that ask for an instance in place of its class, with the arguments that it needs."""
    needed = ", ".join(f"{one.name}=..." for one in signature(kind).parameters.values() if one.default is one.empty)
    return f"{kind.__name__} is a class: give an instance, {kind.__name__}({needed})"


def settle(part, **values):
    """Set fields of a frozen dataclass to their checked values, in its __post_init__."""
    for name, value in values.items():
        object.__setattr__(part, name, value)


def as_array(value):
    """The value as an array of numpy; None if it cannot be one: a ragged list, a tensor that refuses."""
    try:
        return np.asarray(value)
    except Exception:  # noqa: BLE001, `__array__` of another package may raise anything
        return None


def reals(value):
    """The value as an array of floats, finite or not; None for anything else: text, ragged lists, complex numbers."""
    array = as_array(value)
    if array is None:
        return None
    try:
        numbers = array.dtype.kind in "iuf" or (array.dtype.kind == "O" and all(isinstance(x, Real) for x in array.flat))
        return array.astype(float) if numbers else None
    except (TypeError, ValueError, OverflowError):
        return None


def floats(value):
    """The value as an array of finite floats, or None."""
    array = reals(value)
    return array if array is not None and np.isfinite(array).all() else None


def complexes(value):
    """The value as an array of complex numbers, finite or not; None for anything else."""
    array = as_array(value)
    return array.astype(complex) if array is not None and array.dtype.kind in "iufcb" else None


def is_flag(value):
    """True for a bool of Python or numpy."""
    return isinstance(value, (bool, np.bool_))


def read_only(array):
    """A read-only view of an array, without a copy."""
    view = array.view()
    view.flags.writeable = False
    return view


def on_pairs(matrix):
    """The real matrix for (x, y) pairs of a complex matrix, dense or sparse: each entry w becomes ((Re w, -Im w), (Im w, Re w))."""
    if not hasattr(matrix, "tocsr"):
        return np.kron(matrix.real, np.eye(2)) + np.kron(matrix.imag, TURN)
    from scipy.sparse import csr_array, kron

    return csr_array(kron(matrix.real, np.eye(2)) + kron(matrix.imag, TURN))


def pairs_of(numbers):
    """Complex numbers (...) as pairs (..., 2)."""
    return np.stack([numbers.real, numbers.imag], axis=-1)


def complex_of_pairs(pairs):
    """Pairs (..., 2) as complex numbers (...)."""
    return pairs[..., 0] + 1j * pairs[..., 1]


def positive(part, name, value, unit):
    """The value as a float; InputError, with part and value, unless it is a finite number above zero."""
    if not is_number(value) or value <= 0:
        raise InputError(f"{part}: {name} = {value!r:.100} must be a positive number of {unit}")
    if not SMALLEST <= float(value) <= LARGEST:  # a float16 cannot be compared with these
        raise InputError(f"{part}: {name} = {value!r:.100} must be a number of {unit} from {SMALLEST:g} to {LARGEST:g}")
    return float(value)


def number(part, name, value, unit, least=-math.inf):
    """The value as a float; InputError, with part and value, unless it is a finite number of `least` or more."""
    if not (is_number(value) and value >= least):
        least = "" if least == -math.inf else f", {least:g} or more"
        raise InputError(f"{part}: {name} = {value!r:.100} must be a finite number of {unit}{least}")
    if abs(float(value)) > LARGEST:
        raise InputError(f"{part}: {name} = {value!r:.100} must be a number of {unit} up to {LARGEST:g}")
    return float(value)


def one_of(part, name, value, known):
    """The value; InputError, with part and value, unless it is one of the texts `known`."""
    if not is_one_of(value, known):
        raise InputError(f"{part}: {name} = {value!r:.100} must be one of {', '.join(known)}")
    return value


def flag(part, name, value):
    """The value; InputError, with part and value, unless it is a bool."""
    if not is_flag(value):
        raise InputError(f"{part}: {name} = {value!r:.100} must be True or False")
    return value


def whole(part, name, value, least=1):
    """The value as an int; InputError, with part and value, unless it is a whole number of `least` or more."""
    if not is_whole(value, least):
        raise InputError(f"{part}: {name} = {value!r:.100} must be a whole number of at least {least}")
    return operator.index(value)


def vector2(part, name, value):
    """The value as two floats; InputError, with part and value, for anything else."""
    pair = floats(value)
    if pair is None or pair.shape != (2,) or np.abs(pair).max() > LARGEST:
        raise InputError(f"{part}: {name} = {value!r:.200} must be two finite numbers, up to {LARGEST:g}")
    return pair


def vector(part, name, value, size=None):
    """The value as a vector of finite floats, of a size if it is given; InputError, with part and value, for anything else."""
    numbers = floats(value)
    good = numbers is not None and numbers.ndim == 1 and (size is None or len(numbers) == size)
    if not good or np.abs(numbers).max(initial=0.0) > LARGEST:
        right = "a list of finite numbers" if size is None else f"{size} finite numbers"
        raise InputError(f"{part}: {name} = {value!r:.200} must be {right}")
    return numbers


def index(part, name, value, count, what):
    """The value as an index; InputError, with part and value, unless it is a whole number from -count to count - 1."""
    if not is_whole(value, -count, count - 1):
        raise InputError(f"{part}: {name} = {value!r:.100} must be a whole number; there are {count} {what}")
    return operator.index(value)


def listed(part, name, value):
    """The value as a list; InputError, with part and value, for what has no entries, and for a text."""
    try:
        if isinstance(value, str):
            raise TypeError
        return list(value)
    except TypeError:
        raise InputError(f"{part}: {name} = {value!r:.100} must be a list") from None


def instance(part, name, value, kind):
    """The value; InputError, with part and value, unless it is an instance of a class."""
    if not isinstance(value, kind):
        raise InputError(f"{part}: {name} = {value!r:.100} must be a {kind.__name__}")
    return value


def path_of(part, name, value):
    """The value as a Path; InputError, with part and value, unless a file or folder can have such a name."""
    try:
        path = Path(value)
        path.exists()  # an OSError for a name that is too long, in Python 3.11 also a ValueError for a NUL
        os.fsencode(path)
        good = bool(os.fspath(value)) and "\0" not in str(path)
    except (TypeError, ValueError, OSError):
        good = False
    if not good:
        raise InputError(f"{part}: {name} = {value!r:.100} must be the path of a file or folder")
    return path


class KeywordError(InputError, TypeError):
    """Unknown keyword or missing argument. It is an InputError, and the TypeError that Python itself would raise."""


def named_keywords(public: Public) -> Public:
    """Decorate a public function, method or class: an unknown keyword or a missing argument raises KeywordError, which lists the known ones.

    A class stays the same class: only its `__init__` is wrapped. Signatures do not change.
    """
    function = public.__init__ if isclass(public) else public  # type: ignore[misc]
    parameters = list(signature(public).parameters.values())
    known = {p.name for p in parameters if p.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)}
    before = int(isclass(public))  # self, which the signature of a class does not have
    names = [p.name for p in parameters if p.name != "self"]
    needed = [(k + before, p.name) for k, p in enumerate(parameters) if p.name in known and p.default is Parameter.empty]

    @wraps(function)
    def checked(*arguments, **keywords):
        """The function, or `__init__`, once its keywords are known and none is missing."""
        if not keywords.keys() <= known:
            raise KeywordError(_complaint(public.__name__, names, min(keywords.keys() - known)))
        for place, name in needed:
            if place >= len(arguments) and name not in keywords:
                raise KeywordError(f"{public.__name__}: {name} is missing; it takes {', '.join(names)}")
        return function(*arguments, **keywords)

    if not isclass(public):
        return checked  # type: ignore[return-value]
    public.__init__ = checked  # type: ignore[misc, method-assign]
    return public


def _complaint(name, known, wrong):
    """The message on an unknown keyword, with the known name that is most like it."""
    from difflib import get_close_matches

    lower = dict.fromkeys(("dt", "step_size") if "h" in known else (), "h") | {word.lower(): word for word in known}
    near = [lower[word] for word in get_close_matches(wrong.lower(), lower, 1)]
    meant = f"did you mean {near[0]!r}? " if near else ""
    return f"{name}: there is no argument {wrong!r}; {meant}it takes {', '.join(known) or 'none'}"


def library(name, message):
    """Import an optional package. Raises InputError with the message if it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        raise InputError(message) from None


def require_bytes(part, memory_limit):
    """Raise InputError, in the name of `part`, unless it is a number of bytes."""
    if not (is_number(memory_limit) and memory_limit >= 0):
        raise InputError(f"{part}: memory_limit = {memory_limit!r} must be a number of bytes")


def labelled(kind, name):
    """Return how messages name a part. Raise InputError if the name is not a text."""
    if name is not None and not (isinstance(name, str) and name):
        raise InputError(f"{kind}: name = {name!r} must be a text")
    return kind if name is None else f"{kind} {name!r}"
