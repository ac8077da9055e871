"""What follows from a study's rows, part by part, and its folder: report.html, figures.json, pictures as PNG, PDF and CSV.

A part that cannot be formed is told and spoils no other.
"""

import json
import math
import shlex
import sys
from contextlib import nullcontext
from dataclasses import dataclass, field
from itertools import chain, takewhile
from pathlib import Path

from polyida.errors import InputError
from polyida.show import html
from polyida.show.html import missing, shown
from polyida.show.press import Press
from polyida.show.style import figure, settings


@dataclass
class Findings:
    """figures: {name: number}, NaN where it could not be formed; notes: lines; pictures: of the report."""

    figures: dict
    notes: list
    pictures: list = field(default_factory=list)


def findings(study, rows):
    """All of a study's findings, whatever rows failed: the `headline` figures are there in any case.

    figures, notes and draw of a study are a function of the rows each, or a tuple of such functions, each formed alone.
    """
    figures, unformed = {name: math.nan for name in study.headline}, []
    for found in _formed(study.figures, unformed, rows):
        figures |= {name: float(value) for name, value in found.items()}
    missing = [name for name, value in figures.items() if not math.isfinite(value)]
    lines = [line for found in _formed(study.notes, unformed, rows) for line in found]
    pictures = [path for found in _formed(study.draw, unformed, rows) for path in found]
    lines += [f"no value, no run that went well gives one: {', '.join(missing)}"] if missing else []
    return Findings(figures, lines + unformed + failures(study, rows), pictures)


def columns_of(study, rows):
    """The columns of a study's table."""
    return study.columns or tuple(name for name in dict.fromkeys(chain(*rows)) if name not in ("error", "traceback"))


def failures(study, rows):
    """A line for each failed task."""
    names = {name for task in study.tasks(False) + study.tasks(True) for name in task}
    failed = [(", ".join(f"{name} {row[name]}" for name in row if name in names), row["error"]) for row in rows if row.get("error")]
    return [f"failed: {name[:100]}: {error}" for name, error in failed]


def shortened(study):
    """A line on what the short selection of a study leaves out: the values that it does not have, name by name."""
    short, full = study.tasks(True), study.tasks(False)
    absent = [line for name in dict.fromkeys(chain(*full)) if (line := _absent(name, _values(short, name), _values(full, name)))]
    told = f"the short selection has {len(short)} runs, the full one {len(full)}; not in the short one: {'; '.join(absent)}"
    return [told] if absent else []


def _values(tasks, name):
    return dict.fromkeys(task[name] for task in tasks if isinstance(task.get(name), (str, int, float)) and not isinstance(task[name], bool))


def _absent(name, short, full, told=8):
    """The values of a name that the short selection does not have: names all of them, numbers where they are few."""
    found = [value if isinstance(value, str) else f"{value:g}" for value in full if value not in short]
    named = len(found) <= told or any(isinstance(value, str) for value in full)
    return f"{name} {', '.join(found) if named else f'of {len(found)} values'}" if found else ""


def _formed(parts, unformed, *arguments):
    """What each part gives; of one that raises, a line in `unformed`."""
    for part in parts if isinstance(parts, tuple) else (parts,):
        try:
            yield part(*arguments)
        except Exception as error:  # noqa: BLE001, rows may lack anything: what else they tell must come out all the same
            reason = str(error) if isinstance(error, LookupError) and " " in str(error) else f"{type(error).__name__}: {error}"
            unformed.append(f"not formed: {part.__name__.strip('_')}: {reason}")


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
