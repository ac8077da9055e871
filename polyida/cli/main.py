"""The command line, and the only place that prints.

Exit codes: 0 done, 1 a run failed (what it has is kept), 2 the input was wrong.
"""

import shlex
import sys
from json import loads
from pathlib import Path
from types import FunctionType
from typing import Annotated

import typer

from polyida.cli import names, options, running, screen
from polyida.cli.options import COMPUTE, FIRST, LOOK, START, STUDY, Groups, examples, flag, option
from polyida.cli.running import free, made, make, run_told, show_run
from polyida.cli.screen import bars, document, error, lines, prepare, writable
from polyida.errors import InputError

INTERRUPTED = 130  # what the shell expects after Ctrl-C
app = typer.Typer(
    cls=Groups, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None, help=FIRST, epilog=examples(START)
)


def _command(group, shown, name=None, **settings):
    """A command of a group, with {what is typed: what it does}."""
    return app.command(name, rich_help_panel=group, epilog=examples(shown), **settings)


def main(args=None):
    """Run the command line; returns the exit code."""
    args = sys.argv[1:] if args is None else list(args)
    prepare()
    try:
        with writable():
            if empty := [arg for arg in args if arg == "" or (arg.startswith("--") and arg.endswith("="))]:
                raise InputError(f"{shlex.join(['polyida', *args])}: the argument {empty[0]!r} is empty")
            try:
                app(args, prog_name="polyida", obj=shlex.join(["polyida", *args]))
            except SystemExit as stop:
                if stop.code == INTERRUPTED:
                    error("interrupted")
                return stop.code or 0
            return 0
    except SystemExit as stop:
        return stop.code or 0
    except InputError as wrong:
        error(" ".join(str(wrong).split()), getattr(wrong, "trace", ""))
        return 2


@app.callback(invoke_without_command=True)
def _start(version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False):
    if version:
        from polyida import __version__

        typer.echo(f"polyida {__version__}")
        raise typer.Exit


@_command(
    COMPUTE,
    {
        "polyida compare double-plate": "generalized-alpha, IDA and Radau IIA against a refined run",
        "polyida compare my_scene.py:build --time 2": "what a function of yours returns",
        "polyida compare pendulum --integrators alpha,ida,my.py:Mine": "your integrator beside two of ours",
        "polyida compare pendulum --json > pendulum.json": "the numbers, for another program",
    },
)
def compare(
    context: typer.Context,
    scene: options.Scene,
    out: option(Path, "Folder of the report; SCENE-compare by default.") = None,
    cells: options.Cells = None,
    time: options.Time = None,
    step: options.Step = None,
    rtol: options.Rtol = None,
    integrators: options.Integrators = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
):
    """Compare integrators on one scene: a table and a report.

    Each is measured against a refined run; the report is a folder with a page, figures, their numbers and the runs.
    """
    from polyida.show import report
    from polyida.show.press import Press
    from polyida.study import chosen
    from polyida.study.chosen import load
    from polyida.study.compare import measured, prepared, timed

    with document(json) as answer, Press() as press:
        job = load(scene, time=time, step=step, cells=cells)
        named = [name.strip() for name in (integrators or ",".join(chosen.COMPARED)).split(",")]
        if "" in named:
            raise InputError(f"--integrators {integrators}: a name is missing between commas")
        choices = chosen.choices(named)
        members = chosen.compared(choices, job, step=step, rtol=rtol)
        folder = free(out, Path(f"{job.name}-compare"), overwrite, lines)
        with made(folder), bars() as tell, chosen.code(choices):
            prepared(job, members, tell)
            press.ready()
            runs = timed(job, members, tell)
            report.begin(job, runs, press)
            found = measured(job, runs, tell)
            written = report.write(found, folder, context.obj, press, lambda what: tell("writing the report", None, what))
        answer(loads((folder / "figures.json").read_text(encoding="utf-8")))
        grid = screen.Grid(*report.table(found))
        screen.show(f"{job.name}: {report.system(job)}", grid.turned(), grid, whole="the report")
        lines(*found.notes, style="red")
        lines(*(f"{label}: {run.message}" for label, run in found.runs.items() if run.success and run.message))
        frames = folder / "frames" / "run.pvd"
        lines(report.gap(found), f"Report: {written}", f"ParaView: {frames}" if frames.exists() else "")
    if not found.success:
        raise typer.Exit(1)


@_command(
    COMPUTE,
    {
        "polyida run double-plate --integrator ida --rtol 1e-7": "to double-plate-ida.h5",
        "polyida run my_scene.py:build --integrator my.py:Mine --step 1e-3": "with an integrator of yours",
        "polyida run --resume double-plate-ida.h5 --time 3": "goes on from where it ended",
    },
)
def run(
    context: typer.Context,
    scene: options.SceneOrNone = None,
    integrator: options.Integrator = None,
    cells: options.Cells = None,
    time: options.Time = None,
    step: options.StepOrAuto = None,
    rho_inf: options.RhoInf = None,
    rtol: options.Rtol = None,
    atol: options.Atol = None,
    out: option(Path, "HDF5 file; SCENE-INTEGRATOR.h5 by default.") = None,
    overwrite: options.Overwrite = False,
    resume: option(Path, options.RESUME_HELP) = None,
    json: options.Json = False,
):
    """Run one integrator on a scene, into an HDF5 file as it goes."""
    settings = {"step": step, "rho_inf": rho_inf, "rtol": rtol, "atol": atol}
    with document(json) as answer:
        if resume:
            given = settings | {"out": out, "overwrite": overwrite or None, "integrator": integrator, "cells": None if scene else cells}
            running.require_none(given, "--resume goes on with the file's own integrator, settings and place")
            ended, path = running.resumed(resume, scene, cells, time), resume
        elif scene:
            ended, path = running.begun(scene, integrator or "alpha", {"time": time, "cells": cells}, settings, out, overwrite)
        else:
            raise InputError("run: name a SCENE (polyida list), or --resume RUN.h5")
        if json:
            answer(run_told(ended, path, context.obj))
        lines(ended.summary(), style=None if ended.success else "red")
        lines(f"Saved: {path}")
    if not ended.success:
        raise typer.Exit(INTERRUPTED if ended.status == "interrupted" else 1)


