"""What the parts of one's own have in common: a class that files find by its name, looked at before it is used."""

from dataclasses import fields, is_dataclass

from polyida import registry
from polyida.errors import InputError
from polyida.joint.attachment import labelled


class OwnPart:
    """A part whose class is a user's: a frozen dataclass with a field `name`; its other fields are its data and are saved with it."""

    name: str | None = None
    by_numba = False  # True of a class whose functions numba compiles (jit/compiled.py)

    def __init_subclass__(cls, part: bool = True, **options):
        """part: whether the class is of parts that files find by its name, not of what parts are made of."""
        super().__init_subclass__(**options)
        if part:
            registry.parts[registry.name_of(cls)] = cls

    @property
    def label(self) -> str:
        """What messages call it."""
        return labelled(type(self).__name__, self.name)


def require_whole(part, base, needed):
    """Raise InputError unless the class of a part is a dataclass with a name and writes the functions `needed` of its base."""
    kind = type(part)
    if not (is_dataclass(kind) and any(field.name == "name" for field in fields(kind))):
        needs = "a dataclass with a field `name: str | None = None`; decorate it with @dataclass(frozen=True, eq=False)"
        raise InputError(f"{part.label}: its class must be {needs}")
    for function in needed:
        if not writes(part, base, function):
            raise InputError(f"{part.label}: its class gives no {function}()")


def writes(part, base, function):
    """Whether the class of a part writes a function of its base anew."""
    return getattr(type(part), function) is not getattr(base, function)


def compiled_functions(part, base, *names):
    """{name: function} of those that the class of a part writes, for numba; empty where they are Python, or use a function that is."""
    from polyida.jit.own_data import OwnData

    found = {name: getattr(type(part), name) for name in names if writes(part, base, name)}
    return found if part.by_numba and not OwnData(part, found.values()).python else {}
