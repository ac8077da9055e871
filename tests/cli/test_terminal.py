"""What steers a terminal never reaches it: not from names, files, messages of a user's code, nor the command's own arguments."""

import json
import warnings

import pytest

import polyida as pi
from polyida.cli import study as cli_study
from polyida.cli.commands import main
from polyida.cli.output import Grid, ProgressDisplay, print_grid
from polyida.errors import printable
from polyida.study.tasks import Study

EVIL = "a\x1b]0;title\x07\x1b[31m\x9b5m\b\rb\u202ec\u2066\x7f"
STEERING = set("\x1b\x07\x9b\b\r\u202e\u2066\x7f")
FILE = f"""
import polyida as pi
EVIL = {EVIL!a}
def build():
    scene = pi.Scene(gravity=(0.0, -9.81))
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={{"tip": (0.5, 0.0), EVIL: (0.0, 0.0)}}, name=EVIL))
    scene.add(pi.Revolute(pi.ground, body.at(EVIL), name=EVIL + "j"))
    return scene, {{"time": 0.01, "step": 1e-3, "point": EVIL + "j"}}
def bad():
    raise ValueError(EVIL)
"""


def clean(text):
    """True if no character of a text steers a terminal."""
    return not STEERING & set(text)


def test_a_text_keeps_its_letters_lines_and_tabs():
    assert printable("ä\tφ\n→") == "ä\tφ\n→" and printable(EVIL + "\udcff").startswith("a\\x1b]0;title\\x07") and clean(printable(EVIL))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("evil")
    (made / f"{EVIL}.py").write_text(FILE)
    return made


def test_commands_print_no_steering_text(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    run = f"{EVIL}.h5"
    commands = {
        ("run", f"{EVIL}.py:build", "--out", run): 0,
        ("show", run): 0,
        ("show", f"x{run}"): 2,
        ("export", run, "--vtu", EVIL): 2,
        ("animate", run, "--out", f"{EVIL}.pdf"): 2,
        ("run", f"{EVIL}.py:bad"): 2,
        ("run", f"{EVIL}.py:{EVIL}"): 2,
        ("run", "pendulum", "--time", EVIL): 2,
        ("run", "pendulum", "--integrator", EVIL): 2,
        ("compare", EVIL): 2,
        ("study", EVIL): 2,
        (EVIL,): 2,
        ("info",): 0,
    }
    for arguments, code in commands.items():
        assert main(arguments) == code, arguments
        said = capsys.readouterr()
        assert said.out + said.err and clean(said.out + said.err), (arguments, said)


def test_a_study_prints_no_steering_text(tmp_path, capsys):
    def task(case):
        if case == 1:
            raise ValueError(EVIL)
        return {EVIL: 1.0, "text": EVIL}

    study = Study("evil", EVIL, lambda quick: [{"case": k} for k in range(2)], task, lambda rows: {EVIL: 1.0}, notes=lambda rows: [EVIL])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cli_study.main(study, ["--out", str(tmp_path / EVIL)])
    said = capsys.readouterr()
    assert "\\x1b" in said.out and clean(said.out + said.err)
    assert json.loads((tmp_path / EVIL / "figures.json").read_text())["notes"][0] == EVIL


def test_tables_and_progress_print_no_steering_text(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    print_grid(EVIL, Grid([EVIL, EVIL + "1", EVIL + "2"], [[EVIL] * 3] * 2), complete_in=EVIL)
    display = ProgressDisplay()
    display.shown = -1e9
    display(EVIL, 0.5, EVIL)
    said = capsys.readouterr()
    assert "No room" in said.out and "\\x1b" in said.err and clean(said.out + said.err)


def test_what_an_object_says_of_itself_has_no_steering_text():
    scene = pi.Scene(gravity=(0.0, -9.81))
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"tip": (0.5, 0.0), EVIL: (0.0, 0.0)}, name=EVIL))
    scene.add(pi.Revolute(pi.ground, body.at(EVIL), name=f"{EVIL} j"))
    model = scene.build()
    event = pi.Event(when=lambda state: state.t - 5e-3, name=EVIL, then="stop")
    run = pi.solve(model, 0.01, pi.GeneralizedAlpha(h=1e-3), events=[event])
    sweep = pi.study.sweep(lambda **case: {f"{EVIL} r": 1.0, "text": EVIL}, [{EVIL: 1}, {EVIL: 2}])
    things = [
        scene,
        model,
        run,
        run.events,
        body,
        body.at(EVIL),
        *scene.parts.values(),
        sweep,
        pi.mesh.MeshWarning(EVIL),
        pi.InputError(EVIL),
    ]
    for thing in things:
        said = [repr(thing), str(thing), getattr(thing, "_repr_html_", str)(), getattr(thing, "summary", str)()]
        assert clean("".join(said)), said
    with pytest.raises(pi.InputError) as caught:
        run.position(f"{EVIL} x")
    assert clean(str(caught.value))
