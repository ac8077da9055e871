import html
import re
import sys
from xml.etree import ElementTree

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


def test_an_svg_moves_what_moves_and_is_within_its_frame(run, tmp_path):
    path = run.animate(seconds=2.0).save(tmp_path / "a.svg", frames=5)
    root = ElementTree.fromstring(path.read_text())
    *_, width, height = map(int, root.get("viewBox").split())
    name = "{http://www.w3.org/2000/svg}"
    paths = root.findall(f"{name}path")
    assert {one.get("class") for one in paths} >= {"plate", "joint", "rim", "pin"}
    moving = [one.find(f"{name}animate") for one in paths if one.find(f"{name}animate") is not None]
    assert moving and all(one.get("dur") == "2s" for one in moving)
    assert all(len(one.get("values").split(";")) == 5 for one in moving)
    assert any(one.get("class") == "joint" and one.find(f"{name}animate") is None for one in paths)  # the support
    for one in paths:
        for x, y in re.findall(r"M(-?\d+) (-?\d+)", one.get("d")):
            assert 0 <= int(x) <= width and 0 <= int(y) <= height
    assert "prefers-color-scheme: dark" in path.read_text()


def test_outlines_of_an_svg_are_those_of_the_plates(run, tmp_path):
    path = run.animate().save(tmp_path / "a.svg", frames=2)
    (plates_of,) = re.findall(r'class="plate" d="([^"]+)"', path.read_text())
    points = []
    for loop in plates_of.strip("z").split("z"):
        start, steps = loop.removeprefix("M").split("l")
        numbers = np.array(steps.replace("-", " -").split(), int).reshape(-1, 2)
        points.append(np.cumsum([np.array(start.split(), int), *numbers], axis=0))
    assert len(points) == len(run.model.drawn)
    _, low, high = plates.symbols_of(run, plates.spread(run, 2))
    size = (high - low).max()
    drawn = np.concatenate(points) - 24
    placed = np.column_stack([low[0] + drawn[:, 0] / 1000 * size, high[1] - drawn[:, 1] / 1000 * size])
    exact = run.node_positions(0)[np.unique(plates.curves(run.model).edges)]
    assert np.hypot(*(exact[:, None] - placed[None]).transpose(2, 0, 1)).min(axis=1).max() < 1e-3 * size


def test_a_notebook_and_a_page_show_the_motion_with_nothing_from_elsewhere(run, tmp_path):
    shown = run.animate(seconds=1.0)._repr_html_()
    page = html.unescape(re.search(r'srcdoc="([^"]+)"', shown)[1])
    written = run.animate(seconds=1.0).save(tmp_path / "a.html").read_text()
    for text in (page, written):
        assert "<canvas" in text and '"seconds":1.0' in text and "<footer>" not in text
        assert 'src="http' not in text and 'href="http' not in text
    few = run.animate().save(tmp_path / "b.html", frames=3).read_text()
    assert 'max="2"' in few
    with pytest.raises(InputError, match=r"\.gif, \.mp4, \.svg, \.html"):
        run.animate().save(tmp_path / "a.avi")
    with pytest.raises(InputError, match="seconds"):
        run.animate(seconds=-1.0)
