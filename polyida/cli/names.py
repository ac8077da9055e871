"""What has a name: problems, integrators, and the studies that come with polyida, scripts beside the package or within it."""

import ast
import re
import runpy
import sys
from pathlib import Path

from polyida import registry
from polyida.cli import screen


def folder() -> Path:
    """Where the scripts lie, each beside the folder of what it is made of."""
    package = Path(__file__).resolve().parents[1]
    within = package / "studies"
    return within if within.is_dir() else package.parent / "studies"


def scripts() -> dict[str, Path]:
    """{name: script}, names as they are typed: work-precision is work_precision.py."""
    return {typed(path.stem): path for path in sorted(folder().glob("*.py"))}


def typed(name: str) -> str:
    """A study's name as it is typed and listed."""
    return name.replace("_", "-")


def title(script: Path) -> str:
    """What a script says of itself, up to its first colon or stop; nothing of it is executed."""
    said = ast.get_docstring(ast.parse(script.read_text(encoding="utf-8"))) or ""
    return re.split(r"[.:](?: |$)", " ".join(said.split()))[0]


def run(name: str, arguments: list[str]) -> None:
    """Run a script as `python studies/NAME.py ...` does, in the folder that is the current one. Ends with SystemExit where the script does."""
    from polyida.cli.study import PROGRAM

    script, before = scripts()[typed(name)], (sys.argv, sys.path)
    program = PROGRAM.set(f"polyida study {typed(name)}")
    sys.argv, sys.path = [str(script), *arguments], [str(script.parent), *sys.path]  # which processes that it starts take on
    try:
        runpy.run_path(str(script), run_name="__main__")
    finally:
        sys.argv, sys.path = before
        PROGRAM.reset(program)


LISTED = {"compared": "quantity", "source": "source"}


def problems() -> list[dict]:
    """{name, what, compared, source} of each; the last two are empty for a user's."""
    from polyida.problems import ABOUT

    return [
        {"name": name, "what": _description(registry.find(registry.problems, name))}
        | {told: ABOUT[name][key].split(";")[0] if name in ABOUT else "" for told, key in LISTED.items()}
        for name in registry.problems
    ]


def integrators() -> list[dict]:
    """{name, what} of each; those of one class stand once, by the shorter name."""
    from polyida.study.chosen import KNOWN

    short = {of_class: name for name, (of_class, *_) in KNOWN.items()}
    return [
        {"name": short.get(name, name), "what": _first_line(registry.find(registry.integrators, name))} for name in registry.integrators
    ]


def studies() -> list[dict]:
    """{name, what} of those that come with polyida and of those of the registry."""
    own = [{"name": name, "what": registry.find(registry.studies, name).title} for name in registry.studies]
    return [{"name": name, "what": title(path)} for name, path in scripts().items()] + own


def show(found: dict[str, list[dict]]) -> None:
    """Print a table of each kind."""
    for kind, things in found.items():
        rows = [[thing["name"], _in_lines(thing)] for thing in things]
        screen.texts([kind[:-1] if kind != "studies" else "study", "what it is"], rows)


def _in_lines(thing):
    more = [f"{key}: {thing[key]}" for key in LISTED if thing.get(key)]
    return "\n".join([thing["what"], *more, *[""] * bool(more)])


def _description(function):
    """First line of what a problem's function, or its module where that holds one problem, says of itself."""
    return _first_line(sys.modules[function.__module__] if getattr(function, "__name__", "") == "problem" else function)


def _first_line(described):
    return (described.__doc__ or "").strip().split("\n")[0]
