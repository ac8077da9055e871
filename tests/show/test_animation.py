import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from polyida.errors import InputError
from polyida.show import plates
from polyida.show.animation import Picture, gif
from polyida.show.style import settings


def test_gif_has_the_frames_and_lasts_as_long_as_asked(run, tmp_path):
    seen = []
    path = gif(run, tmp_path / "a.gif", frames=4, seconds=1.0, width=3.0, progress=seen.append)
    with Image.open(path) as image:
        assert image.n_frames == 4 and image.info["duration"] == 250
    assert seen == [1, 2, 3, 4]


def test_gif_refuses_other_formats_and_existing_files(run, tmp_path):
    with pytest.raises(InputError, match="only .gif"):
        gif(run, tmp_path / "a.mp4")
    (tmp_path / "a.gif").write_text("mine")
    with pytest.raises(InputError, match="exists"):
        gif(run, tmp_path / "a.gif")
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
