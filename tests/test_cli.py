"""The command line from outside: exit codes, messages, files. Every run here is small."""

import json
import os
import subprocess
import sys
import tomllib
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

import polyida as pi
from polyida.cli.commands import main

SMALL = ("--cells", "8", "--time", "0.02")
RAISING = """
class Raising:
    def steps(self, model, state, t_end, counts):
        raise RuntimeError("no projection")
        yield
"""
SCENE = """
import numpy as np
import polyida as pi

def build(cells=6, E=5e7):
    mesh = pi.mesh.rectangle(1.0, 0.1, cells=cells)
    scene = pi.Scene(gravity=(0.0, -9.81))
    plate = scene.add(pi.Plate(mesh, pi.Material(E=E, nu=0.3, rho=1100.0), thickness=0.01))
    scene.add(pi.Revolute(pi.ground, plate.section("left"), name="pin"))
    scene.add(pi.PointMass(plate.section("right"), 0.1, name="bob"))
    return scene

def model():
    return build().build()

def short():
    return build(), {"time": 0.01, "point": "pin"}

def negative():
    return build(E=-1.0)

def broken():
    return 1 / 0

def nothing():
    return None

def ungiven(length):
    return build()

def paired():
    return Low(), [1.0]

def misspelt():
    return build(), {"tim": 1.0}

def pointless():
    return build(), {"point": 3}

class Low(pi.Model):
    n, m = 1, 0

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        if q[0] < -0.1:
            raise RuntimeError("too low")
        return np.array([9.81])

def late():
    return Low()

class Falling(pi.Model):
    n, m = 1, 0

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        raise RuntimeError("no force today")

def failing():
    return Falling()
"""


SOFT = """
from polyida.problems.plates import Material, double_plate_motors

def build():
    return double_plate_motors(cells=8, material=Material(E=2e5, nu=0.3, rho=1100.0))
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, pages_alone):
    """An empty folder to stand in; pictures are those of pages, which is enough but for `compared`."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "scene.py").write_text(SCENE)
    return tmp_path


@pytest.fixture
def saved(capsys):
    assert main(["run", "double-plate", *SMALL, "--out", "run.h5"]) == 0
    capsys.readouterr()
    return "run.h5"


def refused(capsys, *args):
    """The one message that a wrong input gives."""
    assert main(list(args)) == 2
    out, err = capsys.readouterr()
    assert "Traceback" not in err and out == ""
    return err.strip()


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """(folder, what is printed, [(what is called, name of a figure)]) of one comparison."""
    from polyida.show.figure_files import FigureWriter
    from polyida.study import comparison

    made, told = tmp_path_factory.mktemp("compared"), []
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()) as out:
        patch.chdir(made)
        patch.setenv("COLUMNS", "200")
        for place, name in (
            (FigureWriter, "wait_until_ready"),
            (FigureWriter, "add"),
            (comparison, "run_timed"),
            (comparison, "reference_run"),
        ):
            patch.setattr(place, name, heard(told, name, getattr(place, name)))
        (made / "r").mkdir()
        (made / "r" / "mine.txt").write_text("keep")
        assert main(["compare", "double-plate-motors", *SMALL, "--out", "r", "--overwrite"]) == 0
    return made / "r", out.getvalue(), told


def test_compare_prints_a_table_and_writes_the_folder(compared):
    folder, out, _ = compared
    for text in ("generalized-alpha", "IDA", "refined run", "tip error, largest, m", "CPU s", "apart"):
        assert text in out
    files = {"report.html", "figures.json"}
    files |= {"mesh.png", "deformed.pdf", "tip.png", "reactions.pdf", "energy.png", "drift.pdf"}
    assert {path.name for path in folder.iterdir()} >= files and (folder / "mine.txt").read_text() == "keep"
    assert not list(folder.glob("*.h5")) and not (folder / "frames").exists()
    assert sum(path.stat().st_size for path in folder.rglob("*")) < 5e6


