"""Files that exist are replaced when the new ones are whole: a failure leaves the old ones, and files of others stay."""

import subprocess
import sys

import numpy as np
import pytest

import polyida as pi
from polyida.files import OLD, remove_left_over, replacing, write_file
from polyida.show import vtu as export
from polyida.show.html import json_in_html, policy
from stress.kills import killed_writers


class Full(OSError):
    """What a full disk raises."""


def test_a_file_is_replaced_when_it_is_whole(tmp_path):
    path = tmp_path / "figure.svg"
    path.write_text("old")
    with pytest.raises(Full), replacing(path) as part:
        part.write_text("ne")
        raise Full
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
    write_file(path, "new")
    assert path.read_text() == "new" and list(tmp_path.iterdir()) == [path]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real").write_text("old")
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "real")
    write_file(link, b"new")
    assert link.is_symlink() and (tmp_path / "real").read_text() == "new"


def test_names_of_unfinished_files_differ_and_old_ones_are_removed(tmp_path):
    import os

    with replacing(tmp_path / "a.json") as one, replacing(tmp_path / "a.json") as other:
        one.touch()
        other.touch()
        assert one != other
        remove_left_over(tmp_path)
        assert one.exists()
        os.utime(one, (0.0, one.stat().st_mtime - OLD - 1.0))
        remove_left_over(tmp_path)
        assert not one.exists() and other.exists()
        one.touch()


def test_an_export_keeps_the_old_frames_until_the_new_ones_are_whole(run, tmp_path, monkeypatch):
    folder = tmp_path / "frames"
    collection = pi.export.vtu(run, folder, frames=4)
    (folder / "frame-of-mine.vtu").write_text("mine")
    old = {path.name: path.read_bytes() for path in folder.iterdir()}

    count = []

    def full(self, run, k, frame=export._CellBlocks.frame):
        count.append(k)
        if len(count) == 3:
            raise Full
        return frame(self, run, k)

    with monkeypatch.context() as patch, pytest.raises(pi.InputError, match="cannot be written"):
        patch.setattr(export._CellBlocks, "frame", full)
        pi.export.vtu(run, folder, overwrite=True, frames=4)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == old
    for _ in range(2):
        pi.export.vtu(run, folder, overwrite=True, frames=[0, 2])
        named = export._frames_of(collection)
        assert len(named) == 2 and {path.name for path in folder.iterdir()} == {*named, "run.pvd", "frame-of-mine.vtu"}


def test_no_text_of_the_data_ends_the_script_of_a_page():
    import json

    text = "</script><svg/onload=alert(1)>&amp;\u2028"
    inside = json_in_html({"name": text, "t": np.arange(2).tolist()})
    assert not set("<>&\u2028") & set(inside) and json.loads(inside)["name"] == text
    assert "script-src 'sha256-" in policy("x = 1") and policy("x = 1") != policy("x = 2")


def test_frames_of_a_killed_export_are_removed_by_the_next(run, tmp_path):
    child = """
import os, signal, sys
import polyida as pi
from polyida.show import vtu
write = vtu._CellBlocks.frame
vtu._CellBlocks.frame = lambda self, run, k: os.kill(os.getpid(), signal.SIGKILL) if k == 2 else write(self, run, k)
pi.export.vtu(pi.load(sys.argv[1]), sys.argv[2], overwrite=True, frames=[0, 1, 2])
"""
    folder = tmp_path / "frames"
    pi.export.vtu(run, folder, frames=2)
    (folder / "frame-a00001.vtu.mine").write_text("mine")
    old = {path.name for path in folder.iterdir()}
    run.save(tmp_path / "run.h5")
    assert subprocess.run([sys.executable, "-c", child, tmp_path / "run.h5", folder]).returncode < 0
    left = {path.name for path in folder.iterdir()} - old
    assert {name for name in left if name[0] != "."} == {"frame-a00000.vtu", "frame-a00001.vtu"}
    assert len(export._frames_of(folder / "run.pvd")) == 2
    pi.export.vtu(run, folder, overwrite=True, frames=2)
    assert {path.name for path in folder.iterdir()} == old


def test_killed_writers_leave_the_old_result_or_the_new_one(in_a_new_process):
    for name, found in in_a_new_process(killed_writers, 4).items():
        assert set(found) <= {"old", "new"}, (name, found)
