"""The command line of studies: a `Study`, as the scripts in studies/ define it, and functions that return a Result of pi.study."""

import argparse
import inspect
import json
import runpy
import sys
from contextlib import nullcontext, suppress
from contextvars import ContextVar
from pathlib import Path

from polyida.cli.options import study_scripts
from polyida.cli.output import TaskProgress, document, file_errors, prepare, print_lines, print_result, progress_display
from polyida.errors import InputError, printable
from polyida.show.figure_files import FigureWriter
from polyida.study.result import Result, StudyResult
from polyida.study.tasks import count_outdated, run_tasks
from polyida.study.user_files import user_errors

PROGRAM = ContextVar("PROGRAM", default="")  # the command that started a study's script; empty: Python
FEW_PICTURES = 4  # a second process that renders is faster for more pictures


def main(study, arguments=None, command=None):
    """Run a Study from the command line: `--quick`, `--out FOLDER`, `--fresh`, `--json`, and the study's own options.

    It prints the table and writes figures.json and report.html. Failed tasks are rows; figures that need them are null. command: shown in the
    report, of a study that is no script. Exit code 2: invalid input; 1: stopped, the disk is full, or every task failed. Finished rows stay.
    """
    prepare()
    own = getattr(study.run, "__module__", "") == "__main__"  # a script of a user
    program = PROGRAM.get() or f"python {sys.argv[0] if own else f'studies/{study.name}.py'}"
    options, values = _options_of(study, program, arguments)
    quick = options.quick
    out = Path(options.out or "-".join([study.name, *values, *["quick"] * quick]))
    command = command or " ".join([program, *["--quick"] * quick, *(f"--{key} {value}" for key, value in values.items())])
    name, tasks = study.name, out / "tasks"
    try:
        for key, value in values.items():
            study = study.options[key][1](value)
        _require_own_folder(out, study.name)
        with progress_display() as display:
            rows = run_tasks(study, quick, tasks, TaskProgress(name, display), options.fresh)
        result = StudyResult(study, rows, quick)
        with FigureWriter() if len(result.report_pictures()) > FEW_PICTURES else nullcontext() as writer:
            data = result.write(out, command, writer)
    except InputError as error:
        _exit_with(f"error: {error}")
    except (KeyboardInterrupt, OSError) as error:
        reason = "stopped" if isinstance(error, KeyboardInterrupt) else f"error: {error}"
        sys.exit(printable(f"{reason}; finished rows are in {tasks}, the same command continues from there"))
    try:
        with file_errors(), document(options.json) as set_document:
            set_document(data)
            print_result(result, [out / "report.html", out / "figures.json"])
            if count := count_outdated(study, quick, tasks):
                print_lines(f"{count} of {len(rows)} results are of an earlier state of the code; --fresh runs them again")
    except InputError as error:
        _exit_with(f"error: {error}; the figures are in {out}")
    if rows and all(row.get("error") for row in rows):
        sys.exit(f"error: {'the only task' if len(rows) == 1 else f'each of {len(rows)} tasks'} failed")
    return data


def _options_of(study, program, arguments):
    """(options of all studies, {option of this study: its text}) on the command line."""
    parser = _parser(program, study.title, "a small selection, under a minute", f"folder of the report (default {study.name})")
    parser.add_argument("--fresh", action="store_true", help="run every task again, also those that have a result")
    for name, (meaning, _) in study.options.items():
        parser.add_argument(f"--{name}", metavar=name.upper(), help=meaning)
    options = parser.parse_args(arguments)
    return options, {name: getattr(options, name) for name in study.options if getattr(options, name) is not None}


def _require_own_folder(out, name):
    """Raise InputError unless a folder is new, empty, or that of the study of this name."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file; give a folder with --out")
    if out.exists() and any(out.iterdir()) and not any((out / known).exists() for known in ("tasks", "figures.json")):
        raise InputError(f"{out}: has something in it that no study made; give another folder with --out")
    other = name
    with suppress(OSError, ValueError, AttributeError):
        other = json.loads((out / "figures.json").read_text(encoding="utf-8")).get("study", name)
    if other != name:
        raise InputError(f"{out}: has the figures of the study {other}; give another folder with --out")


def _exit_with(reason):
    """End with the exit code 2 of invalid input, and the reason on the error stream."""
    print_lines(reason, file=sys.stderr)
    sys.exit(2)


def _parser(program, title, quick, out):
    """The parser of --quick, --out and --json with help texts, to which others are added."""
    parser = argparse.ArgumentParser(prog=program, description=title)
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--out", type=Path, help=out)
    parser.add_argument("--json", action="store_true", help="print figures.json on standard output, and nothing else there")
    return parser


def run_script(name, arguments):
    """Run the script of a study in this process, as `python studies/NAME.py ARGUMENTS` does; sys.argv and sys.path are restored.

    arguments: list of texts. Raises SystemExit if the script does.
    """
    script, before = study_scripts()[name], (sys.argv, sys.path)
    program = PROGRAM.set(f"polyida study {name}")
    sys.argv, sys.path = [str(script), *arguments], [str(script.parent), *sys.path]  # its processes inherit them
    try:
        runpy.run_path(str(script), run_name="__main__")
    finally:
        sys.argv, sys.path = before
        PROGRAM.reset(program)


def run_function(spec, function, arguments, command, free_path):
    """Call the function of `my_study.py:NAME` and write the report of its Result.

    A function with arguments `quick` and `progress` gets them. free_path: as in polyida.cli.commands. Raises InputError if the function
    returns no Result, and for --quick if it has no such argument.
    """
    parser = _parser(
        f"polyida study {spec}", "A study of a user's file.", "call the function with quick=True", "folder of the report (default: NAME)"
    )
    parser.add_argument("--overwrite", "--fresh", action="store_true", help="replace an earlier report")
    options, accepted = parser.parse_args(arguments), inspect.signature(function).parameters
    if options.quick and "quick" not in accepted:
        raise InputError(f"{spec} takes no option --quick: its function has no argument of that name")
    file, name = Path(spec.rpartition(":")[0]), spec.rpartition(":")[2]
    folder = free_path(options.out, Path("-".join([name, *["quick"] * options.quick])), options.overwrite)
    with document(options.json) as set_document:
        with progress_display() as display, user_errors(file):
            progress = lambda done, total, text: display(name, done / max(total, 1), f"{done}/{total} {text}")  # noqa: E731
            values = {"quick": options.quick, "progress": progress}
            result = function(**{key: value for key, value in values.items() if key in accepted})
        if not isinstance(result, Result):
            expected = "a result of pi.study is needed, as work_precision gives"
            raise InputError(f"{spec}: its function returned {type(result).__name__}; {expected}")
        result.report(folder, overwrite=True, command=command)
        set_document(result.as_dict() | {"command": command})
        print_result(result, [folder / "report.html"])
