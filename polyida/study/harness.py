"""Many runs, one table: a study's tasks are independent, each leaves one file, and what is there already is not run again."""

import hashlib
import json
import os
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable


@dataclass(frozen=True)
class Study:
    """What to vary, what to measure, what to plot.

    tasks(quick): list of dictionaries of plain values, one a run. run(**task): a dictionary of plain values, the row's results.
    figures(rows): {name: number}, the study's findings. draw(rows, folder): writes pictures, returns their paths. columns: of the
    table, all where empty. limit: seconds after which an isolated task counts as hanging; isolated: run each task in a process of
    its own, so that a crash is a row; notes(rows): lines that say what failed and what the numbers mean.
    """

    name: str
    title: str
    tasks: Callable
    run: Callable
    figures: Callable
    draw: Callable = lambda rows, folder: []
    columns: tuple = ()
    isolated: bool = False
    limit: float = 600.0
    notes: Callable = field(default=lambda rows: [])


def key_of(study, task):
    """File name of a task: stable for the same values."""
    text = json.dumps(task, sort_keys=True, default=str)
    return hashlib.sha256(f"{study.name} {text}".encode()).hexdigest()[:16]


def write_whole(path, text):
    """Write a text file so that it is there whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    with open(partial, "w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)


def results(study, quick, folder, progress=lambda done, total, task: None):
    """The rows of all tasks: those with a whole file in `folder` are read, the others run. A failing run is a row."""
    from polyida.study.isolation import run_isolated

    folder.mkdir(parents=True, exist_ok=True)
    rows, tasks = [], study.tasks(quick)
    for done, task in enumerate(tasks):
        progress(done, len(tasks), task)
        path = folder / f"{key_of(study, task)}.json"
        row = _read(path)
        if row is None:
            row = run_isolated(study.run, task, study.limit) if study.isolated else _run_here(study.run, task)
            write_whole(path, json.dumps(task | row, default=plain))
            row = _read(path)
        rows.append(row)
    progress(len(tasks), len(tasks), {})
    return rows


def _run_here(run, task):
    try:
        return {"error": ""} | run(**task)
    except Exception as error:  # a task's failure, whatever it is, is a row of the table
        return {"error": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc(limit=-4)}


def _read(path):
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def plain(value):
    if hasattr(value, "item") and getattr(value, "size", 1) == 1:
        return value.item()
    return value.tolist() if hasattr(value, "tolist") else str(value)
