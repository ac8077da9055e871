"""The command line of studies: those in studies/, and functions of a user's that return a Result. Progress, table, figures.json, the report."""

import argparse
import inspect
import json
import re
import sys
from contextvars import ContextVar
from pathlib import Path

from polyida.cli import screen
from polyida.cli.running import free
from polyida.cli.screen import Parts, bars, document, lines, prepare, writable
from polyida.environment import machine_info
from polyida.errors import InputError
from polyida.show.report import finite
from polyida.study.chosen import users_code
from polyida.study.harness import of_other_code, plain, results, write_whole
from polyida.study.report import columns_of, findings, shortened, write_page
from polyida.study.result import Result, cell

PROGRAM = ContextVar("PROGRAM", default="")  # what started a study's script, where that is not Python
MAIN = "error|cpu_s|outcome"  # of the names of results: what a narrow table keeps, beside what was varied


def main(study, arguments=None, command=None):
    """Run a study from the command line: `--quick`, `--out FOLDER`, `--fresh`, `--json`. command: what was typed, of a study that is no
    script.

    Prints the table, writes figures.json and report.html with its pictures. Failed tasks are rows and lines; figures that need them are
    null. Exit code 2 where the input is wrong, 1 where it was stopped or the disk takes no more; what is done then is
    kept.
    """
    prepare()
    options = parser(study).parse_args(arguments)
    out = Path(options.out or "-".join([study.name, *_given(study, options), *["quick"] * options.quick]))
    tasks = out / "tasks"
    try:
        study, typed = _meant(study, options)
        with bars() as tell:
            rows = _results(study, options, out, Parts(study.name, tell))
        found = findings(study, rows)
        found.notes += shortened(study) if options.quick else []
        data = _write_figures(study, command or typed, rows, found, out)
        page = write_page(study, rows, found, data, out)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(f"stopped; what is done is in {tasks}, the same command goes on from there")
    except OSError as error:
        sys.exit(f"error: {error}; what is done is in {tasks}, the same command goes on from there")
    other = of_other_code(study, options.quick, tasks)
    try:
        with writable(), document(options.json) as answer:
            answer(data)
            written = [out / "figures.json", page]
            console = screen.console_of(sys.stdout)
            columns = list(columns_of(study, rows))
            varied = {name for task in study.tasks(True) + study.tasks(False) for name in task}
            details = [name for name in columns if name not in varied and not re.search(MAIN, name)]
            grid = screen.Grid(columns, [[shown(row.get(name, "")) for name in columns] for row in rows], details)
            screen.show(study.title, grid, whole=str(written[-1]))
            for name, value in found.figures.items():
                console.print(f"{name}: {value:.6g}", highlight=False)
            console.print("What failed, and what the numbers mean:" if found.notes else "Nothing failed.")
            for line in found.notes:
                console.print(f"  {line}", highlight=False, markup=False)
            for path in written:
                console.print(f"wrote {path}", highlight=False, soft_wrap=True)
            if other:
                print(f"{other} of {len(rows)} results are of an earlier state of the code; --fresh runs them again")
    except InputError as error:
        print(f"error: {error}; the figures are in {out}", file=sys.stderr)
        sys.exit(2)
    return data


def _given(study, options):
    """{name: value} of the study's own options that are there."""
    return {name: getattr(options, name) for name in study.options if getattr(options, name) is not None}


def _program(study):
    """What starts the study, as it is typed."""
    return PROGRAM.get() or f"python studies/{study.name}.py"


def _meant(study, options):
    """(Study that its own options make of this one, the command)."""
    command, meant = f"{_program(study)}{' --quick' if options.quick else ''}", study
    for name, value in _given(study, options).items():
        meant, command = study.options[name][1](value), f"{command} --{name} {value}"
    return meant, command


