"""What the commands say to people, to programs and to the shell: help, JSON, names to complete, the studies that come along."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import polyida as pi
from polyida.cli import options
from polyida.cli.commands import app, main
from polyida.cli.study import PROGRAM
from polyida.study.user_files import KNOWN

COMMANDS = [command.name or command.callback.__name__ for command in app.registered_commands]


SCRIPT = '''"""Squares of numbers: a study that comes along.

Further lines say more.
"""

from parts.square import square
from polyida.cli.study import main
from polyida.study.tasks import Study

STUDY = Study("some_squares", "squares", lambda quick: [{"number": k} for k in range(2 if quick else 5)], square,
              lambda rows: {"largest": rows[-1]["square"]}, isolated=True, fresh=False)

if __name__ == "__main__":
    main(STUDY)
'''


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, pages_alone):
    """An empty folder to stand in."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    return tmp_path


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """A folder of studies as an installed package has it, with one in it; one to stand in."""
    place, here = tmp_path / "studies", tmp_path / "here"
    (place / "parts").mkdir(parents=True)
    (place / "parts" / "__init__.py").write_text("")
    (place / "parts" / "square.py").write_text('def square(number):\n    return {"square": number**2}\n')
    (place / "some_squares.py").write_text(SCRIPT)
    here.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setattr(options, "study_folder", lambda: place)
    yield here
    for name in [name for name in sys.modules if name == "parts" or name.startswith("parts.")]:
        del sys.modules[name]


def answer(capsys, *args, code=0):
    """The one document on standard output, and what is said on the error stream."""
    assert main(list(args)) == code
    out, err = capsys.readouterr()
    return json.loads(out), err


def test_the_studies_of_a_clone_are_found_and_told_in_a_line():
    package = Path(pi.__file__).parent
    assert options.study_folder() in (package.parent / "studies", package / "studies")
    found = options.study_scripts()
    assert {"work-precision", "bdf-order", "digits"} <= set(found)
    assert all(options.script_title(path) and "\n" not in options.script_title(path) for path in found.values())


def test_a_study_that_comes_along_runs_where_one_stands(installed, capsys):
    """Its tasks run in a process of their own, which finds them; the name of its file will do."""
    path = [*sys.path]
    data, err = answer(capsys, "study", "some_squares", "--quick", "--json")
    assert data["figures"] == {"largest": 1.0} and data["command"] == "polyida study some-squares --quick"
    assert json.loads((installed / "some_squares-quick" / "figures.json").read_text()) == data
    assert sys.path == path and not PROGRAM.get() and "largest: 1" in err
    assert [place.name for place in installed.parent.joinpath("studies").iterdir() if place.name != "__pycache__"] == [
        "parts",
        "some_squares.py",
    ]


def test_studies_are_listed_and_an_unknown_one_is_told_with_them(installed, capsys):
    assert answer(capsys, "study", "--json")[0] == {"studies": [{"name": "some-squares", "what": "Squares of numbers"}]}
    assert main(["study"]) == 0 and "some-squares  Squares of numbers" in capsys.readouterr().out
    assert main(["study", "cubes"]) == 2 and "no study 'cubes'; there are some-squares, or give" in capsys.readouterr().err
    assert main(["study", "some-squares", "--help"]) == 0 and "polyida study some-squares" in capsys.readouterr().out
    assert main(["study", "--help"]) == 0 and "--fresh" in capsys.readouterr().out


def test_a_folder_of_somebody_s_is_no_place_for_a_study(installed, capsys):
    (installed / "some_squares").mkdir()
    (installed / "some_squares" / "mine.txt").write_text("keep")
    assert main(["study", "some-squares"]) == 2 and "no study made" in capsys.readouterr().err
    assert [path.name for path in (installed / "some_squares").iterdir()] == ["mine.txt"]


def test_compare_answers_with_what_is_in_figures_json(capsys):
    said = ("compare", "pendulum", "--time", "0.1", "--integrators", "ida,energy", "--json", "--out", "r")
    data, err = answer(capsys, *said)
    assert data == json.loads(Path("r/figures.json").read_text()) and data["command"] == f"polyida {' '.join(said)}"
    assert [row["run"] for row in data["rows"]] == ["IDA", "energy-momentum", "refined run"] and "Report: r" in err


def test_run_and_show_answer_with_the_same_of_a_run(capsys):
    begun, err = answer(capsys, "run", "double-plate", "--cells", "6", "--time", "0.005", "--out", "run.h5", "--json")
    shown, _ = answer(capsys, "show", "run.h5", "--json")
    assert all(data["rows"][0].pop(kind) > 0 for data in (begun, shown) for kind in ("cpu_s", "wall_s"))
    assert begun["rows"] == shown["rows"] and begun["figures"]["steps"] == 5 and "Saved: run.h5" in err
    assert main(["show", "absent.h5", "--json"]) == 2 and capsys.readouterr().out == ""


def test_list_answers_with_all_that_has_a_name(capsys):
    data, err = answer(capsys, "list", "--json")
    assert [entry["name"] for entry in data["problems"]] == [*pi.problems.names()] and not err
    assert [entry["name"] for entry in data["integrators"]] == ["alpha", "energy", "ida", "radau", "NonsmoothAlpha", "MoreauJean"]
    assert {"name", "what"} == set(data["studies"][0])


def test_a_user_s_file_that_prints_does_not_spoil_the_document(capsys):
    Path("loud.py").write_text('import polyida as pi\nprint("loud")\n\ndef build():\n    return pi.problems.get("pendulum")\n')
    data, err = answer(capsys, "run", "loud.py:build", "--time", "0.05", "--json")
    assert data["figures"]["steps"] > 0 and "loud" in err


@pytest.mark.parametrize("command", [[], *([name] for name in COMMANDS)])
def test_help_shows_what_may_be_typed(capsys, command):
    assert main([*command, "--help"]) == 0
    out = capsys.readouterr().out
    examples = [line.split() for line in out.partition("Examples:")[2].splitlines() if line.strip().startswith("polyida")]
    assert examples and all(len(line) <= 100 for line in out.splitlines())
    assert {words[1] for words in examples} <= ({*COMMANDS, "COMMAND"} if not command else {*command})


def test_names_and_files_are_completed():
    Path("mine.py").write_text("")
    Path("my folder").mkdir()
    Path("my folder/deep.py").write_text("")
    assert options.complete_scene("double") == ["double-plate", "double-plate-motors"] and options.complete_scene("m") == [
        "mine.py",
        "my folder/",
    ]
    assert options.complete_scene("my folder/") == ["my folder/deep.py"]
    assert options.complete_integrators("alpha,i") == ["alpha,ida"] and "alpha,mine.py" in options.complete_integrators("alpha,")
    assert options.complete_study("work_p") == ["work-precision"]
    assert set(options.INTEGRATOR_NAMES) == set(KNOWN)


def test_the_shell_is_told_names_without_a_heavy_import():
    said = "import sys; from polyida.cli.commands import main\ntry: main([])\nfinally: print([n for n in ('numpy', 'rich.table') if n in sys.modules])"
    shell = {"_POLYIDA_COMPLETE": "complete_bash", "COMP_WORDS": "polyida compare double", "COMP_CWORD": "2"}
    ended = subprocess.run([sys.executable, "-c", said], env=os.environ | shell, capture_output=True, text=True, check=True)
    assert ended.stdout.split("\n")[:3] == ["double-plate", "double-plate-motors", "[]"]


def test_info_prints_what_a_bug_report_needs(capsys):
    assert main(["info", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"python", "polyida", "numba", "processor", "cores", "compilers"} <= found.keys()
