"""The command line of the scripts in studies/: options, progress, table, figures.json, pictures."""

import argparse
import json
import math
import sys
from pathlib import Path

from polyida.errors import InputError
from polyida.machine import machine_info
from polyida.study.harness import of_other_code, plain, results, write_whole


def main(study, arguments=None):
    """Run a study from the command line: `--quick`, `--out FOLDER`, `--fresh`. Prints the table, writes figures.json and pictures.

    Exit code 2 where the input is wrong, 1 where it was stopped or the disk takes no more; what is done then is kept.
    """
    options = parser(study).parse_args(arguments)
    out = Path(options.out or f"{study.name}{'-quick' if options.quick else ''}")
    tasks = out / "tasks"
    try:
        if out.exists() and not out.is_dir():
            raise InputError(f"{out}: is a file; give a folder with --out")
        if options.fresh and tasks.is_dir():
            for path in tasks.glob("*.json"):
                path.unlink()
        rows = results(study, options.quick, tasks, _shown)
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(f"stopped; what is done is in {tasks}, the same command goes on from there")
    except OSError as error:
        sys.exit(f"error: {error}; what is done is in {tasks}, the same command goes on from there")
    figures = {name: float(value) for name, value in study.figures(rows).items()}
    _write_figures(study, options, rows, figures, out)
    _print(study, rows, figures, study.draw(rows, out), out)
    other = of_other_code(study, options.quick, tasks)
    if other:
        print(f"{other} of {len(rows)} results are of an earlier state of the code; --fresh runs them again")
    return json.loads((out / "figures.json").read_text(encoding="utf-8"))


def _write_figures(study, options, rows, figures, out):
    """figures.json: strict JSON, so that what is not finite is null there."""
    command = f"python studies/{study.name}.py{' --quick' if options.quick else ''}"
    kept = [{name: value for name, value in row.items() if name != "traceback"} for row in rows]
    data = {"figures": figures, "rows": kept, "machine": machine_info(), "command": command}
    text = json.dumps(_finite(json.loads(json.dumps(data, default=plain))), indent=1, allow_nan=False)
    write_whole(out / "figures.json", text)


def _finite(value):
    if isinstance(value, dict):
        return {name: _finite(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def parser(study):
    """The command line of a study."""
    made = argparse.ArgumentParser(prog=f"studies/{study.name}.py", description=study.title)
    made.add_argument("--quick", action="store_true", help="a small selection, under a minute")
    made.add_argument("--out", help=f"folder for figures.json, pictures and one file a task (default {study.name})")
    made.add_argument("--fresh", action="store_true", help="run every task again, also those that have a result")
    return made


def _shown(done, total, task):
    if sys.stderr.isatty() or done in (0, total):
        name = ", ".join(f"{key} {value}" for key, value in task.items())
        print(f"\r\033[K{done}/{total} {name[:100]}", end="" if done < total else "\n", file=sys.stderr, flush=True)


def _print(study, rows, figures, pictures, out):
    from rich.console import Console
    from rich.table import Table

    console = Console(width=None if sys.stdout.isatty() else 160)
    columns = study.columns or tuple(dict.fromkeys(name for row in rows for name in row if name not in ("error", "traceback")))
    table = Table(*columns, title=study.title)
    for row in rows:
        table.add_row(*(shown(row.get(name, "")) for name in columns))
    console.print(table)
    for name, value in figures.items():
        console.print(f"{name}: {value:.6g}", highlight=False)
    named = {name for task in study.tasks(False) + study.tasks(True) for name in task}
    failed = [(", ".join(f"{name} {row[name]}" for name in row if name in named), row["error"]) for row in rows if row.get("error")]
    lines = study.notes(rows) + [f"failed: {name[:100]}: {error}" for name, error in failed]
    console.print("What failed, and what the numbers mean:" if lines else "Nothing failed.")
    for line in lines:
        console.print(f"  {line}", highlight=False, markup=False)
    for path in [out / "figures.json", *pictures]:
        console.print(f"wrote {path}", highlight=False)


def shown(value):
    """A table's cell."""
    return f"{value:.4g}" if isinstance(value, float) else "" if value is None else str(value)