def _results(study, options, out, progress):
    tasks = out / "tasks"
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; give a folder with --out")
    if out.exists() and any(out.iterdir()) and not any((out / kept).exists() for kept in ("tasks", "figures.json")):
        raise InputError(f"{out}: has something in it that no study made; give another folder with --out")
    if (made := _study_of(out, study.name)) != study.name:
        raise InputError(f"{out}: has the figures of the study {made}; give another folder with --out")
    if options.fresh and tasks.is_dir():
        for path in tasks.glob("*.json"):
            path.unlink()
    return results(study, options.quick, tasks, progress)


def _study_of(out, mine):
    """The name of the study whose figures are in a folder; mine where none says so."""
    try:
        return json.loads((out / "figures.json").read_text(encoding="utf-8")).get("study", mine)
    except (OSError, ValueError, AttributeError):
        return mine


def _write_figures(study, command, rows, found, out):
    """figures.json, and what it holds: strict JSON, so that what is not finite is null there."""
    kept = [{name: value for name, value in row.items() if name != "traceback"} for row in rows]
    data = {
        "study": study.name,
        "figures": found.figures,
        "notes": found.notes,
        "rows": kept,
        "machine": machine_info(),
        "command": command,
    }
    text = json.dumps(finite(json.loads(json.dumps(data, default=plain))), indent=1, allow_nan=False)
    write_whole(out / "figures.json", text)
    return json.loads(text)


def parser(study):
    """The command line of a study."""
    made = argparse.ArgumentParser(prog=_program(study), description=study.title)
    made.add_argument("--quick", action="store_true", help="a small selection, under a minute")
    made.add_argument("--out", help=f"folder for figures.json, pictures and one file a task (default {study.name})")
    made.add_argument("--fresh", action="store_true", help="run every task again, also those that have a result")
    made.add_argument("--json", action="store_true", help="what figures.json holds on standard output, and nothing else there")
    for name, (meaning, _) in study.options.items():
        made.add_argument(f"--{name}", metavar=name.upper(), help=meaning)
    return made


def shown(value):
    """A table's cell."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return "" if value is None else " ".join(str(value).split())


def run_function(spec, function, arguments, command):
    """Call the function that `my_study.py:mine` names and write the report of what it returns.

    `quick` and `progress` are given to functions that take them. Raises InputError where that is no Result of pi.study, and for --quick
    of a function that does not take it.
    """
    made = argparse.ArgumentParser(prog=f"polyida study {spec}", description="A study of a file of yours.")
    made.add_argument("--quick", action="store_true", help="given to the function as quick=True")
    made.add_argument("--out", type=Path, help="folder of the report (default: the function's name)")
    made.add_argument("--overwrite", "--fresh", action="store_true", help="replace what is in the folder")
    made.add_argument("--json", action="store_true", help="one JSON document on standard output")
    options, taken = made.parse_args(arguments), inspect.signature(function).parameters
    if options.quick and "quick" not in taken:
        raise InputError(f"{spec} takes no option --quick: its function has no argument of that name")
    file, name = Path(spec.rpartition(":")[0]), spec.rpartition(":")[2]
    folder = free(options.out, Path("-".join([name, *["quick"] * options.quick])), options.overwrite, lines)
    with document(options.json) as answer:
        with bars() as tell, users_code(file):
            given = {
                "quick": options.quick,
                "progress": lambda done, total, what: tell(name, done / max(total, 1), f"{done}/{total} {what}"),
            }
            found = function(**{key: value for key, value in given.items() if key in taken})
        if not isinstance(found, Result):
            raise InputError(
                f"{spec}: its function returned {type(found).__name__}; a result of pi.study is needed, as work_precision gives"
            )
        written = found.report(folder, overwrite=True, command=command)
        answer(found.as_dict() | {"command": command})
        columns = found.shown_columns()
        grid = [[cell(row.get(key), form) for key, (_, form) in columns.items()] for row in found.rows]
        screen.show(found.title, screen.Grid([heading for heading, _ in columns.values()], grid), whole="the report")
        lines(*(f"{figure}: {value:.6g}" for figure, value in found.figures.items()), found.lead, *found.notes)
        lines(f"Report: {written / 'report.html'}")
