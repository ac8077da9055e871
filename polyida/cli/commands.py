"""The commands of `polyida`. Exit codes: 0 success, 1 a run failed (its frames are saved), 2 invalid input."""

import shlex
import sys
from contextlib import nullcontext, suppress
from pathlib import Path
from types import FunctionType
from typing import Annotated

import typer

from polyida import registry
from polyida.cli import options
from polyida.cli.options import COMPUTE, LOOK, STUDY, Groups, examples, flag, option, study_scripts
from polyida.cli.output import Grid, document, file_errors, prepare, print_grid, print_lines, print_texts, progress_display
from polyida.errors import InputError

INTERRUPTED = 130  # exit code that the shell expects after Ctrl-C
EXAMPLES = {
    "polyida compare double-plate": "three integrators on one scene: a table and a report",
    "polyida compare double-plate --cells 400": "the same with a finer mesh",
    "polyida compare double-plate --cells 40 --order 2": "the same with quadratic cells",
    "polyida run my_scene.py:build": "a scene of yours, in my_scene.py: `def build(): ... return scene`",
    "polyida list": "names of scenes, integrators and studies",
    "polyida COMMAND --help": "more on each command",
}
TITLE = "Flexible multibody dynamics in the plane: one model through six integrators."
app = typer.Typer(
    cls=Groups, no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None, help=TITLE, epilog=examples(EXAMPLES)
)


def _command(group, lines, name=None, **settings):
    """Decorator of a command of a group; lines: {example: what it does}."""
    return app.command(name, rich_help_panel=group, epilog=examples(lines), **settings)


def main(args=None):
    """Run the command line; returns the exit code."""
    args = sys.argv[1:] if args is None else list(args)
    prepare()
    try:
        with file_errors():
            if empty := [arg for arg in args if arg == "" or (arg.startswith("--") and arg.endswith("="))]:
                raise InputError(f"{shlex.join(['polyida', *args])}: the argument {empty[0]!r} is empty")
            try:
                app(args, prog_name="polyida", obj=shlex.join(["polyida", *args]))
            except SystemExit as stop:
                if stop.code == INTERRUPTED:
                    print_lines("interrupted", style="red", file=sys.stderr)
                return stop.code or 0
            return 0
    except SystemExit as stop:
        return stop.code or 0
    except InputError as error:
        print_lines(" ".join(str(error).split()), style="red", file=sys.stderr)
        print_lines(getattr(error, "trace", ""), file=sys.stderr)
        return 2


@app.callback(invoke_without_command=True)
def _start(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False):
    """Print the version and end, or go on to a command."""
    if version:
        from polyida import __version__

        typer.echo(f"polyida {__version__}")
        raise typer.Exit


def free_path(path, default, overwrite):
    """Where to write: an explicit path must be free unless `overwrite`; the default gets a number if it exists. Symlinks are followed."""
    target, number = path or default, 2
    if target.is_symlink():
        with suppress(OSError, RuntimeError):  # of a loop, before Python 3.13
            target = target.resolve()
    if target.is_symlink():
        raise InputError(f"{target} is a symlink that leads nowhere but to itself")
    is_used = lambda place: place.exists() and not (place.is_dir() and not any(place.iterdir()))  # noqa: E731
    if overwrite or not is_used(target):
        return target
    if path:
        raise InputError(f"{path} exists: choose another name, or say --overwrite to replace it")
    while is_used(target):
        target = default.with_name(f"{default.stem}-{number}{default.suffix}")
        number += 1
    print_lines(f"{default} exists and is kept; writing {target}")
    return target


OWN_OPTIONS = {"allow_extra_args": True, "ignore_unknown_options": True}  # of a command whose other options are arguments of the scene


def _load_scene(context, scene, **settings):
    """The InitialValueProblem of a command; options that the command does not know are arguments of the function of the scene."""
    from polyida.study.ivp import load
    from polyida.study.scene_options import texts_of

    if scene.startswith("-"):
        raise InputError(f"{scene}: give SCENE before the options of its function")
    return load(scene, texts=texts_of(context.args), known=[option.name for option in context.command.params], **settings)


