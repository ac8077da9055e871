"""A study of a user's that is a function: what it returns, a Result, becomes a table and a report."""

import argparse
import inspect
from pathlib import Path

from polyida.cli.places import free
from polyida.cli.screen import tables
from polyida.cli.screen.progress import bars
from polyida.cli.screen.streams import document, lines
from polyida.errors import InputError
from polyida.study.comparison.scene_file import users_code
from polyida.study.result import Result, cell


def run(spec, function, arguments, command):
    """Call the function that `my_study.py:mine` names and write the report of what it returns.

    `quick` and `progress` are given to functions that take them. Raises InputError where that is no Result of pi.study, and for --quick
    of a function that does not take it.
    """
    options, taken = _parser(spec).parse_args(arguments), inspect.signature(function).parameters
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
        tables.show(found.title, tables.Grid([heading for heading, _ in columns.values()], grid), whole="the report")
        lines(*(f"{figure}: {value:.6g}" for figure, value in found.figures.items()), found.lead, *found.notes)
        lines(f"Report: {written / 'report.html'}")


def _parser(spec):
    made = argparse.ArgumentParser(prog=f"polyida study {spec}", description="A study of a file of yours.")
    made.add_argument("--quick", action="store_true", help="given to the function as quick=True")
    made.add_argument("--out", type=Path, help="folder of the report (default: the function's name)")
    made.add_argument("--overwrite", "--fresh", action="store_true", help="replace what is in the folder")
    made.add_argument("--json", action="store_true", help="one JSON document on standard output")
    return made
