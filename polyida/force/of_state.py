"""Functions of state, told from functions of time by how many arguments they take, and what they give."""

from inspect import Parameter, signature

from polyida.errors import InputError
from polyida.given import reals

PLAIN = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)


def is_of_state(given, count):
    """Whether it is a function that needs `count` arguments, where one of time takes one."""
    try:
        parameters = signature(given).parameters.values()
    except (TypeError, ValueError):
        return False
    return sum(p.kind in PLAIN and p.default is p.empty for p in parameters) == count


def answer(part, call, given, shape=()):
    """What a function of state gave, as real numbers of a shape. Raises InputError naming the part and how it was called."""
    found = reals(given)
    if found is None or found.shape != shape:
        raise InputError(f"{part}: {call} must return {'two numbers' if shape else 'a number'}, not {str(given)[:80]}")
    return found