def test_compare_keeps_runs_and_frames_when_asked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["compare", "double-plate-motors", *SMALL, "--integrators", "alpha", "--out", "r", "--keep-runs"]) == 0
    run = pi.load(tmp_path / "r" / "generalized-alpha.h5")
    assert len(run) == run.steps + 1 == 21 and (tmp_path / "r" / "frames" / "run.pvd").is_file()


def test_report_stands_alone_and_figures_are_numbers(compared):
    folder = compared[0]
    page = (folder / "report.html").read_text()
    assert page.count('<figure class="picture">') == page.count('href="data:text/csv') == 7
    assert 'src="http' not in page and 'href="http' not in page and "GeneralizedAlpha(h=0.001" in page
    data = json.loads((folder / "figures.json").read_text())
    assert set(data) >= {"figures", "rows", "machine", "command"}
    assert all(isinstance(value, int | float) for value in data["figures"].values())
    assert data["figures"]["alpha_error_end"] < 1e-5 and data["figures"]["alpha_steps"] == 20
    assert data["figures"]["refined_steps"] > 2 * data["figures"]["radau_steps"] and data["machine"]["numpy"]
    assert data["command"] == "polyida compare double-plate-motors --cells 8 --time 0.02 --out r --overwrite"


def test_nothing_is_drawn_while_runs_are_timed_and_every_picture_once(compared):
    *_, told = compared
    given = [name for what, name in told if what == "add"]
    assert [what for what, _ in told] == ["wait_until_ready", "run_timed", *["add"] * 6, "reference_run", "add"]
    assert given == ["mesh", "deformed", "tip", "reactions", "energy", "drift", "error"]


def heard(told, name, function):
    """The function, which tells that it is called, and with what name a figure."""

    def call(*given):
        told.append((name, given[1] if name == "add" else ""))
        return function(*given)

    return call


def test_a_second_run_keeps_the_first_result(folder, capsys):
    args = ["run", "pendulum", "--time", "0.1"]
    assert main(args) == main(args) == 0
    assert "pendulum-alpha.h5 exists and is kept; writing pendulum-alpha-2.h5" in capsys.readouterr().out
    assert (folder / "pendulum-alpha-2.h5").is_file()


def test_a_folder_that_was_asked_for_is_replaced_only_when_told(folder, capsys):
    (folder / "out").mkdir()
    (folder / "out" / "mine.txt").write_text("keep")
    assert "--overwrite" in refused(capsys, "compare", "pendulum", "--time", "0.1", "--out", "out")


@pytest.mark.parametrize(
    ("given", "made"),
    [
        (["radau", "--rtol", "1e-5"], pi.RadauIIA(rtol=1e-5)),
        (["radau", "--step", "0.02"], pi.RadauIIA(h=0.02)),
        (["radau", "--step", "auto"], pi.RadauIIA()),
        (["RadauIIA"], pi.RadauIIA()),
        (["alpha"], pi.GeneralizedAlpha(h=0.01)),
        (["GeneralizedAlpha"], pi.GeneralizedAlpha(h=0.01)),
        (["alpha", "--step", "auto"], pi.GeneralizedAlpha()),
        (["alpha", "--step", "auto", "--rho-inf", "0.7"], pi.GeneralizedAlpha(rho_inf=0.7)),
    ],
)
def test_steps_are_those_given_or_the_problem_s_or_chosen(given, made, folder):
    assert main(["run", "pendulum", "--time", "0.1", "--out", "run.h5", "--integrator", *given]) == 0
    assert pi.load(folder / "run.h5").integrator == made


@pytest.mark.parametrize("name", ["build", "model", "short"])
def test_scenes_of_a_file_run(name, folder):
    assert main(["run", f"scene.py:{name}", "--time", "0.01", "--out", "run.h5"]) == 0
    assert (folder / "run.h5").is_file()


