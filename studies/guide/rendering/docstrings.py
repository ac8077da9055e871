"""Docstrings of the package follow numpydoc, with code in single backticks. This makes them reStructuredText that napoleon can read."""

import inspect
import re

SPECIAL = re.compile(r"[*|<>]|(?<=\w)_(?!\w)")


def rest_of(text):
    """Lines of a docstring: code in backticks becomes literals, characters with a meaning in reStructuredText are escaped."""
    pieces = inspect.cleandoc(text).split("`")
    return "".join(f"``{piece}``" if k % 2 else SPECIAL.sub(r"\\\g<0>", piece) for k, piece in enumerate(pieces)).splitlines()


def _process(app, what, name, thing, options, lines):
    lines[:] = rest_of("\n".join(lines))


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _process, priority=400)  # before napoleon
    return {"parallel_read_safe": True, "parallel_write_safe": True}
