"""Options on the command line that are arguments of the function of a scene: `--mu 0.0` is `mu=0.0`, typed by the default of the argument."""

import inspect
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from typing import Any

from polyida.errors import InputError

TRUTHS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


def texts_of(words: Iterable[str]) -> dict[str, str | None]:
    """{option: its text} of the words `--name text` and `--name=text`; None for an option without a text. Raises InputError for other words."""
    texts: dict[str, str | None] = {}
    waiting = None  # the option whose text may come next
    for word in words:
        if word.startswith("--") and len(word) > 2:
            name, equals, text = word[2:].partition("=")
            name = name.replace("-", "_")
            if name in texts:
                raise InputError(f"--{_shown(name)} is given more than once")
            texts[name], waiting = (text, None) if equals else (None, name)
        elif waiting:
            texts[waiting], waiting = word, None
        else:
            raise InputError(f"{word}: it belongs to no option; options of a scene are written --name value, behind the scene")
    return texts


def typed_options(spec: str, function: Callable[..., object], texts: dict[str, str | None], known: Iterable[str] = ()) -> dict[str, Any]:
    """{argument: value} of the texts of options, each of the type of the argument's default, or of its annotation.

    known: other options of the command, for the message on an option that nobody knows. Raises InputError for an option that is no argument,
    and for a text of another type.
    """
    arguments = inspect.signature(function).parameters
    values = {}
    for name, text in texts.items():
        if name not in arguments:
            near = get_close_matches(name, [*arguments, *known], 1)
            hint = f"; did you mean --{_shown(near[0])}?" if near else ""
            raise InputError(f"{spec} takes no option --{_shown(name)}: its function has no argument of that name{hint}")
        values[name] = _typed(spec, arguments[name], text)
    return values


def _typed(spec, argument, text):
    """The value of an argument. Without a default and an annotation: a number if the text is one."""
    option, default = f"--{_shown(argument.name)}", argument.default
    kind = argument.annotation if default in (argument.empty, None) else type(default)
    if text is None and kind is not bool:
        raise InputError(f"{spec}: {option} needs a value")
    if kind is argument.empty or default is None and kind not in KINDS:
        return next((value for value in (_read(one, text) for one in (int, float)) if value is not None), text)
    if kind not in KINDS:
        raise InputError(f"{spec}: {option} is of type {getattr(kind, '__name__', kind)}; options can be numbers, texts, true and false")
    value = True if text is None else _read(kind, text)
    if value is None:
        shown = "" if default in (argument.empty, None) else f", like its default {default!r}"
        raise InputError(f"{spec}: {option} {text} must be {KINDS[kind]}{shown}")
    return value


def _read(kind, text):
    """The value of the type `kind` (bool, int, float or str) that a text stands for; None if it stands for none."""
    if kind is bool:
        return TRUTHS.get(text.lower())
    try:
        return kind(text)
    except ValueError:
        return None


def _shown(name):
    """The name of an argument as an option on the command line shows it: with hyphens for underscores."""
    return name.replace("_", "-")
