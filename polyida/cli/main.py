"""The command line, and the only place that prints.

Exit codes: 0 done, 1 a run failed (what it has is kept), 2 the input was wrong.
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from polyida import registry
from polyida.cli import tables
from polyida.cli.garbage import collect_rarely
from polyida.cli.places import free, made, make
from polyida.cli.terminal import bars, error, lines, tolerate_letters, writable
from polyida.errors import InputError

INTERRUPTED = 130  # what the shell expects after Ctrl-C
LISTED = {"compared": "quantity", "source": "source"}
HELP = "Flexible multibody dynamics with polygonal finite elements. Start with: polyida compare double-plate"
app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None, help=HELP)


def _option(kind, text, *names):
    return Annotated[kind | None, typer.Option(*names, help=text)]


def _step(text):
    return text if text == "auto" else float(text)


SCENE_HELP = "A name from `polyida list`, or my_scene.py:build (the file is executed)."
Scene = Annotated[str, typer.Argument(metavar="SCENE", help=SCENE_HELP)]
SceneOrNone = Annotated[str | None, typer.Argument(metavar="SCENE", help=SCENE_HELP, show_default=False)]
RESUME_HELP = (
    "Go on with a run that did not reach its end, or to a later --time, in the same file; SCENE is needed "
    "only where a user's file holds functions."
)
RunFile = Annotated[Path, typer.Argument(metavar="RUN.h5", help="A run saved by `polyida run` or `polyida compare`.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", "--force", help="Replace what is there.")]
Cells = _option(int, "Polygons in each plate.")
Time = _option(float, "Time to simulate, s.")
Step = _option(float, "Step of generalized-alpha and energy-momentum, s; with it Radau IIA keeps to one.")
StepOrAuto = Annotated[
    Any,
    typer.Option(
        parser=_step,
        metavar="FLOAT|auto",
        help="Step of generalized-alpha and energy-momentum, s; with it Radau IIA keeps to one. auto: by the error of the run.",
    ),
]
RhoInf = _option(float, "Spectral radius of generalized-alpha at infinite frequency, in [0, 1).")
Rtol = _option(float, "Relative tolerance of IDA and Radau IIA.")
Atol = _option(float, "Absolute tolerance of IDA and Radau IIA for q, m.")
INTEGRATORS_HELP = "alpha (generalized-alpha), ida, radau (Radau IIA), energy (energy-momentum), or my_file.py:NAME, yours"
Integrator = _option(str, f"{INTEGRATORS_HELP}; alpha by default.")
COMPARED_HELP = f"Several of these, with commas: {INTEGRATORS_HELP}; alpha,ida,radau by default."
STUDY_HELP = "A name from the list, or my_study.py:NAME (the file is executed)."
Frames = _option(int, "Frames at most, evenly spread in time; all by default.")


def main(args=None):
    """Run the command line; returns the exit code."""
    args = sys.argv[1:] if args is None else list(args)
    collect_rarely()
    tolerate_letters()
    try:
        with writable():
            return _run(args)
    except SystemExit as stop:
        return stop.code or 0
    except InputError as wrong:
        error(" ".join(str(wrong).split()), getattr(wrong, "trace", ""))
        return 2


def _run(args):
    """The exit code of a command."""
    if empty := [arg for arg in args if arg == "" or (arg.startswith("--") and arg.endswith("="))]:
        raise InputError(f"{shlex.join(['polyida', *args])}: the argument {empty[0]!r} is empty")
    try:
        app(args, prog_name="polyida", obj=shlex.join(["polyida", *args]))
    except SystemExit as stop:
        if stop.code == INTERRUPTED:
            error("interrupted")
        return stop.code or 0
    return 0


@app.callback(invoke_without_command=True)
def _start(version: Annotated[bool, typer.Option("--version", help="Print the version and leave.")] = False):
    if version:
        from polyida import __version__

        typer.echo(f"polyida {__version__}")
        raise typer.Exit


@app.command()
def compare(
    context: typer.Context,
    scene: Scene,
    out: _option(Path, "Folder of the report; SCENE-compare by default.") = None,
    cells: Cells = None,
    time: Time = None,
    step: Step = None,
    rtol: Rtol = None,
    integrators: _option(str, COMPARED_HELP) = None,
    overwrite: Overwrite = False,
):
    """Run the integrators and a refined run on one scene: a table, and a folder with the report."""
    from polyida.show import page, report
    from polyida.show.press import Press
    from polyida.study import chosen
    from polyida.study.compare import measured, prepared, timed
    from polyida.study.job import load

    with Press() as press:
        job = load(scene, time=time, step=step, cells=cells)
        choices = chosen.choices(_names(integrators))
        members = chosen.compared(choices, job, step=step, rtol=rtol)
        folder = free(out, Path(f"{job.name}-compare"), overwrite, lines)
        with made(folder), bars() as tell, chosen.code(choices):
            prepared(job, members, tell)
            press.ready()
            runs = timed(job, members, tell)
            report.begin(job, runs, press)
            found = measured(job, runs, tell)
            written = report.write(found, folder, context.obj, press, lambda what: tell("writing the report", None, what))
    grid = tables.Grid(*page.table(found))
    tables.show(f"{job.name}: {page.system(job)}", grid.turned(), grid, whole="the report")
    lines(*found.notes, style="red")
    lines(*(f"{label}: {run.message}" for label, run in found.runs.items() if run.success and run.message))
    frames = folder / "frames" / "run.pvd"
    lines(page.gap(found), f"Report: {written}", f"ParaView: {frames}" if frames.exists() else "")
    if not found.success:
        raise typer.Exit(1)


@app.command()
def run(
    scene: SceneOrNone = None,
    integrator: Integrator = None,
    cells: Cells = None,
    time: Time = None,
    step: StepOrAuto = None,
    rho_inf: RhoInf = None,
    rtol: Rtol = None,
    atol: Atol = None,
    out: _option(Path, "HDF5 file; SCENE-INTEGRATOR.h5 by default.") = None,
    overwrite: Overwrite = False,
    resume: _option(Path, RESUME_HELP) = None,
):
    """Run one integrator on a scene, written to an HDF5 file as it goes."""
    if resume:
        given = {
            "step": step,
            "rho-inf": rho_inf,
            "rtol": rtol,
            "atol": atol,
            "out": out,
            "overwrite": overwrite or None,
            "integrator": integrator,
            "cells": None if scene else cells,
        }
        _require_none(given, "--resume goes on with the file's own integrator, settings and place")
        _resumed(resume, scene, cells, time)
        return
    if scene is None:
        raise InputError("run: name a SCENE (polyida list), or --resume RUN.h5")
    from polyida.integrate.solve import solve
    from polyida.study import chosen
    from polyida.study.compare import warm_up
    from polyida.study.job import load

    job = load(scene, time=time, step=None if step == "auto" else step, cells=cells)
    settings = {"step": step, "rho_inf": rho_inf, "rtol": rtol, "atol": atol}
    choice = chosen.choice(integrator or "alpha")
    member = choice.made(job, **{name: value for name, value in settings.items() if value is not None})
    path = free(out, Path(f"{job.name}-{choice.name.rpartition(':')[2]}.h5"), overwrite, lines)
    make(path.parent)
    with bars() as tell, job.code(), choice.code():
        tell("preparing kernels", None)
        warm_up(job, member)
        result = solve(
            job.model,
            job.time,
            member,
            q0=job.q0,
            v0=job.v0,
            progress=lambda t: tell(choice.label, t / job.time),
            out=path,
            overwrite=overwrite,
        )
    _saved(result, path)


def _names(listed):
    """Names out of a list with commas; those that are compared by default where it is None."""
    from polyida.study.chosen import COMPARED

    names = [name.strip() for name in (listed or ",".join(COMPARED)).split(",")]
    if "" in names:
        raise InputError(f"--integrators {listed}: a name is missing between commas")
    return names


def _require_none(options, why):
    """Raise InputError for an option that was given."""
    if strange := [name for name, value in options.items() if value is not None]:
        raise InputError(f"run: --{strange[0]} has no place here: {why}")


def _resumed(path, scene, cells, time):
    """Go on with the run in a file; the model comes from `scene` where that is given."""
    from contextlib import nullcontext

    from polyida.integrate.resume import resume
    from polyida.study.job import load

    job = load(scene, time=time, cells=cells) if scene else None
    end = time or _load(path).plan.get("t_end") or 1.0
    with bars() as tell, job.code() if job else nullcontext():
        result = resume(path, time, model=job and job.model, progress=lambda t: tell("going on", t / end))
    _saved(result, path)


def _saved(result, path):
    """Say how a run ended and where it is; leave with 1 where it failed."""
    lines(result.summary(), style=None if result.success else "red")
    lines(f"Saved: {path}")
    if not result.success:
        raise typer.Exit(INTERRUPTED if result.status == "interrupted" else 1)


@app.command("list")
def list_scenes(file: Annotated[Path | None, typer.Argument(metavar="FILE.py", help="A file of yours, with what it adds.")] = None):
    """List the problems and studies that have a name: what is compared with which reference."""
    from polyida.problems.about import ABOUT
    from polyida.study import scene_file

    if file:
        scene_file.executed(file)

    def brief(name):
        about = [f"{told}: {ABOUT[name][key].split(';')[0]}" for told, key in LISTED.items() if name in ABOUT]
        return "\n".join([_description(registry.find(registry.problems, name)), *about, ""])

    tables.texts(["name", "what it is"], [[name, brief(name)] for name in registry.problems])
    _list_studies()


@app.command()
def show(file: RunFile):
    """Show what a saved run holds: how it ended, its work, and what it was made with."""
    loaded = _load(file)
    counts, machine = (", ".join(f"{key} {value}" for key, value in data.items()) for data in (loaded.counts.as_dict(), loaded.machine))
    kind, n, m = type(loaded.model).__name__, loaded.q.shape[1], loaded.lam.shape[1]
    tables.texts(
        ["", ""],
        [
            ["run", loaded.summary()],
            ["frames", f"{len(loaded.t)}" + (f", t = {loaded.t[0]:g} .. {loaded.t[-1]:g} s" if len(loaded.t) else "")],
            ["model", f"{kind}, {n} coordinates, {m} constraints"],
            ["integrator", repr(loaded.integrator)],
            ["counts", counts],
            ["time", f"{loaded.cpu_seconds:.2f} CPU s, {loaded.wall_seconds:.2f} s"],
            ["made with", machine],
        ],
        str(file),
    )


@app.command()
def animate(
    file: RunFile,
    out: _option(Path, "File, its suffix .gif or .mp4 (which needs polyida[movie]); a GIF beside the run by default.") = None,
    frames: _option(int, "Pictures at most; 80 of a GIF, 25 a second of MP4 by default.") = None,
    overwrite: Overwrite = False,
):
    """Draw the plates of a saved run as an animated GIF or as MP4, coloured by von Mises stress."""
    from polyida.show.animation import animation

    loaded, path = _load(file), free(out, file.with_suffix(".gif"), overwrite, lines)
    make(path.parent)
    with bars() as tell:
        animation(loaded, path, frames=frames, overwrite=overwrite, progress=lambda done: tell("drawing", done))
    lines(f"Written: {path}")


@app.command()
def export(
    file: RunFile,
    vtu: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the VTU frames.")],
    frames: Frames = None,
    overwrite: Overwrite = False,
):
    """Write the frames of a saved run as VTU files with a PVD collection, for ParaView."""
    from polyida.show.vtu import vtu as write

    loaded = _load(file)
    make(vtu.parent)
    lines(f"Written: {write(loaded, vtu, overwrite=overwrite, frames=frames)}")


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
def study(
    context: typer.Context,
    name: Annotated[str | None, typer.Argument(metavar="NAME", help=STUDY_HELP, show_default=False)] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A small selection, under a minute.")] = False,
    out: _option(Path, "Folder of figures.json and pictures; NAME in the current folder by default.") = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Run every part again, also those that have a result.")] = False,
    help_: Annotated[bool, typer.Option("--help", help="Show this message; with NAME, the study's own options.")] = False,
):
    """Run a study that comes with polyida, or one of yours; without NAME, list them."""
    from polyida.cli import scripts

    given = {"--quick": quick, "--out": out, "--fresh": fresh, "--help": help_}
    arguments = [text for flag, value in given.items() if value for text in (flag, str(value))[: 1 + (value is not True)]] + context.args
    if name is None:
        typer.echo(context.get_help()) if help_ else _list_studies()
    elif ".py" in name or name in registry.studies:
        _run_study(name, arguments, context.obj)
    elif scripts.typed(name) in scripts.scripts():
        scripts.run(name, arguments)
    else:
        raise InputError(f"no study {name!r}; there are {', '.join([*scripts.scripts(), *registry.studies])}, or give my_study.py:NAME")


def _list_studies():
    """The studies that have a name, with what they are."""
    from polyida.cli import scripts

    own = [[name, registry.find(registry.studies, name).title] for name in registry.studies]
    tables.texts(["study", "what it is"], [[name, scripts.title(path)] for name, path in scripts.scripts().items()] + own)


def _run_study(name, arguments, command):
    """Run a registered study, or the one that `my_study.py:NAME` names."""
    from polyida.cli.study import main as run_study
    from polyida.study import scene_file
    from polyida.study.harness import Study

    book = registry.studies
    run_study(registry.find(book, name) or scene_file.named(name, book, Study, "studies"), arguments, command)


def _load(file):
    """A saved run; InputError where there is none."""
    from polyida.io.load import load

    if not file.is_file():
        raise InputError(f"{file}: there is no such file")
    return load(file)


def _description(function):
    """First line of what a problem's function, or its module where that holds one problem, says of itself."""
    described = sys.modules[function.__module__] if getattr(function, "__name__", "") == "problem" else function
    return (described.__doc__ or "").strip().split("\n")[0]
