"""The motion of a run as a file: an animated GIF, or MP4."""

import os
from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.show import plates
from polyida.show.style import INK, STICK, box, colour_top, equal, lay_out, scaled, settings, stress_key

GIF, RATE = 80, 25  # pictures of a GIF at most, and of an MP4 in a second


def animation(run, path, frames=None, seconds=None, width=6.4, overwrite=False, progress=None):
    """Write the motion of a run as an animated GIF or as MP4, coloured by von Mises stress; returns the path.

    frames: how many pictures at most, evenly spread in time; by default GIF of them, or RATE a second of MP4. seconds: how long one pass
    takes; by default the simulated time, held to 4..12 s. progress: called with the part that is done. Raises InputError for a suffix other
    than .gif and .mp4, an existing file, and for MP4 where imageio-ffmpeg is missing.
    """
    if not isinstance(path, (str, Path)):
        raise InputError(f"animation {path!r} must be the path of a file")
    plates.require_run("animation", run, overwrite)
    path = Path(path)
    write = {".gif": _gif, ".mp4": _mp4}.get(path.suffix.lower())
    if write is None:
        raise InputError(f"animation {path}: only .gif and .mp4 can be written")
    if write is _mp4:
        _ffmpeg()
    if path.exists() and not overwrite:
        raise InputError(f"animation {path} exists: choose another name or say overwrite")
    seconds = float(np.clip(run.t[-1] - run.t[0], 4, 12)) if seconds is None else seconds
    chosen = plates.spread(run, (GIF if write is _gif else max(1, round(RATE * seconds))) if frames is None else frames)
    write(path, _told(Picture(run, chosen, width), chosen, progress), seconds / len(chosen))
    return path


def _told(picture, chosen, progress):
    """The images one after the other, each told when it is taken; first the middle one, for its colours."""
    yield picture.at(chosen[len(chosen) // 2])
    for done, k in enumerate(chosen, start=1):
        yield picture.at(k)
        if progress:
            progress(done / len(chosen))


def _gif(path, images, each):
    palette = next(images).quantize(128)
    first, *others = [image.quantize(palette=palette, dither=0) for image in images]
    first.save(path, save_all=True, append_images=others, loop=0, optimize=False, duration=max(20, round(1000 * each)))


def _mp4(path, images, each):
    """A film that plays everywhere: H.264 in even numbers of pixels; under another name until it is whole."""
    size = [length // 2 * 2 for length in next(images).size]
    partial = path.with_name(f".{path.stem}.{os.getpid()}.part.mp4")
    look = {"fps": 1 / each, "quality": 8, "macro_block_size": 2, "ffmpeg_log_level": "error"}
    film = _ffmpeg().write_frames(str(partial), size, **look)
    try:
        film.send(None)
        for image in images:
            film.send(image.crop((0, 0, *size)).tobytes())
        film.close()
        os.replace(partial, path)
    finally:
        film.close()
        partial.unlink(missing_ok=True)


def _ffmpeg():
    try:
        import imageio_ffmpeg
    except ImportError:
        raise InputError("animation: MP4 needs imageio-ffmpeg: pip install 'polyida[movie]'") from None
    return imageio_ffmpeg


class Picture:
    """The picture of a frame, all on one scale of place and colour: what stays is drawn once, plates and time anew on it.

    The drawn cells and edges are views of `corners` and `ends`, which each frame fills with its places.
    """

    def __init__(self, run, chosen, width):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection, PathCollection
        from matplotlib.path import Path as Outline

        self.run, (self.nodes, offsets), self.edges = run, plates.closed(run.model), plates.edges(run.model)
        self.corners, self.ends = np.zeros((len(self.nodes), 2)), np.zeros((len(self.edges), 2, 2))
        boxes = np.array([box(plates.places(run, k)) for k in chosen])
        low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        self.stress = {k: run.von_mises(k) / 1e3 for k in chosen}
        look = {"cmap": "viridis", "clim": (0, colour_top([*self.stress.values()])), "edgecolors": "face", "linewidths": 0.2}
        with settings():
            made, self.axes, side = scaled(low, high, width, bool(run.model.drawn))
            cells = [Outline(corners) for corners in np.split(self.corners, offsets[1:-1])] if len(self.corners) else []
            self.cells = self.axes.add_collection(PathCollection(cells, animated=True, **look))
            self.outline = self.axes.add_collection(LineCollection(self.ends, colors=INK, linewidths=0.5, animated=True))
            self.sticks = self.axes.add_collection(LineCollection([], colors=STICK, linewidths=1.6, capstyle="round", animated=True))
            self.title = self.axes.set_title(self._time(chosen[0]), loc="left", animated=True)
            equal(self.axes, low, high)
            if run.model.drawn:
                stress_key(made, self.axes, self.cells, side)
            lay_out(made)
            self.canvas = FigureCanvasAgg(made)
            self.canvas.draw()
            self.empty = self.canvas.copy_from_bbox(made.bbox)

    def at(self, k):
        """Frame k as an RGB image."""
        from PIL import Image

        place = self.run.node_positions(k)
        self.corners[:], self.ends[:] = place[self.nodes], place[self.edges]
        self.cells.set_array(self.stress[k])
        self.sticks.set_segments(plates.sticks(self.run, k))
        self.title.set_text(self._time(k))
        self.canvas.restore_region(self.empty)
        with settings():
            for artist in (self.cells, self.outline, self.sticks, self.title):
                self.axes.draw_artist(artist)
        return Image.fromarray(np.asarray(self.canvas.buffer_rgba())[..., :3].copy())

    def _time(self, k):
        return f"t = {self.run.t[k]:.3f} s"
