import pytest
from PIL import Image

from polyida.errors import InputError
from polyida.show.animation import gif


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
