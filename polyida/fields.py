"""Checks of the fields of a frozen dataclass, each beside its field.

    stiffness: float = field(metadata=check(number, "N/m", 0.0))
    radius: float | None = field(default=None, metadata=check(optional, positive, "metres"))
    rho_inf: float = field(default=0.9, metadata=must_be("in [0, 1)", lambda x: is_number(x) and 0 <= x < 1))

`check_fields(self, label)` in `__post_init__` sets each field to its checked value, in the order of the fields. A check is a function
`f(label, name, value, *limits)` that returns the value to store or raises InputError, as those of `polyida.validation`. Signatures, defaults
and types are those of the fields.
"""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

from polyida.errors import InputError
from polyida.profile import as_profile
from polyida.validation import is_number, settle, vector2

CHECK = "polyida.check"  # key of the metadata of a field


def check(function: Callable[..., Any], *limits: Any) -> dict[str, Any]:
    """Metadata of a dataclass field: `check_fields` replaces its value by `function(label, name, value, *limits)`."""
    return {CHECK: (function, limits)}


def must_be(want: str, good: Callable[[Any], bool], kind: Callable[[Any], Any] | None = None) -> dict[str, Any]:
    """Metadata of a field: unless `good(value)`, the message says that it must be `want`. It becomes `kind(value)`, or stays as it is given."""
    return check(_require_good, want, good, kind)


def _require_good(label, name, value, want, good, kind):
    """Return the value, as a `kind` if that is given. Raise InputError, "label: name = value must be ...", unless `good(value)`."""
    if not good(value):
        raise InputError(f"{label}: {name} = {value!r} must be {want}")
    return value if kind is None else kind(value)


def above_zero(value: Any) -> bool:
    """True for a finite number above zero."""
    return is_number(value) and value > 0


def not_negative(value: Any) -> bool:
    """True for a finite number of at least zero."""
    return is_number(value) and value >= 0


def none_or(good: Callable[[Any], bool]) -> Callable[[Any], bool]:
    """A function that is true for None, and for what `good` is true for."""
    return lambda value: value is None or good(value)


def optional(label, name, value, function, *limits):
    """Return None for a value None, else the checked value `function(label, name, value, *limits)`, which may raise InputError."""
    return None if value is None else function(label, name, value, *limits)


def pair(label, name, value):
    """Return the value as a tuple of two floats; InputError, with part and value, for anything else."""
    return tuple(vector2(label, name, value).tolist())


def time_profile(label, name, value):
    """Return the Profile of a Profile, a number or a function of time; InputError, with the part, for anything else."""
    return as_profile(value, label)


def check_fields(part: Any, label: str) -> None:
    """Set each field of a dataclass that has a check to its checked value. Raise InputError; label: of the part, in messages."""
    for one in fields(part):
        if CHECK in one.metadata:
            function, limits = one.metadata[CHECK]
            settle(part, **{one.name: function(label, one.name, getattr(part, one.name), *limits)})
