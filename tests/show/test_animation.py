import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from polyida.errors import InputError
from polyida.show import plates
from polyida.show.animation import Picture, animation
from polyida.show.style import settings


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
    picture = Picture(run, plates.spread(run, 6), 3.01)
    for k, shown in ((0, first), (len(run.t) - 1, last)):
        meant = np.asarray(picture.at(k))[: len(shown), : len(shown[0])].astype(int)
        assert np.abs(shown - meant).mean() < 4
    assert list(tmp_path.iterdir()) == [path]


def test_a_film_that_fails_leaves_what_was_there(run, tmp_path, monkeypatch):
    pytest.importorskip("imageio_ffmpeg")
    (tmp_path / "a.mp4").write_text("mine")
    monkeypatch.setattr(Picture, "_time", lambda picture, k: 1 / 0 if k else "t")
    with pytest.raises(ZeroDivisionError):
        animation(run, tmp_path / "a.mp4", frames=3, overwrite=True)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine"]


def test_mp4_names_the_extra_where_its_package_is_missing(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"polyida\[movie\]"):
        animation(run, tmp_path / "a.mp4")


def test_animations_refuse_other_formats_and_existing_files(run, tmp_path):
    with pytest.raises(InputError, match="only .gif and .mp4"):
        animation(run, tmp_path / "a.avi")
    (tmp_path / "a.gif").write_text("mine")
    with pytest.raises(InputError, match="exists"):
        animation(run, tmp_path / "a.gif")
    assert (tmp_path / "a.gif").read_text() == "mine"


def test_what_stays_is_drawn_once_and_a_frame_is_what_a_whole_drawing_shows(run, monkeypatch):
    draws, draw = [], FigureCanvasAgg.draw
    monkeypatch.setattr(FigureCanvasAgg, "draw", lambda canvas: draws.append(canvas) or draw(canvas))
    picture = Picture(run, [0, 10, 20], 3.0)
    first, other, again = (np.asarray(picture.at(k)) for k in (20, 0, 20))
    assert draws.count(picture.canvas) == 1 and np.array_equal(first, again) and not np.array_equal(first, other)
    for artist in (picture.cells, picture.outline, picture.title):
        artist.set_animated(False)
    with settings():
        picture.canvas.draw()
    assert np.array_equal(first, np.asarray(picture.canvas.buffer_rgba())[..., :3])


def test_a_frame_has_the_plates_where_the_run_has_them_on_one_scale(run):
    picture = Picture(run, [0, 10, 20], 3.0)
    for k in (0, 20):
        picture.at(k)
        corners = np.concatenate([path.vertices[:-1] for path in picture.cells.get_paths()])
        assert corners == pytest.approx(run.node_positions(k)[plates.connectivity(run.model)[0]])
        assert np.asarray(picture.cells.get_array()) == pytest.approx(run.von_mises(k) / 1e3)
        assert np.array(picture.outline.get_segments()) == pytest.approx(plates.outlines(run.model, run.node_positions(k)))
        assert picture.title.get_text() == f"t = {run.t[k]:.3f} s"
