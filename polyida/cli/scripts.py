"""The studies that come with polyida: scripts in a folder beside the package, in a clone, or within it, where it is installed."""

import ast
import re
import runpy
import sys
from pathlib import Path


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