@_command(
    STUDY,
    {"polyida list": "what the other commands know by name", "polyida list my_file.py": "with what a file of yours adds"},
    name="list",
)
def list_names(
    file: Annotated[Path | None, typer.Argument(metavar="FILE.py", help="A file of yours, with what it adds.")] = None,
    json: options.Json = False,
):
    """List scenes, integrators and studies that have a name."""
    with document(json) as answer:
        if file:
            from polyida.study import chosen

            chosen.executed(file)
        found = {"problems": names.problems(), "integrators": names.integrators(), "studies": names.studies()}
        answer(found) if json else names.show(found)


@_command(
    LOOK, {"polyida show run.h5": "how it ended, its work, and what it was made with", "polyida show run.h5 --json": "the same as data"}
)
def show(context: typer.Context, file: options.RunFile, json: options.Json = False):
    """Show what a saved run holds."""
    with document(json) as answer:
        loaded = running.loaded(file)
        if json:
            answer(run_told(loaded, file, context.obj))
        else:
            show_run(loaded, file)


@_command(LOOK, {"polyida animate run.h5": "run.gif", "polyida animate run.h5 --out run.mp4": "a film (pip install 'polyida[movie]')"})
def animate(
    file: options.RunFile,
    out: option(Path, "File, its suffix .gif or .mp4 (which needs polyida[movie]); a GIF beside the run by default.") = None,
    frames: option(int, "Pictures at most; 80 of a GIF, 25 a second of MP4 by default.") = None,
    overwrite: options.Overwrite = False,
):
    """Draw the plates of a saved run as an animated GIF or as MP4, coloured by von Mises stress."""
    from polyida.show.animation import animation

    loaded, path = running.loaded(file), free(out, file.with_suffix(".gif"), overwrite, lines)
    make(path.parent)
    with bars() as tell:
        animation(loaded, path, frames=frames, overwrite=overwrite, progress=lambda done: tell("drawing", done))
    lines(f"Written: {path}")


@_command(LOOK, {"polyida export run.h5 --vtu frames": "frames/run.pvd opens in ParaView"})
def export(
    file: options.RunFile,
    vtu: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the VTU frames.")],
    frames: options.Frames = None,
    overwrite: options.Overwrite = False,
):
    """Write the frames of a saved run as VTU files with a PVD collection, for ParaView."""
    from polyida.show.vtu import vtu as write

    loaded = running.loaded(file)
    make(vtu.parent)
    lines(f"Written: {write(loaded, vtu, overwrite=overwrite, frames=frames)}")


@_command(STUDY, {"polyida info > bug.txt": "what a bug report needs"})
def info(json: options.Json = False):
    """Print versions, processor, threads and the state of the compiler: what a bug report needs."""
    from polyida import jit
    from polyida.environment import machine_info

    with document(json) as answer:
        found = machine_info() | {"compilers": "faster" if jit.compilers else "numba's own"}
        answer(found)
        if not json:
            lines(*(f"{name}: {value}" for name, value in found.items()))


@_command(
    STUDY,
    {
        "polyida study": "lists them",
        "polyida study work-precision --quick": "to ./work_precision-quick; the same command goes on where it was stopped",
        "polyida study my_study.py:mine --out mine": "a study of yours: a function that returns a result of pi.study",
        "polyida study conditioning --help": "the study's own options",
    },
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []},
)
def study(
    context: typer.Context,
    name: options.StudyOrNone = None,
    quick: flag("A small selection, under a minute.", "--quick") = False,
    out: option(Path, "Folder of figures.json and pictures; NAME in the current folder by default.") = None,
    fresh: flag("Run every part again, also those that have a result.", "--fresh") = False,
    json: options.Json = False,
    help_: flag("Show this message; with NAME, the study's own options.", "--help") = False,
):
    """Run a study that comes with polyida, or one of yours; without NAME, list them."""
    from polyida import registry
    from polyida.cli import names

    given = {"--quick": quick, "--fresh": fresh, "--json": json, "--help": help_}
    arguments = [text for text, is_given in given.items() if is_given] + (["--out", str(out)] if out else []) + context.args
    if name is None and help_:
        typer.echo(context.get_help())
    elif name is None:
        _list_studies(json)
    elif ".py" in name or name in registry.studies:
        _run_study(name, arguments, context.obj)
    elif names.typed(name) in names.scripts():
        names.run(name, arguments)
    else:
        raise InputError(f"no study {name!r}; there are {', '.join([*names.scripts(), *registry.studies])}, or give my_study.py:NAME")


def _list_studies(json):
    with document(json) as answer:
        found = {"studies": names.studies()}
        answer(found) if json else names.show(found)


def _run_study(name, arguments, command):
    """Run a registered study, or the one that `my_study.py:NAME` names: a Study, or a function that returns a Result."""
    from polyida import registry
    from polyida.cli.study import main as run_study
    from polyida.cli.study import run_function
    from polyida.study import chosen
    from polyida.study.harness import Study

    book, is_one = registry.studies, lambda value: isinstance(value, (Study, FunctionType))
    found = registry.find(book, name) or chosen.named(name, book, is_one, "studies")
    if isinstance(found, Study):
        return run_study(found, arguments, command)
    return run_function(name, found, arguments, command)
