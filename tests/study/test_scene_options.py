"""Options on the command line that are arguments of a scene's function."""

import json

import pytest

from polyida.cli.commands import main
from polyida.errors import InputError
from polyida.study.scene_options import texts_of, typed_options

SCENE = """
import polyida as pi

def build(mu=0.3, bars=1, label="arm", upright=False, weights=(1.0,), end=None, mass: float = None):
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0 + mu, 2.0 * bars, name=label))
    scene.add(pi.Revolute(pi.ground.at((0.0, 0.0)), bar.at("left"), name="pin"))
    return scene, {"time": 0.02}
"""


def build(mu=0.3, bars=1, label="arm", upright=False, weights=(1.0,), end=None, mass: float | None = None, kind: int = 1, free=0.0):
    """A scene with arguments of all kinds."""


@pytest.mark.parametrize(
    ("words", "values"),
    [
        (["--mu", "0.0"], {"mu": 0.0}),
        (["--mu=-1e-3", "--bars", "3"], {"mu": -1e-3, "bars": 3}),
        (["--mu", "-0.5"], {"mu": -0.5}),
        (["--label", "3"], {"label": "3"}),
        (["--upright"], {"upright": True}),
        (["--upright", "no", "--mu", "1"], {"upright": False, "mu": 1.0}),
        (["--end", "2"], {"end": 2}),
        (["--end", "left"], {"end": "left"}),
        ([], {}),
    ],
)
def test_texts_are_typed_by_the_defaults(words, values):
    found = typed_options("my.py:build", build, texts_of(words))
    assert found == values and [type(value) for value in found.values()] == [type(value) for value in values.values()]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--mu", "much"], "--mu much must be a number, like its default 0.3"),
        (["--bars", "1.5"], "--bars 1.5 must be a whole number"),
        (["--upright", "perhaps"], "must be true or false"),
        (["--mu"], "--mu needs a value"),
        (["--weights", "1"], "is of type tuple"),
        (["--lable", "x"], "takes no option --lable.*did you mean --label?"),
        (["--tme", "1"], "did you mean --time?"),
        (["0.3"], "belongs to no option"),
        (["--mu", "1", "2"], "2: it belongs to no option"),
        (["--mu", "1", "--mu", "2"], "more than once"),
    ],
)
def test_other_texts_are_refused(words, told):
    with pytest.raises(InputError, match=told):
        typed_options("my.py:build", build, texts_of(words), ["time"])


def test_compare_and_run_pass_options_to_the_function(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.py").write_text(SCENE)
    q = {}
    for mu in ("0.0", "1.0"):
        assert main(["run", "my.py:build", "--mu", mu, "--step", "1e-2", "--out", f"{mu}.h5", "--json"]) == 0
        q[mu] = json.loads(capsys.readouterr().out)["rows"][0]
    assert q["0.0"]["success"] and q["0.0"]["coordinates"] == q["1.0"]["coordinates"]
    assert main(["compare", "my.py:build", "--mu", "0.0", "--integrators", "alpha", "--out", "page"]) == 0
    assert "--mu 0.0" in json.loads((tmp_path / "page/figures.json").read_text())["command"]
    capsys.readouterr()
    for wrong in (["compare", "my.py:build", "--nu", "0.3"], ["compare", "--mu", "0.0", "my.py:build"], ["run", "--mu", "1"]):
        assert main(wrong) == 2
    assert "takes no option --nu" in capsys.readouterr().err