def test_a_failed_run_gives_one_and_keeps_what_it_has(folder, capsys):
    (folder / "soft.py").write_text(SOFT)
    assert main(["run", "soft.py:build", "--step", "5e-3", "--out", "soft.h5"]) == 1
    capsys.readouterr()
    assert main(["show", "soft.h5"]) == 0
    assert "GeneralizedAlpha" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["compare", "nonsense"], "double-plate"),
        (["compare", "nowhere.py:build"], "no such file"),
        (["compare", "scene.py"], "scene.py:NAME"),
        (["run", "scene.py:absent"], "functions there: build, model"),
        (["run", "scene.py:negative"], ": Material: E = -1.0"),
        (["run", "scene.py:nothing"], "returned NoneType"),
        (["compare", "scene.py:ungiven"], "scene.py:ungiven: missing a required argument: 'length'"),
        (["compare", "scene.py:paired"], "returned Low, list; a Scene, a Model, a Problem, or a pair such as (model, {"),
        (["run", "scene.py:misspelt"], "'tim'"),
        (["run", "scene.py:pointless"], "point = 3"),
        (["run", "pendulum", "--out", "loop"], "loop is a symlink"),
        (["show", ""], "empty"),
        (["run", "scene.py:model", "--cells", "4"], "--cells"),
        (["run", "pendulum", "--cells", "4"], "--cells"),
        (["run", "pendulum", "--time", "-1"], "time -1"),
        (["run", "pendulum", "--step", "nan"], "step nan"),
        (["run", "pendulum", "--integrator", "euler"], "alpha, ida"),
        (["run", "pendulum", "--integrator", "ida", "--step", "1e-3"], "--step is no setting of ida"),
        (["run", "pendulum", "--rtol", "1e-3"], "--rtol is no setting of alpha"),
        (["run", "pendulum", "--integrator", "energy", "--step", "auto"], "--step auto is no setting of energy"),
        (["run", "pendulum", "--rho-inf", "1.5"], "rho_inf"),
        (["run", "pendulum", "--out", "scene.py/run.h5"], "cannot be made"),
        (["run", "pendulum", "--out", "scene.py"], "--overwrite"),
        (["run", "--resume", "run.h5", "--time", "1", "--step", "1e-5"], "--step has no place"),
        (["run", "--resume", "run.h5", "--time", "1", "--integrator", "ida"], "--integrator has no place"),
        (["run", "--resume", "run.h5", "--time", "1", "--out", "other.h5"], "--out has no place"),
        (["run", "--resume", "run.h5", "--time", "1", "--cells", "4"], "--cells has no place"),
        (["show", "absent.h5"], "no such file"),
        (["show", "scene.py"], "scene.py"),
        (["show", "."], ".: a folder; give the HDF5 file of a run"),
        (["run", "pendulum", "--out", "run.csv"], "--out run.csv: a run is written as HDF5; give a name that ends in .h5"),
    ],
)
def test_wrong_input_gives_one_line_and_two(args, said, folder, capsys):
    (folder / "loop").symlink_to(folder / "loop")
    err = refused(capsys, *args)
    assert said in err and len(err.splitlines()) == 1


@pytest.mark.parametrize(("name", "said"), [("broken", "ZeroDivisionError"), ("failing", "no force today")])
def test_an_exception_of_the_users_code_is_shown_as_theirs(name, said, capsys):
    assert main(["run", f"scene.py:{name}"]) == 2
    err = capsys.readouterr().err
    assert said in err.splitlines()[0] and "scene.py" in err and "site-packages" not in err and "solve.py" not in err


def test_a_syntax_error_names_file_and_line(folder, capsys):
    (folder / "bad.py").write_text("def build(:\n")
    assert main(["run", "bad.py:build"]) == 2
    assert "bad.py, line 1: SyntaxError" in capsys.readouterr().err


def test_nothing_is_left_behind_when_the_users_code_fails(folder):
    assert main(["compare", "scene.py:failing"]) == 2
    assert not list(folder.glob("*-compare"))


