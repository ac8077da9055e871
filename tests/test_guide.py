"""The guide's pages and examples say what is: their programs run, what they name exists, all pages and all public names are found."""

import ast
import re
from pathlib import Path

import pytest

import polyida as pi

ROOT = Path(__file__).parents[1]
GUIDE = ROOT / "studies" / "guide"
PAGES = {str(page.relative_to(GUIDE).with_suffix("")): page.read_text(encoding="utf-8") for page in sorted(GUIDE.rglob("*.md"))}
EXAMPLES = {path.name: path.read_text(encoding="utf-8") for path in sorted((GUIDE / "examples").glob("*.py"))}
TEXTS = PAGES | EXAMPLES | {"README": (ROOT / "README.md").read_text(encoding="utf-8")}
MADE = "gallery/index"  # by the build
FENCE = r"^```{}\n(.*?)^```$"


def blocks(text, fence):
    """What stands in blocks behind one kind of fence."""
    return re.findall(FENCE.format(fence), text, re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", [name for name, text in PAGES.items() if blocks(text, "python")])
def test_programs_of_a_page_run_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "guide"}
    for program in blocks(PAGES[page], "python"):
        exec(compile(program, page, "exec"), names)


@pytest.mark.parametrize("name", TEXTS)
def test_what_a_text_names_exists(name):
    for program in blocks(TEXTS[name], r"\{code-block\} python"):
        ast.parse(program)
    for dotted in set(re.findall(r"\bpi\.(\w+(?:\.[a-z_]\w*)?)", TEXTS[name])):
        thing = pi
        for part in dotted.split("."):
            thing = getattr(thing, part)


@pytest.mark.parametrize("name", TEXTS)
def test_commands_of_a_text_exist(name):
    from polyida.cli.commands import app

    known = {command.name or command.callback.__name__ for command in app.registered_commands}
    assert set(re.findall(r"(?:^ +|`)polyida ([a-z]\w*)", TEXTS[name], re.MULTILINE)) <= known
    for script in re.findall(r"python (studies/[a-z_/]+\.py)", TEXTS[name]):
        assert (ROOT / script).is_file()


def test_every_page_is_in_a_table_of_contents():
    listed = {"index"}
    for name, text in PAGES.items():
        for entries in blocks(text, r"\{toctree\}"):
            folder = name.rpartition("/")[0]
            lines = [line for line in entries.splitlines() if line and not line.startswith(":")]
            listed |= {f"{folder}/{line}" if folder else line for line in lines}
    assert listed == {*PAGES, MADE}


def test_every_public_name_is_in_the_api():
    shown = {name for text in PAGES.values() for name in re.findall(r"^\.\. auto\w+:: polyida\.(.+)$", text, re.MULTILINE)}
    assert {*pi._PLACES, *pi._MODULES.values()} <= shown


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_begins_with_what_it_is(name):
    title, rule, *_ = ast.get_docstring(ast.parse(EXAMPLES[name])).splitlines()
    assert title and rule == "=" * len(title)


def test_the_readme_shows_small_pictures_for_light_and_dark_pages():
    named = re.findall(r"!\[.+\]\((.+)\)", TEXTS["README"])
    pictures = [(ROOT / name).read_text(encoding="utf-8") for name in named]
    assert len(pictures) > 1 and "<animate" in pictures[0]
    assert all(len(text) < 150_000 and "prefers-color-scheme: dark" in text for text in pictures)


def test_steel_is_steel():
    stiff = [float(value) for text in TEXTS.values() for value in re.findall(r"steel = pi\.Material\(E=([\d.e]+)", text)]
    assert stiff and all(190e9 < value < 220e9 for value in stiff)


def test_files_of_the_map_exist():
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = {name for name in re.findall(r"`([\w./]+)`", text) if "/" in name or name.endswith(".py")}
    missing = [
        name for name in named if not any((folder / name).exists() for folder in (ROOT, ROOT / "polyida", *(ROOT / "polyida").iterdir()))
    ]
    assert len(named) > 20 and not missing
