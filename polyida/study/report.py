"""The folder of a study: report.html, figures.json, its pictures as PNG, PDF and CSV."""

import json
import shlex
import sys
from pathlib import Path

from polyida.errors import InputError
from polyida.show import html
from polyida.show.style import figure, settings
from polyida.study.findings import columns_of

FIGURES = {"name": ("figure", "{}"), "value": ("value", "{:.6g}")}


def write(result, folder, overwrite, command=""):
    """Write the report of a Result into a folder, new or empty unless `overwrite`; returns the folder.

    command: what made it, by default the script that runs. Raises InputError where there is something in the folder, or a file of its name.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"report: {folder} is a file; give a folder")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"report: {folder} has something in it: choose another folder, or say overwrite=True")
    folder.mkdir(parents=True, exist_ok=True)
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
    columns = {name: (name, "{:.4g}") for name in columns_of(study, rows)}
    numbers = [{"name": name, "value": value} for name, value in found.figures.items()]
    parts = [html.Heading("Figures"), *found.pictures] if found.pictures else []
    parts += [html.Heading("Numbers"), html.Table(FIGURES, numbers)] if numbers else []
    parts += [html.Heading("What failed, and what the numbers mean"), html.Notes(found.notes)] if found.notes else []
    parts += [html.Heading("Rows"), html.Table(columns, [_legible(row) for row in rows])]
    return html.write(folder, study.name.replace("_", " "), parts, data["command"], data["machine"], study.title)


def _legible(row):
    """A row with its lists and dictionaries, which figures.json has whole, as their sizes."""
    return {name: f"{len(value)} values" if isinstance(value, (list, dict)) else value for name, value in row.items()}


def _drawn(draw):
    """A figure with what a function draws on its axes."""
    with settings():
        made, axes = figure(6.4, 3.8)
        draw(axes)
        return made
