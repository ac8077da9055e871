"""A wrong keyword is told with the right ones: Python's own TypeError names the wrong one alone."""

from collections.abc import Callable
from functools import wraps
from inspect import Parameter, isclass, signature
from typing import Any, TypeVar

from polyida.errors import InputError

Public = TypeVar("Public", bound=Callable[..., Any])


class KeywordError(InputError, TypeError):
    """An argument that there is not: wrong input as any other, and the TypeError that Python makes of it."""


def named_keywords(public: Public) -> Public:
    """Decorate a function or class of the public interface: other keywords than its own raise KeywordError, which tells them.

    A class keeps being itself, its `__init__` is wrapped; signatures stay. It costs a comparison of two sets.
    """
    function = public.__init__ if isclass(public) else public  # type: ignore[misc]
    parameters = list(signature(public).parameters.values())
    known = {p.name for p in parameters if p.kind in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)}

    @wraps(function)
    def checked(*arguments, **given):
        if given.keys() <= known:
            return function(*arguments, **given)
        raise KeywordError(_complaint(public.__name__, [p.name for p in parameters], min(given.keys() - known)))

    if not isclass(public):
        return checked  # type: ignore[return-value]
    public.__init__ = checked  # type: ignore[misc, method-assign]
    return public


def _complaint(name, known, wrong):
    from difflib import get_close_matches

    lower = {word.lower(): word for word in known}
    near = [lower[word] for word in get_close_matches(wrong.lower(), lower, 1)]
    meant = f"did you mean {near[0]!r}? " if near else ""
    return f"{name}: there is no argument {wrong!r}; {meant}it takes {', '.join(known) or 'none'}"