def test_an_integrator_that_raises_is_a_failed_row_of_the_comparison(folder, capsys):
    (folder / "raising.py").write_text(RAISING)
    assert main(["compare", "pendulum", "--time", "0.02", "--integrators", "alpha,raising.py:Raising", "--out", "r"]) == 1
    out, err = capsys.readouterr()
    assert "Raising: RuntimeError: no projection" in out + err and (folder / "r" / "report.html").exists()
    rows = json.loads((folder / "r" / "figures.json").read_text())["rows"]
    assert [row["run"] for row in rows] == ["generalized-alpha", "Raising", "refined run"]
    assert [row["success"] for row in rows] == [True, False, True] and rows[0]["t_end"] == 0.02


def test_a_model_that_raises_in_the_run_is_a_failed_row_of_each_integrator(folder, capsys):
    assert main(["compare", "scene.py:late", "--integrators", "alpha", "--out", "r"]) == 1
    out, err = capsys.readouterr()
    assert all(f"{label}: RuntimeError: too low" in out + err for label in ("generalized-alpha", "refined run"))


def test_python_m_polyida_is_the_command_line():
    done = subprocess.run([sys.executable, "-m", "polyida", "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"polyida {pi.__version__}\n"), done.stderr


def test_list_names_every_scene_with_what_is_compared_and_its_source(capsys, monkeypatch):
    from polyida import problems

    monkeypatch.setenv("COLUMNS", "100")
    assert main(["list"]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()]
    assert [line.split()[0] for line in lines if line.split() and line.split()[0] in problems.names()] == [*problems.names()]
    for start in ("compared: ", "source: "):
        assert sum(line.startswith(start) for line in lines) == len(problems.names())
    assert "compared: q in m, v in m/s, lam in N/m, at t = 3 s" in lines


def test_show_animate_and_export_read_a_saved_run(saved, folder, capsys):
    assert main(["show", saved]) == 0
    assert "20 steps" in capsys.readouterr().out
    assert main(["animate", saved, "--frames", "2"]) == 0 and (folder / "run.gif").is_file()
    assert main(["export", saved, "--vtu", "frames", "--frames", "3"]) == 0
    assert len(list((folder / "frames").glob("*.vtu"))) == 3
    for command in (["animate", saved], ["export", saved, "--vtu", "other"]):
        assert main([*command, "--frames", "0"]) == 2
        said = capsys.readouterr().err  # the words are those of typer, which differ between its versions
        assert "Invalid value for '--frames'" in said and ("than or equal to 1" in said or "0 is not in the range x>=1" in said)


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("polyida 0.")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device here")
def test_output_to_a_full_place_is_one_line():
    with open("/dev/full", "w") as full:
        ended = subprocess.run([sys.executable, "-c", CALL, "list"], stdout=full, stderr=subprocess.PIPE, text=True)
    assert ended.returncode == 2 and ended.stderr.strip() == "standard output: No space left on device"


CALL = "import sys; from polyida.cli.commands import main; sys.exit(main())"


OWN = '''
from dataclasses import dataclass
import polyida as pi
from polyida.problems import Problem
from polyida.study.tasks import Study
from scene import build

class Slot(pi.Joint):
    def rows(self):
        return [pi.cross(self.a.d, self.b.x - self.a.x)]

@dataclass(frozen=True)
class Mine:
    h: float

    def steps(self, model, state, t_end, counts):
        return pi.EnergyMomentum(h=self.h).steps(model, state, t_end, counts)

def swing(cells=6):
    """A plate that swings on a rail."""
    scene = build(cells)
    scene.add(Slot(pi.ground.at((1.0, 0.0), direction=(0.0, 1.0)), next(iter(scene.parts.values())).section("right"), name="rail"))
    return Problem("swing", scene.build(), None, None, 0.01)

def square(number):
    return {"square": number**2}

pi.registry.problems["rail-swing"] = swing
pi.registry.integrators["mine"] = Mine
pi.registry.studies["squares"] = Study("squares", "Squares of numbers", lambda quick: [{"number": k} for k in range(3)], square,
                                       lambda rows: {"largest": rows[-1]["square"]}, isolated=True, fresh=False)
'''
READ = """
import sys, own_things, polyida as pi
run = pi.load(sys.argv[1])
print(run.model.joints["rail"].__class__ is own_things.Slot, run.integrator == own_things.Mine(1e-5), pi.problems.get("rail-swing", cells=4).name)
"""


@pytest.fixture
def own(folder):
    """A file that adds to the registry, which is as it was afterwards."""
    (folder / "own_things.py").write_text(OWN)
    books = (pi.registry.parts, pi.registry.problems, pi.registry.integrators, pi.registry.studies)
    before, path = [dict(book) for book in books], [*sys.path]
    yield "own_things.py"
    for book, kept in zip(books, before):
        book.clear()
        book.update(kept)
    sys.path[:] = path
    for name in ("own_things", "scene"):
        sys.modules.pop(name, None)


def test_what_a_file_adds_to_the_registry_is_found_when_the_file_is_named(own, folder, capsys):
    assert main(["list", own]) == 0
    out = capsys.readouterr().out
    assert "rail-swing" in out and "A plate that swings on a rail." in out and "Squares of numbers" in out
    assert main(["run", f"{own}:rail-swing", "--cells", "4", "--integrator", "mine", "--out", "run.h5"]) == 0
    assert main(["study", f"{own}:squares", "--out", "s"]) == 0
    figures = json.loads((folder / "s" / "figures.json").read_text())
    assert figures["figures"] == {"largest": 4.0} and figures["command"] == f"polyida study {own}:squares --out s"
    done = subprocess.run(
        [sys.executable, "-c", READ, "run.h5"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(Path(pi.__file__).parents[1])},
    )
    assert done.stdout.split() == ["True", "True", "swing"]


def test_a_study_that_a_file_does_not_have_is_told_with_those_it_has(own, capsys):
    assert "own_things.py: it has no 'cubes'; studies there: swing, square" in refused(capsys, "study", f"{own}:cubes")


STUDY = """
import polyida as pi

def mine(quick=False, progress=None):
    steps = (1e-2, 5e-3) if quick else (1e-2, 5e-3, 2.5e-3)
    return pi.study.step_sizes("pendulum", 0.1, integrators={"alpha": lambda h: pi.GeneralizedAlpha(h=h)}, h=steps, progress=progress)

def none():
    return 3
"""


def test_a_function_that_returns_a_result_is_a_study(folder, capsys):
    (folder / "my_study.py").write_text(STUDY)
    assert main(["study", "my_study.py:mine", "--quick"]) == 0
    out = capsys.readouterr().out
    assert "order_q alpha: " in out and "Reference: Radau IIA" in out and (folder / "mine-quick" / "report.html").is_file()
    assert main(["study", "my_study.py:mine", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert [row["h"] for row in data["rows"]] == [1e-2, 5e-3, 2.5e-3] and data["command"] == "polyida study my_study.py:mine --json"
    assert "returned int; a result of pi.study is needed" in refused(capsys, "study", "my_study.py:none")
    assert "takes no option --quick" in refused(capsys, "study", "my_study.py:none", "--quick")
    assert "mine exists" in refused(capsys, "study", "my_study.py:mine", "--out", "mine")


INTERRUPTING = """
import sys


class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            raise KeyboardInterrupt


sys.meta_path.insert(0, Interrupting())
sys.argv = ["polyida", "run", "pendulum"]
from {module} import {function}
sys.exit({function}())
"""


@pytest.mark.parametrize("name", ["typer", "polyida.cli.options", "polyida.run.solve"])
def test_ctrl_c_while_the_command_imports_is_one_line(name, tmp_path):
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    module, function = project["scripts"]["polyida"].split(":")
    code = INTERRUPTING.format(name=name, module=module, function=function)
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=os.environ, capture_output=True, text=True)
    assert (done.returncode, done.stderr.strip()) == (130, "interrupted")
