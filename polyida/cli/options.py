"""What the commands are given: their arguments and options, each with what its help says."""

from pathlib import Path
from typing import Annotated, Any

import typer

from polyida.cli import complete


def option(kind, text, *names, **more):
    """An option that may be left out."""
    return Annotated[kind | None, typer.Option(*names, help=text, **more)]


def flag(text, *names):
    """An option without a value."""
    return Annotated[bool, typer.Option(*names, help=text)]


def _step(text):
    return text if text == "auto" else float(text)


SCENE_HELP = "A name from `polyida list`, or my_scene.py:build (the file is executed)."
Scene = Annotated[str, typer.Argument(metavar="SCENE", help=SCENE_HELP, autocompletion=complete.scenes)]
SceneOrNone = Annotated[str | None, typer.Argument(metavar="SCENE", help=SCENE_HELP, show_default=False, autocompletion=complete.scenes)]
STUDY_HELP = "A name from the list, or my_study.py:NAME (the file is executed)."
StudyOrNone = Annotated[str | None, typer.Argument(metavar="NAME", help=STUDY_HELP, show_default=False, autocompletion=complete.studies)]
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
Integrator = option(str, f"{NAMES}; alpha by default.", autocompletion=complete.integrator)
Integrators = option(
    str,
    f"Which, with commas between them: {NAMES}; alpha,ida,radau by default. They get --step and --rtol where they take them.",
    autocompletion=complete.integrators,
)
Frames = option(int, "Frames at most, evenly spread in time; all by default.")
