import sys

import numpy as np
import pytest
from PIL import Image

from polyida.errors import InputError
from polyida.show import plates
from polyida.show.animations import FramePicture, animation


def test_gif_has_the_frames_and_lasts_as_long_as_asked(run, tmp_path):
    seen = []
    path = animation(run, tmp_path / "a.gif", frames=4, seconds=1.0, width=3.0, progress=seen.append)
    with Image.open(path) as image:
        assert image.n_frames == 4 and image.info["duration"] == 250
    assert seen == [0.25, 0.5, 0.75, 1.0]


def test_mp4_has_the_frames_at_the_rate_asked_for(run, tmp_path):
    film = pytest.importorskip("imageio_ffmpeg")
    path = animation(run, tmp_path / "a.mp4", frames=6, seconds=0.5, width=3.01)
    about, *images = film.read_frames(str(path))
    assert about["codec"] == "h264" and about["fps"] == pytest.approx(12) and len(images) == 6 and about["duration"] == pytest.approx(0.5)
    first, last = (np.frombuffer(image, np.uint8).reshape(*about["size"][::-1], 3).astype(int) for image in (images[0], images[-1]))
    picture = FramePicture(run, plates.spread(run, 6), 3.01)
    for k, shown in ((0, first), (len(run.t) - 1, last)):
        meant = np.asarray(picture.image(k))[: len(shown), : len(shown[0])].astype(int)
        assert np.abs(shown - meant).mean() < 4
    assert list(tmp_path.iterdir()) == [path]


def test_mp4_names_the_extra_where_its_package_is_missing_and_files_are_kept(run, tmp_path, monkeypatch):
    (tmp_path / "a.gif").write_text("mine")
    with pytest.raises(InputError, match="exists"):
        animation(run, tmp_path / "a.gif")
    assert (tmp_path / "a.gif").read_text() == "mine"
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"polyida\[movie\]"):
        animation(run, tmp_path / "a.mp4")


def test_a_frame_has_the_plates_where_the_run_has_them_on_one_scale(run):
    picture = FramePicture(run, [0, 10, 20], 3.0)
    for k in (0, 20):
        picture.image(k)
        corners = np.concatenate([path.vertices[:-1] for path in picture.cells.get_paths()])
        assert corners == pytest.approx(run.node_positions(k)[plates.connectivity(run.model)[0]])
        assert np.asarray(picture.cells.get_array()) == pytest.approx(run.von_mises(k) / 1e3)
        assert np.array(picture.outline.get_segments()) == pytest.approx(plates.curves(run.model).outlines(run.node_positions(k)))
        assert picture.title.get_text() == f"t = {run.t[k]:.3f} s"
