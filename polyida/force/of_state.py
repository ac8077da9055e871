"""Functions of state, told from functions of time by how many arguments they take."""

from inspect import Parameter, signature

PLAIN = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)


def is_of_state(given, count):
    """Whether it is a function that needs `count` arguments, where one of time takes one."""
    try:
        parameters = signature(given).parameters.values()
    except (TypeError, ValueError):
        return False
    return sum(p.kind in PLAIN and p.default is p.empty for p in parameters) == count
