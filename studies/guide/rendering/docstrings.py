"""The package's docstrings are plain text with code in backticks; Sphinx reads reStructuredText."""

import inspect
import re

SPECIAL = re.compile(r"([\\*|_<>])")


def rest_of(text):
    """reStructuredText of a docstring: code in backticks as literals, paragraphs as they are, indented ones as blocks of code."""
    return "\n\n".join(map(_paragraph, re.split(r"\n\s*\n", inspect.cleandoc(text)))).splitlines()


def _paragraph(given):
    if given.startswith(" "):
        return "::\n\n" + "\n".join("   " + line for line in given.splitlines())
    pieces = " ".join(line.strip() for line in given.splitlines()).split("`")
    return "".join(f"``{' '.join(piece.split())}``\\ " if k % 2 else SPECIAL.sub(r"\\\1", piece) for k, piece in enumerate(pieces))


def _process(app, what, name, thing, options, lines):
    lines[:] = rest_of("\n".join(lines))


def setup(app):
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _process)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
