"""Arguments and options of the commands: types, help texts, and completion in the shell. It imports no numpy, so that completion is fast."""

import ast
import re
from glob import escape, glob
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from polyida import registry
from polyida.registry import study_folder

INTEGRATOR_NAMES = ("alpha", "ida", "radau", "energy")


def study_scripts() -> dict[str, Path]:
    """{name of a study: path of its script}; the script of work-precision is work_precision.py."""
    return {path.stem.replace("_", "-"): path for path in sorted(study_folder().glob("*.py"))}


def script_title(script: Path) -> str:
    """The first phrase of a script's docstring; the script is not executed."""
    text = ast.get_docstring(ast.parse(script.read_text(encoding="utf-8"))) or ""
    return re.split(r"[.:](?: |$)", " ".join(text.split()))[0]


def complete_scene(incomplete: str) -> list[str]:
    """Completions of a scene: names of problems, and Python files."""
    return _starting(registry.problems, incomplete) + _files(incomplete)


def complete_integrator(incomplete: str) -> list[str]:
    """Completions of an integrator: its names, and Python files."""
    return _starting([*INTEGRATOR_NAMES, *registry.integrators], incomplete) + _files(incomplete)


def complete_integrators(incomplete: str) -> list[str]:
    """Completions of the last of several names of integrators with commas between them."""
    before, comma, last = incomplete.rpartition(",")
    return [before + comma + name for name in complete_integrator(last)]


def complete_study(incomplete: str) -> list[str]:
    """Completions of a study: its names, and Python files."""
    return _starting([*study_scripts(), *registry.studies], incomplete.replace("_", "-")) + _files(incomplete)


def _starting(names, incomplete):
    """The names that start with what was typed so far."""
    return [name for name in names if name.startswith(incomplete)]


def _files(incomplete):
    """Python files, and folders that may contain them."""
    return sorted(glob(f"{escape(incomplete)}*.py")) + sorted(glob(f"{escape(incomplete)}*/"))


def option(kind, text, *names, **more):
    """The annotated type of an option of a command that may be left out; kind: of its value, text: its help."""
    return Annotated[kind | None, typer.Option(*names, help=text, **more)]


def flag(text, *names):
    """The annotated type of an option without a value, True if it is given."""
    return Annotated[bool, typer.Option(*names, help=text)]


SCENE_HELP = "A name from `polyida list`, or my_scene.py:build (the file is executed)."
Scene = Annotated[str, typer.Argument(metavar="SCENE", help=SCENE_HELP, autocompletion=complete_scene)]
SceneOrNone = Annotated[str | None, typer.Argument(metavar="SCENE", help=SCENE_HELP, show_default=False, autocompletion=complete_scene)]
STUDY_HELP = "A name from the list, or my_study.py:NAME (the file is executed)."
StudyOrNone = Annotated[str | None, typer.Argument(metavar="NAME", help=STUDY_HELP, show_default=False, autocompletion=complete_study)]
RunFile = Annotated[Path, typer.Argument(metavar="RUN.h5", help="A run saved by `polyida run` or `polyida compare`.")]
Overwrite = flag("Replace existing files.", "--overwrite", "--force")
Keep = flag("Also write each run as HDF5, and VTU frames for ParaView.", "--keep-runs")
Errors = flag("Estimate the errors of runs of generalized-alpha too, by their adjoint.", "--errors")
Json = flag("One JSON document on standard output; all other output goes to the error stream.", "--json")
Cells = option(int, "Polygons in each plate.")
Order = option(int, "Order of the cells: 1, or 2 for quadratic ones.")
Time = option(float, "Time to simulate, s.")
Step = option(float, "Step of integrators that require one, and of generalized-alpha, s.")
StepOrAuto = Annotated[
    Any,
    typer.Option(
        parser=lambda text: text if text == "auto" else float(text),
        metavar="FLOAT|auto",
        help="Step of generalized-alpha and energy-momentum, s; Radau IIA then uses this fixed step. auto: error control.",
    ),
]
RhoInf = option(float, "Spectral radius of generalized-alpha at infinite frequency, in [0, 1).")
Rtol = option(float, "Relative tolerance of IDA, Radau IIA, and of your integrators that accept one.")
Atol = option(float, "Absolute tolerance of IDA and Radau IIA for q, m.")
NAMES = "alpha (generalized-alpha), ida, radau (Radau IIA), energy (energy-momentum), or my_file.py:NAME, a class, function of h, or object"
Integrator = option(str, f"{NAMES}; alpha by default.", autocompletion=complete_integrator)
Integrators = option(
    str,
    f"Names with commas between them: {NAMES}; alpha,ida,radau by default. They get --step and --rtol if they accept them.",
    autocompletion=complete_integrators,
)
Frames = option(int, "Frames at most, evenly spread in time; all by default.", min=1)
COMPUTE, LOOK, STUDY = GROUPS = "Compute", "Look at a run", "Studies and names"


class Groups(TyperGroup):
    """The commands in the help, each in its group."""

    def format_commands(self, ctx, formatter):
        """Write the help text of the commands to `formatter`: one section for each group, one line for each command."""
        for group in GROUPS:
            commands = [self.commands[name] for name in self.list_commands(ctx) if self.commands[name].rich_help_panel == group]
            with formatter.section(group):
                formatter.write_dl([(command.name, command.get_short_help_str(120)) for command in commands])


def examples(lines: dict[str, str]) -> str:
    """The end of a command's help, {command: what it does}, in lines that are not wrapped."""
    return "\b\nExamples:\n" + "\n".join(f"  {typed}\n      {what}" for typed, what in lines.items())
