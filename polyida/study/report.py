"""The folder of a study: report.html, figures.json, its pictures as PNG, PDF and CSV."""

import json
import shlex
import sys
from contextlib import nullcontext
from itertools import takewhile
from pathlib import Path

from polyida.errors import InputError
from polyida.show import html
from polyida.show.html.blocks import missing, shown
from polyida.show.press import Press
from polyida.show.style import figure, settings
from polyida.study.findings import columns_of

MANY = 4  # pictures, from which drawing them in two processes is quicker
FIGURES = {"name": ("figure", "{}"), "value": ("value", "{:.6g}")}


def write(result, folder, overwrite, command=""):
    """Write the report of a Result into a folder, new or empty unless `overwrite`; returns the folder.

    command: what made it, by default the script that runs. Raises InputError where there is something in the folder, or a file of its name.
    """
    if not isinstance(folder, (str, Path)) or not str(folder) or "\0" in str(folder):
        raise InputError(f"report: folder = {folder!r:.100} must be the path of a folder")
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"report: {folder} is a file; give a folder")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"report: {folder} has something in it: choose another folder, or say overwrite=True")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"report: the folder {folder} cannot be made: {error.strerror}") from error
    command = command or (shlex.join([Path(sys.executable).name, *sys.argv]) if sys.argv[0] else "an interactive session")
    data = result.as_dict() | {"command": command}
    (folder / "figures.json").write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    html.write(folder, result.title, blocks(result), command, data["machine"], result.lead)
    return folder


def blocks(result):
    """What the page of a Result consists of: notes, pictures, the table whole, its figures."""
    pictures = [html.Picture(name, caption, _drawn(draw)) for name, (caption, draw) in result.pictures().items()]
    numbers = [{"name": name, "value": value} for name, value in result.figures.items()]
    found = [html.Notes(result.notes), html.Heading("Figures"), *pictures] if pictures else [html.Notes(result.notes)]
    found += [html.Heading("Rows"), html.Table(result.shown_columns(), [_legible(row) for row in result.rows])]
    return [*found, html.Heading("Numbers"), html.Table(FIGURES, numbers)] if numbers else found


def write_page(study, rows, found, data, folder):
    """The page of a study of the command line, with its Findings; data: what its figures.json holds. Returns the path."""
    numbers = [{"name": name, "value": value} for name, value in found.figures.items()]
    parts = [html.Heading("Figures"), *found.pictures] if found.pictures else []
    parts += [html.Heading("What failed, and what the numbers mean"), html.Notes(found.notes)] if found.notes else []
    parts += [html.Heading("Numbers"), html.Table(FIGURES, numbers)] if numbers else []
    parts += [html.Heading("Rows"), *tables(columns_of(study, rows), rows)]
    with Press() if len(found.pictures) > MANY else nullcontext() as press:
        return html.write(folder, study.name.replace("_", " "), parts, data["command"], data["machine"], study.title, press)


def tables(columns, rows):
    """A table for each kind of task, which vary the same, of the columns in which it has something; what its tasks share is told above."""
    kinds = {}
    for row in rows:
        kinds.setdefault(tuple(takewhile(lambda name: name != "error", row)), []).append(_legible(row))
    return [_table(columns, kind, found) for kind, found in kinds.items()]


def _table(columns, kind, rows):
    there = {name: [row[name] for row in rows if row.get(name) != "" and not missing(row.get(name))] for name in columns}
    there = {name: found for name, found in there.items() if found}
    shared = {name: found[0] for name, found in there.items() if name in kind and 1 < len(rows) == found.count(found[0])}
    forms = {name: "{}" if all(isinstance(value, int) for value in found) else "{:.4g}" for name, found in there.items()}
    kept = {name: (name, form) for name, form in forms.items() if name not in shared}
    return html.Table(kept, rows, ", ".join(f"{name}: {shown(value)}" for name, value in shared.items()))


def _legible(row):
    """A row with its lists and dictionaries, which figures.json has whole, as their sizes."""
    return {name: f"{len(value)} values" if isinstance(value, (list, dict)) else value for name, value in row.items()}


def _drawn(draw):
    """A figure with what a function draws on its axes."""
    with settings():
        made, axes = figure(6.4, 3.8)
        draw(axes)
        return made
