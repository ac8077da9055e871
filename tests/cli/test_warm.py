"""`polyida warm` and what `polyida info` says of compiled kernels."""

import pytest

from polyida.cli import warm
from polyida.cli.commands import main
from polyida.errors import InputError


@pytest.mark.parametrize("name", warm.WORK)
def test_each_work_reaches_its_end(name):
    warm._work(name)


def test_info_says_what_is_compiled_and_where(tmp_path, monkeypatch, capsys):
    (tmp_path / "alpha_0123").mkdir()
    (tmp_path / "alpha_0123/step.take_steps-1.py311.aa.nbc").write_bytes(b"x" * 2_000_000)
    (tmp_path / "jit_0123").mkdir()
    (tmp_path / "jit_0123/user_functions.0123.nbc").write_bytes(b"x")
    monkeypatch.setattr(warm, "_kept_in", lambda: tmp_path)
    assert main(["info"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("compiled: "))
    assert line.startswith(f"compiled: 1 kernels and 1 functions of users, 2 MB, in {tmp_path}") and "alpha 1" in line


def test_without_a_folder_nothing_is_compiled(monkeypatch, capsys):
    monkeypatch.setattr(warm, "_kept_in", lambda: None)
    with pytest.raises(InputError, match="NUMBA_CACHE_DIR"):
        warm.warm()
    assert main(["warm"]) == 2 and main(["info"]) == 0
    assert "in no folder" in capsys.readouterr().out
