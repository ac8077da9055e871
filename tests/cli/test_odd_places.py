"""The command line where something around it is odd: streams, the environment, and users' files that are none. One line and the right code."""

import os
import subprocess
import sys

import pytest

import polyida as pi
from polyida.study.tasks import Study, package_hash

RUN = "from polyida.cli import main; import sys; sys.exit(main())"


def polyida(*arguments, code=RUN, **options):
    """A finished process of the command line."""
    environment = os.environ | options.pop("env", {})
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, timeout=300, **options)


SCENES = {
    "UTF-16": 'name = "é"\n'.encode("utf-16"),
    "Latin-1": 'name = "é"\n'.encode("latin-1"),
    "NUL": b"a = 1\0\n",
    "unknown encoding": b"# coding: nonsense\n",
}


@pytest.mark.parametrize("kind", SCENES)
def test_a_scene_file_that_is_no_text_is_named(kind, tmp_path, capsys):
    from polyida.cli import main

    path = tmp_path / "scene.py"
    path.write_bytes(SCENES[kind])
    sys.argv = ["polyida", "run", f"{path}:build"]
    assert main() == 2
    shown = " ".join(capsys.readouterr().err.split())
    assert "scene.py: it " in shown and "UTF-8" in shown and "Traceback" not in shown


@pytest.fixture(autouse=True)
def kept_arguments(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["polyida"])


def test_an_exception_without_a_text_is_shown_by_its_kind(tmp_path, capsys):
    from polyida.cli import main

    path = tmp_path / "scene.py"
    path.write_text("class Mute(Exception):\n    def __str__(self):\n        raise RuntimeError\n\nraise Mute\n")
    sys.argv = ["polyida", "run", f"{path}:build"]
    assert main() == 2
    assert "line 5: Mute: an exception that cannot be shown" in " ".join(capsys.readouterr().err.split())


def test_output_may_go_nowhere():
    """`>&-`, and pythonw, which has no streams at all."""
    closed = polyida("list", code="import os, sys; os.close(1); sys.stdout = None; " + RUN)
    assert (closed.returncode, closed.stderr) == (0, "")
    wrong = polyida("nonsense", code="import sys; sys.stdout = sys.stderr = None; " + RUN)
    assert (wrong.returncode, wrong.stderr) == (2, "")


@pytest.mark.parametrize("columns", ["0", "-5"])
def test_any_number_of_columns_will_do(columns):
    seen = polyida("list", env={"COLUMNS": columns})
    assert (seen.returncode, seen.stderr) == (0, "") and len(seen.stdout) > 100


def test_an_unknown_backend_of_matplotlib_stops_nothing(tmp_path):
    """The commands draw without windows."""
    path = tmp_path / "scene.py"
    path.write_text("import matplotlib.pyplot\nimport polyida as pi\n\n\ndef build():\n    return pi.problems.get('pendulum')\n")
    for backend in ("nonsense", "Agg"):
        seen = polyida("run", f"{path}:build", "--time", "0.01", "--overwrite", env={"MPLBACKEND": backend}, cwd=tmp_path)
        assert seen.returncode == 0, seen.stderr


@pytest.mark.parametrize("name", ["../x", "a/b", "/tmp/x", "", ".", "..", "a\0b", "a\\b", None, "x" * 5000])
def test_a_study_stays_in_its_folder(name):
    with pytest.raises(pi.InputError, match="Study: name"):
        Study(name, "", lambda quick: [], dict, dict)


def test_the_lock_of_an_editor_beside_a_study_is_left_aside(tmp_path):
    (tmp_path / "mine.py").write_text("number = 1\n")
    before = package_hash.__wrapped__(tmp_path)
    (tmp_path / ".#mine.py").symlink_to("user@host.1234")
    assert package_hash.__wrapped__(tmp_path) == before
    (tmp_path / "mine.py").write_text("number = 2\n")
    assert package_hash.__wrapped__(tmp_path) != before
