"""Scripts as a user writes them run unchanged, from an empty folder."""

import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPTS = sorted((Path(__file__).parent / "contract").glob("*.py"))
STARTS_PROCESSES = ("sweep",)  # which import the script that they belong to: it must be the one that runs


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_script(script, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if script.stem in STARTS_PROCESSES:
        paths = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        subprocess.run([sys.executable, str(script)], env=paths, check=True)
        return
    runpy.run_path(str(script), run_name="__main__")