def _make_folder(folder):
    """Create a folder and those above it. Raises InputError with the reason of the system."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: the folder cannot be made ({error.strerror})") from error


def _load_run(file):
    """Return the Trajectory of a file; the import is made here, so that other commands start faster."""
    from polyida.io.load import load

    return load(file)


@_command(
    COMPUTE,
    {
        "polyida compare double-plate": "generalized-alpha, IDA and Radau IIA against a refined run",
        "polyida compare my_scene.py:build --time 2": "a scene that a function of yours returns",
        "polyida compare my_scene.py:build --mu 0.0": "with another value of its argument mu",
        "polyida compare pendulum --integrators alpha,ida,my.py:Mine": "your integrator beside two of ours",
        "polyida compare double-plate --keep-runs": "with the runs as HDF5 and frames for ParaView",
        "polyida compare pendulum --json > pendulum.json": "the numbers for another program",
    },
    context_settings=OWN_OPTIONS,
)
def compare(
    context: typer.Context,
    scene: options.Scene,
    out: option(Path, "Folder of the report; SCENE-compare by default.") = None,
    cells: options.Cells = None,
    order: options.Order = None,
    time: options.Time = None,
    step: options.Step = None,
    rtol: options.Rtol = None,
    integrators: options.Integrators = None,
    errors: options.Errors = False,
    keep_runs: options.Keep = False,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
):
    """Compare integrators on one scene: a table and a report.

    Errors are measured against a refined run. The report is a folder with a page, figures and their numbers. Other options are arguments of the
    function that builds the scene, typed by their defaults.
    """
    from polyida.show.figure_files import FigureWriter
    from polyida.study import comparison
    from polyida.study.user_files import COMPARED, choose_integrators, create_integrators, errors_of_all

    with document(json) as set_document, FigureWriter() as writer:
        ivp = _load_scene(context, scene, time=time, step=step, cells=cells, order=order)
        names = [name.strip() for name in (integrators or ",".join(COMPARED)).split(",")]
        if "" in names:
            raise InputError(f"--integrators {integrators}: a name is missing between commas")
        choices = choose_integrators(names)
        members = create_integrators(choices, ivp, step=step, rtol=rtol)
        folder = free_path(out, Path(f"{ivp.name}-compare"), overwrite)
        _make_folder(folder)  # before the runs, so that an error costs no time
        try:
            with progress_display() as progress, errors_of_all(choices.values()):
                result = comparison.compare(ivp, None, progress, members, errors, writer)
                data = result.write(folder, context.obj, writer, lambda text: progress("writing the report", None, text), keep_runs)
        finally:
            if not any(folder.iterdir()):
                folder.rmdir()
        set_document(data)
        _print_comparison(result, folder)
    if not result.success:
        raise typer.Exit(1)


def _print_comparison(result, folder):
    """Print the table of a Comparison, its failures and messages, and where the report is."""
    grid = Grid(*result.text_table())
    print_grid(f"{result.ivp.name}: {result.lead}", grid.transposed(), grid, complete_in="the report")
    print_lines(*result.notes, style="red")
    print_lines(*(f"{label}: {run.message}" for label, run in result.runs.items() if run.success and run.message))
    frames = folder / "frames" / "run.pvd"
    print_lines(result.gap_text(), *result.estimates, f"Report: {folder / 'report.html'}", f"ParaView: {frames}" if frames.exists() else "")


@_command(
    COMPUTE,
    {
        "polyida run double-plate --integrator ida --rtol 1e-7": "writes double-plate-ida.h5",
        "polyida run my_scene.py:build --integrator my.py:Mine --step 1e-3": "with an integrator of yours",
        "polyida run --resume double-plate-ida.h5 --time 3": "continues from the end of the run",
    },
    context_settings=OWN_OPTIONS,
)
def run(
    context: typer.Context,
    scene: options.SceneOrNone = None,
    integrator: options.Integrator = None,
    cells: options.Cells = None,
    order: options.Order = None,
    time: options.Time = None,
    step: options.StepOrAuto = None,
    rho_inf: options.RhoInf = None,
    rtol: options.Rtol = None,
    atol: options.Atol = None,
    out: option(Path, "HDF5 file; SCENE-INTEGRATOR.h5 by default.") = None,
    overwrite: options.Overwrite = False,
    resume: option(
        Path,
        "Continue a run that did not reach its end, or to a later --time, in the same file; SCENE is needed only if the model has "
        "functions of your file.",
    ) = None,
    json: options.Json = False,
):
    """Run one integrator on a scene and write an HDF5 file during the run.

    Other options are arguments of the function that builds the scene, typed by their defaults.
    """
    settings = {"step": step, "rho_inf": rho_inf, "rtol": rtol, "atol": atol}
    of_scene = {"cells": cells, "order": order}
    with document(json) as set_document:
        if context.args and not scene:
            raise InputError(f"run: {context.args[0]} is an argument of a scene's function; name the SCENE")
        if resume:
            refused = settings | {"out": out, "overwrite": overwrite or None, "integrator": integrator} | ({} if scene else of_scene)
            if wrong := [name for name, value in refused.items() if value is not None]:
                reason = "--resume continues with the integrator, settings and place of the file"
                raise InputError(f"run: --{wrong[0].replace('_', '-')} has no place here: {reason}")
            ivp = _load_scene(context, scene, time=time, **of_scene) if scene else None
            finished, path = _resumed(resume, time, ivp), resume
        elif scene:
            ivp = _load_scene(context, scene, time=time, step=None if step == "auto" else step, **of_scene)
            finished, path = _new_run(ivp, integrator or "alpha", settings, out, overwrite)
        else:
            raise InputError("run: name a SCENE (polyida list), or --resume RUN.h5")
        if json:
            set_document(_run_data(finished, path, context.obj))
        print_lines(finished.summary(), style="" if finished.success else "red")
        print_lines(f"Saved: {path}")
    if not finished.success:
        raise typer.Exit(INTERRUPTED if finished.status == "interrupted" else 1)


def _resumed(path, time, ivp):
    """The Trajectory of a file, continued to a time, s, or to its end; ivp: has the model if the file does not hold it, or is None."""
    from polyida.run.resume import resume

    t_end = time or _load_run(path).plan.get("t_end") or 1.0
    with progress_display() as progress, ivp.user_errors() if ivp else nullcontext():
        return resume(path, time, model=ivp and ivp.model, progress=lambda t: progress("continuing", t / t_end))


def _new_run(ivp, name, settings, out, overwrite):
    """(Trajectory, its file) of the integrator of a name with those of the settings that are given; the file is written during the run."""
    from polyida.run.solve import solve
    from polyida.study.user_files import choose_integrator, user_errors

    choice = choose_integrator(name)
    member = choice.create(ivp, **{key: value for key, value in settings.items() if value is not None})
    path = free_path(out, Path(f"{ivp.name}-{name.rpartition(':')[2]}.h5"), overwrite)
    if path.suffix not in (".h5", ".hdf5"):
        raise InputError(f"--out {path}: a run is written as HDF5; give a name that ends in .h5")
    _make_folder(path.parent)
    with progress_display() as progress, ivp.user_errors(), user_errors(choice.file):
        progress("preparing kernels", None)
        ivp.warm_up(member)
        places = {"out": path, "overwrite": overwrite, "progress": lambda t: progress(choice.label, t / ivp.t_end)}
        return solve(ivp.model, ivp.t_end, member, q0=ivp.q0, v0=ivp.v0, **places), path


def _run_data(run, file, command):
    """{"figures", "rows", "notes", "machine", "command"} of one run; machine: where it was computed."""
    from polyida.reprs import used_text

    row = {
        "run": str(file),
        "settings": run.integrator if isinstance(run.integrator, str) else used_text(run.integrator, run.settings_used),
        "settings_used": run.settings_used,
        "success": bool(run.success),
        "status": run.status,
        "t_end": float(run.t[-1]) if len(run.t) else None,
        "frames": len(run.t),
        "coordinates": int(run.q.shape[1]),
        "constraints": int(run.lam.shape[1]),
        "cpu_s": float(run.cpu_seconds),
        "wall_s": float(run.wall_seconds),
        "compile_s": float(run.compile_seconds),
        **run.counts.as_dict(),
    }
    with suppress(InputError):  # the file does not contain the model
        row["drift_max"] = float(max(run.drift, default=0.0))
    figures = {key: value for key, value in row.items() if isinstance(value, int | float) and not isinstance(value, bool)}
    notes = [run.message] if run.message else []
    return {"figures": figures, "rows": [row], "notes": notes, "machine": dict(run.machine), "command": command}


@_command(
    STUDY,
    {"polyida list": "names that the other commands know", "polyida list my_file.py": "with the names that a file of yours adds"},
    name="list",
)
def list_names(
    file: Annotated[Path | None, typer.Argument(metavar="FILE.py", help="A file of yours that adds names.")] = None,
    json: options.Json = False,
):
    """List the names of scenes, integrators and studies."""
    from polyida.problems import ABOUT
    from polyida.study.user_files import KNOWN, run_file

    def first_line(described):
        """First line of the docstring of a function or class; empty without one."""
        return (described.__doc__ or "").strip().split("\n")[0]

    with document(json) as set_document:
        if file:
            run_file(file)
        problems, integrators = [], []
        for name in registry.problems:
            function = registry.find(registry.problems, name)
            about = {"compared": "quantity", "source": "source"}
            about = {key: ABOUT[name][entry].split(";")[0] if name in ABOUT else "" for key, entry in about.items()}
            problems.append({"name": name, "what": first_line(function)} | about)
        names = {of_class: name for name, (of_class, *_) in KNOWN.items()}
        for name in registry.integrators:
            integrators.append({"name": names.get(name, name), "what": first_line(registry.find(registry.integrators, name))})
        lists = {"problems": problems, "integrators": integrators, "studies": _studies()}
        set_document(lists) if json else _print_lists(lists)


def _studies():
    """{name, what} of the scripts and of the studies of the registry."""
    registered = [{"name": name, "what": registry.find(registry.studies, name).title} for name in registry.studies]
    return [{"name": name, "what": options.script_title(path)} for name, path in study_scripts().items()] + registered


def _print_lists(lists):
    """Print {kind: entries with name and description} as a table each."""
    for kind, entries in lists.items():
        rows = []
        for entry in entries:
            more = [f"{key}: {entry[key]}" for key in ("compared", "source") if entry.get(key)]
            rows.append([entry["name"], "\n".join([entry["what"], *more, *[""] * bool(more)])])
        print_texts([{"studies": "study"}.get(kind, kind[:-1]), "description"], rows)


@_command(LOOK, {"polyida show run.h5": "status, counts, model and machine of the run", "polyida show run.h5 --json": "the same as data"})
def show(context: typer.Context, file: options.RunFile, json: options.Json = False):
    """Show status, counts and model of a saved run."""
    from polyida.reprs import number_text

    with document(json) as set_document:
        run = _load_run(file)
        if json:
            set_document(_run_data(run, file, context.obj))
            return
        counts, machine = (", ".join(f"{key} {value}" for key, value in data.items()) for data in (run.counts.as_dict(), run.machine))
        kind = "not in the file" if run.model is None else type(run.model).__name__
        rows = [
            ["run", run.summary()],
            ["frames", f"{len(run.t)}" + (f", t = {run.t[0]:g} .. {run.t[-1]:g} s" if len(run.t) else "")],
            ["model", f"{kind}, {run.q.shape[1]} coordinates, {run.lam.shape[1]} constraints"],
            ["integrator", repr(run.integrator)],
            ["settings used", ", ".join(f"{name} {number_text(value)}" for name, value in run.settings_used.items() if value is not None)],
            ["counts", counts],
            ["time", f"{run.cpu_seconds:.2f} CPU s, {run.wall_seconds:.2f} s; compiling {run.compile_seconds:.2f} CPU s"],
            ["made with", machine],
        ]
        print_texts(["", ""], rows, str(file))


@_command(
    LOOK,
    {
        "polyida animate run.h5": "run.gif",
        "polyida animate run.h5 --out run.svg": "a small picture that moves, for a page",
        "polyida animate run.h5 --out run.mp4": "a film (pip install 'polyida[movie]')",
    },
)
def animate(
    file: options.RunFile,
    out: option(Path, "File that ends in .gif, .svg, .html or .mp4 (which needs polyida[movie]); a GIF beside the run by default.") = None,
    frames: option(int, "Frames at most; 80 of a GIF, 40 of an SVG, 25 a second of MP4 by default.", min=1) = None,
    overwrite: options.Overwrite = False,
):
    """Draw the motion of a saved run as an animated GIF, SVG, MP4 or page, plates coloured by von Mises stress."""
    from polyida.show.animations import animation

    run, path = _load_run(file), free_path(out, file.with_suffix(".gif"), overwrite)
    _make_folder(path.parent)
    with progress_display() as progress:
        animation(run, path, frames=frames, overwrite=overwrite, progress=lambda done: progress("drawing", done))
    print_lines(f"Written: {path}")


@_command(LOOK, {"polyida export run.h5 --vtu frames": "frames/run.pvd opens in ParaView"})
def export(
    file: options.RunFile,
    vtu: Annotated[Path, typer.Option(metavar="FOLDER", help="Folder for the VTU frames.")],
    frames: options.Frames = None,
    overwrite: options.Overwrite = False,
):
    """Write the frames of a saved run as VTU files with a PVD collection, for ParaView."""
    from polyida.show.vtu import vtu as write

    run = _load_run(file)
    _make_folder(vtu.parent)
    print_lines(f"Written: {write(run, vtu, overwrite=overwrite, frames=frames)}")


@_command(STUDY, {"polyida info > bug.txt": "what a bug report needs"})
def info(json: options.Json = False):
    """Print versions, processor, threads, the state of the compiler, and what is compiled and where, for bug reports."""
    from polyida import jit
    from polyida.cli.warm import compiled, compiled_text
    from polyida.environment import machine_info

    with document(json) as set_document:
        data, found = machine_info() | {"compilers": "faster" if jit.compilers else "numba's own"}, compiled()
        set_document(data | {"compiled": found})
        if not json:
            print_lines(*(f"{name}: {value}" for name, value in data.items()), f"compiled: {compiled_text(found)}")


@_command(STUDY, {"polyida warm": "once after an installation; later runs compile nothing but functions of yours"})
def warm(json: options.Json = False):
    """Compile the kernels of all integrators and parts on all cores, so that no later run waits for them."""
    from polyida.cli.warm import compiled_text
    from polyida.cli.warm import warm as compile_all

    with document(json) as set_document:
        with progress_display() as display:
            found = compile_all(lambda done, total, name: display("compiling", done / total, f"{done}/{total} {name}"))
        set_document(found)
        if not json:
            print_lines(f"compiled: {compiled_text(found)}")


@_command(
    STUDY,
    {
        "polyida study": "lists the studies",
        "polyida study work-precision --quick": "writes ./work_precision-quick; the same command continues after a stop",
        "polyida study my_study.py:mine --out mine": "a function of yours that returns a result of pi.study",
        "polyida study conditioning --help": "the study's own options",
    },
    context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []},
)
def study(
    context: typer.Context,
    name: options.StudyOrNone = None,
    quick: flag("A small selection, under a minute.", "--quick") = False,
    out: option(Path, "Folder of figures.json and pictures; NAME in the current folder by default.") = None,
    fresh: flag("Run all tasks again, also those that have a result.", "--fresh") = False,
    json: options.Json = False,
    help_: flag("Show this message; with NAME, the study's own options.", "--help") = False,
):
    """Run a study that comes with polyida, or one of yours; without NAME, list the studies."""
    flags = {"--quick": quick, "--fresh": fresh, "--json": json, "--help": help_}
    arguments = [text for text, is_set in flags.items() if is_set] + (["--out", str(out)] if out else []) + context.args
    if name is None and help_:
        typer.echo(context.get_help())
        return
    if name is None:
        with document(json) as set_document:
            lists = {"studies": _studies()}
            set_document(lists) if json else _print_lists(lists)
        return
    from polyida.cli.study import main as run_study
    from polyida.cli.study import run_function, run_script
    from polyida.study.tasks import Study
    from polyida.study.user_files import load_object

    if (script := name.replace("_", "-")) in study_scripts():
        run_script(script, arguments)
        return
    if ".py" not in name and name not in registry.studies:
        raise InputError(f"no study {name!r}; there are {', '.join([*study_scripts(), *registry.studies])}, or give my_study.py:NAME")
    is_study = lambda value: isinstance(value, (Study, FunctionType))  # noqa: E731
    selected = registry.find(registry.studies, name) or load_object(name, registry.studies, is_study, "studies")
    if isinstance(selected, Study):
        run_study(selected, arguments, context.obj)
    else:
        run_function(name, selected, arguments, context.obj, free_path)
