"""What the commands are given: arguments and options, what the help says of them, and what the shell offers for a word that is begun."""

from glob import escape, glob
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from polyida import registry
from polyida.cli import names


def option(kind, text, *names, **more):
    """An option that may be left out."""
    return Annotated[kind | None, typer.Option(*names, help=text, **more)]


def flag(text, *names):
    """An option without a value."""
    return Annotated[bool, typer.Option(*names, help=text)]


def _step(text):
    return text if text == "auto" else float(text)


def scenes(incomplete: str) -> list[str]:
    """Named problems, and files that may hold one."""
    return _begun(registry.problems, incomplete) + _files(incomplete)


def integrator(incomplete: str) -> list[str]:
    """Integrators that have a name, and files that may hold one."""
    return _begun([*ALIASES, *registry.integrators], incomplete) + _files(incomplete)


def integrators(incomplete: str) -> list[str]:
    """The same for the last of several with commas."""
    before, comma, last = incomplete.rpartition(",")
    return [before + comma + name for name in integrator(last)]


def studies(incomplete: str) -> list[str]:
    """Studies that have a name, and files that may hold one."""
    return _begun([*names.scripts(), *registry.studies], incomplete.replace("_", "-")) + _files(incomplete)


def _begun(names, incomplete):
    return [name for name in names if name.startswith(incomplete)]


def _files(incomplete):
    """Python files, and folders on the way to them."""
    return sorted(glob(f"{escape(incomplete)}*.py")) + sorted(glob(f"{escape(incomplete)}*/"))


SCENE_HELP = "A name from `polyida list`, or my_scene.py:build (the file is executed)."
Scene = Annotated[str, typer.Argument(metavar="SCENE", help=SCENE_HELP, autocompletion=scenes)]
SceneOrNone = Annotated[str | None, typer.Argument(metavar="SCENE", help=SCENE_HELP, show_default=False, autocompletion=scenes)]
STUDY_HELP = "A name from the list, or my_study.py:NAME (the file is executed)."
StudyOrNone = Annotated[str | None, typer.Argument(metavar="NAME", help=STUDY_HELP, show_default=False, autocompletion=studies)]
RESUME_HELP = (
    "Go on with a run that did not reach its end, or to a later --time, in the same file; SCENE is needed "
    "only where a user's file holds functions."
)
RunFile = Annotated[Path, typer.Argument(metavar="RUN.h5", help="A run saved by `polyida run` or `polyida compare`.")]
Overwrite = flag("Replace what is there.", "--overwrite", "--force")
Json = flag("One JSON document on standard output; what else there is to say goes to the error stream.", "--json")
Cells = option(int, "Polygons in each plate.")
Time = option(float, "Time to simulate, s.")
Step = option(float, "Step of those that must have one, and of generalized-alpha, s.")
StepOrAuto = Annotated[
    Any,
    typer.Option(
        parser=_step,
        metavar="FLOAT|auto",
        help="Step of generalized-alpha and energy-momentum, s; with it Radau IIA keeps to one. auto: by the error of the run.",
    ),
]
RhoInf = option(float, "Spectral radius of generalized-alpha at infinite frequency, in [0, 1).")
Rtol = option(float, "Relative tolerance of IDA, Radau IIA, and of yours that takes one.")
Atol = option(float, "Absolute tolerance of IDA and Radau IIA for q, m.")
NAMES = "alpha (generalized-alpha), ida, radau (Radau IIA), energy (energy-momentum), or my_file.py:NAME, a class, function of h, or object"
Integrator = option(str, f"{NAMES}; alpha by default.", autocompletion=integrator)
Integrators = option(
    str,
    f"Which, with commas between them: {NAMES}; alpha,ida,radau by default. They get --step and --rtol where they take them.",
    autocompletion=integrators,
)
Frames = option(int, "Frames at most, evenly spread in time; all by default.")


ALIASES = ("alpha", "ida", "radau", "energy")


FIRST = "Flexible multibody dynamics with polygonal finite elements."
COMPUTE, LOOK, STUDY = "Compute", "Look at a run", "Studies and names"
LONGEST = 120  # characters of what the list says of a command
GROUPS = (COMPUTE, LOOK, STUDY)
START = {
    "polyida compare double-plate": "three integrators on one scene: a table and a report",
    "polyida compare double-plate --cells 400": "the same, finer",
    "polyida run my_scene.py:build": "a scene of yours, in my_scene.py: `def build(): ... return scene`",
    "polyida list": "what has a name",
    "polyida COMMAND --help": "more on each",
}


class Groups(TyperGroup):
    """The commands, each in its group."""

    def format_commands(self, ctx, formatter):
        """A section of each group in place of one of all commands."""
        for group in GROUPS:
            commands = [self.commands[name] for name in self.list_commands(ctx) if self.commands[name].rich_help_panel == group]
            with formatter.section(group):
                formatter.write_dl([(command.name, command.get_short_help_str(LONGEST)) for command in commands])


def examples(lines: dict[str, str]) -> str:
    """What stands at the end of a command's help: {what is typed: what it does}, each on lines of its own, which are not wrapped."""
    return "\b\nExamples:\n" + "\n".join(f"  {typed}\n      {what}" for typed, what in lines.items())
