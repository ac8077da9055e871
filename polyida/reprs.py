"""Representations of objects: one line at the prompt, a table in a notebook."""

from dataclasses import MISSING, fields, is_dataclass
from html import escape

import numpy as np

from polyida.errors import printable
from polyida.validation import is_number

FEW, LONGEST, CELL = 6, 60, 240  # shown entries of an array; characters of a value, and of a cell of a table


def brief(thing: object) -> str:
    """`Kind(name=value, ...)` of a dataclass on one line: of large arrays the shape, of long values the beginning."""
    shown = (f"{entry.name}={short(getattr(thing, entry.name))}" for entry in fields(thing) if entry.repr)  # type: ignore[arg-type]
    return f"{type(thing).__name__}({', '.join(shown)})"


def shown(part):
    """The `repr` of any object `part`, as a text.

    If its class has none of its own, the text is `Kind(h=0.01)`: its class, and its attributes that are numbers or texts.
    """
    if type(part).__repr__ is not object.__repr__:
        return repr(part)
    return f"{type(part).__name__}({', '.join(f'{name}={value!r}' for name, value in numbers_and_texts(part).items())})"


def numbers_and_texts(part):
    """{attribute: value} of an object, without what begins with an underscore."""
    items = getattr(part, "__dict__", {}).items()
    return {name: value for name, value in items if name[0] != "_" and (is_number(value) or isinstance(value, str))}


def settings_of(part):
    """{field: value} of a dataclass; of another object its numbers and texts."""
    if not is_dataclass(part):
        return numbers_and_texts(part)
    return {item.name: getattr(part, item.name) for item in fields(part) if item.init and item.repr}


def used_text(integrator, used):
    """An integrator with the settings that a run used, as far as they are known and differ from the defaults: "IDA(rtol=1e-05, max_order=2)"."""
    if not is_dataclass(integrator):
        return shown(integrator)
    used, defaults = settings_of(integrator) | used, {item.name: item.default for item in fields(integrator)}
    names = [name for name, value in used.items() if value is not None and not np.array_equal(value, defaults.get(name, MISSING))]
    return f"{type(integrator).__name__}({', '.join(f'{name}={number_text(used[name])}' for name in names)})"


def number_text(value):
    """A number with six digits, a tuple of such, or the repr of another value."""
    if isinstance(value, tuple) and value and all(map(is_number, value)):
        return f"({', '.join(map(number_text, value))})" if len(value) <= FEW else f"<{len(value)} numbers>"
    return f"{value:g}" if is_number(value) else repr(value)


def short(value, longest=LONGEST):
    """The repr of a value in one line of at most `longest` characters; of large arrays and lists the size."""
    if isinstance(value, np.ndarray) and value.size > FEW:
        return f"<{' x '.join(map(str, value.shape))} numbers>"
    if isinstance(value, (dict, list, tuple)) and len(value) > FEW:
        return f"<{len(value)} entries>"
    return cut(" ".join(repr(value).split()), longest)


def settings(part):
    """The fields of a dataclass that differ from their defaults, without its name, on one line."""
    if not is_dataclass(part):
        return short(part, CELL)
    entries = ((entry.name, getattr(part, entry.name), entry.default) for entry in fields(part) if entry.repr and entry.name != "name")
    changed = ((name, value) for name, value, default in entries if type(value) is not type(default) or value != default)
    return ", ".join(f"{name} {short(value, CELL // 2)}" for name, value in changed)


def counted(things, most=FEW):
    """Names, separated by commas; of many the first few and the number of the others."""
    names = [printable(name) for name in things]
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def table(title, headings, rows):
    """An HTML table of a title, headings and rows; their text is escaped."""
    cells = lambda kind, row: "".join(f"<{kind}>{escape(cut(str(cell)))}</{kind}>" for cell in row)  # noqa: E731
    head = f"<thead><tr>{cells('th', headings)}</tr></thead>" if headings else ""
    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<div><p>{escape(cut(title, 4 * CELL))}</p><table>{head}<tbody>{body}</tbody></table></div>"


def cut(text, longest=CELL):
    """A text of at most so many characters, without those that steer a terminal."""
    text = printable(text)
    return text if len(text) <= longest else f"{text[: longest - 1]}…"
