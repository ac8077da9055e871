"""Animations of a run as GIF or MP4."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.files import disk_errors, remove_left_over, replacing
from polyida.progress import require_progress
from polyida.show import plates
from polyida.show.styles import (
    INK,
    STICK,
    bounds,
    colour_limit,
    figure_to_scale,
    finish_layout,
    literal,
    settings,
    show_to_scale,
    stress_colorbar,
)
from polyida.validation import library, named_keywords, path_of, positive

GIF_FRAMES, MP4_RATE = 80, 25  # default number of frames of a GIF; frames per second of an MP4


@named_keywords
def animation(
    run: Any,
    path: str | Path,
    frames: int | None = None,
    seconds: float | None = None,
    width: float = 6.4,
    overwrite: bool = False,
    progress: Callable[[float], object] | None = None,
) -> Path:
    """Write the motion of a run as an animated GIF or as MP4, coloured by von Mises stress; names of events stay for 5 frames.

    Parameters
    ----------
    run : Trajectory
    path : str or Path
        A file that ends in .gif or .mp4.
    frames : int, optional
        Largest number of frames, evenly spread in time. Default: 80 of a GIF, 25 per second of an MP4.
    seconds : float, s, optional
        Duration. Default: the simulated time, between 4 and 12 s.
    width : float, inch
    overwrite : bool
        Replace an existing file.
    progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    path : Path
        The file.

    Raises
    ------
    InputError
        For another suffix, an existing file, and for MP4 if imageio-ffmpeg is not installed.
    """
    path = path_of("animation", "path", path)
    plates.require_run("animation", run, overwrite)
    suffix = path.suffix.lower()
    if suffix not in (".gif", ".mp4"):
        raise InputError(f"animation {path}: only .gif and .mp4 can be written")
    if suffix == ".mp4":
        _ffmpeg()
    if path.exists() and not overwrite:
        raise InputError(f"animation {path} exists: choose another name, or pass overwrite=True (--overwrite)")
    require_progress("animation", progress)
    width = positive("animation", "width", width, "inches")
    seconds = float(np.clip(run.t[-1] - run.t[0], 4, 12)) if seconds is None else positive("animation", "seconds", seconds, "seconds")
    default = GIF_FRAMES if suffix == ".gif" else max(1, round(MP4_RATE * seconds))
    indices = plates.spread(run, default if frames is None else frames)
    picture = FramePicture(run, indices, width)

    def images():
        for done, k in enumerate(indices, start=1):
            yield picture.image(k)
            if progress:
                progress(done / len(indices))

    write = _write_gif if suffix == ".gif" else _write_mp4
    remove_left_over(path.parent)
    with disk_errors(f"animation {path}"), replacing(path) as part:
        write(part, picture.image(indices[len(indices) // 2]), images(), seconds / len(indices))
    return path


def _write_gif(path, sample, images, duration):
    """sample: the image whose colours all frames share; duration: of a frame, s."""
    palette = sample.quantize(128)
    first, *others = [image.quantize(palette=palette, dither=0) for image in images]
    first.save(path, save_all=True, append_images=others, loop=0, optimize=False, duration=max(20, round(1000 * duration)))


def _write_mp4(path, sample, images, duration):
    """Write H.264 with an even number of pixels, which every player accepts."""
    size = [length // 2 * 2 for length in sample.size]
    options = {"fps": 1 / duration, "quality": 8, "macro_block_size": 2, "ffmpeg_log_level": "error"}
    film = _ffmpeg().write_frames(str(path), size, **options)
    try:
        film.send(None)
        for image in images:
            film.send(image.crop((0, 0, *size)).tobytes())
    finally:
        film.close()


def _ffmpeg():
    return library("imageio_ffmpeg", "animation: MP4 needs imageio-ffmpeg: pip install 'polyida[movie]'")


class FramePicture:
    """A picture that shows one frame of a run after the other with the same axes and colours.

    Axes and colorbar are drawn once; each frame restores them and draws plates and time. `corners` and `ends` are arrays that the drawn
    cells and edges view: filling them moves the cells.
    """

    def __init__(self, run, frames, width):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection, PathCollection
        from matplotlib.path import Path as Outline

        self.run, self.lines = run, plates.curves(run.model)
        self.nodes, offsets = plates.closed(self.lines.nodes, self.lines.offsets)
        self.corners, self.ends = np.zeros((len(self.nodes), 2)), np.zeros((len(self.lines.edges), 2, 2))
        boxes = np.array([bounds(plates.places(run, k)) for k in frames])
        low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        self.clock = dict(zip(frames, plates.clock(run, frames)))
        self.stress = {k: run.von_mises(k) / 1e3 for k in frames}
        style = {"cmap": "viridis", "clim": (0, colour_limit([*self.stress.values()])), "edgecolors": "face", "linewidths": 0.2}
        with settings():
            new, self.axes, side = figure_to_scale(low, high, width, bool(run.model.drawn))
            cells = [Outline(corners) for corners in np.split(self.corners, offsets[1:-1])] if len(self.corners) else []
            self.cells = self.axes.add_collection(PathCollection(cells, animated=True, **style))
            self.outline = self.axes.add_collection(LineCollection(self.ends, colors=INK, linewidths=0.5, animated=True))
            self.sticks = self.axes.add_collection(LineCollection([], colors=STICK, linewidths=1.6, capstyle="round", animated=True))
            self.title = self.axes.set_title(literal(self.clock[frames[0]]), loc="left", animated=True)
            show_to_scale(self.axes, low, high)
            if run.model.drawn:
                stress_colorbar(new, self.axes, self.cells, side)
            finish_layout(new)
            self.canvas = FigureCanvasAgg(new)
            self.canvas.draw()
            self.background = self.canvas.copy_from_bbox(new.bbox)

    def image(self, k):
        """Frame k as an RGB image."""
        from PIL import Image

        positions = self.lines.places(self.run.node_positions(k))
        self.corners[:], self.ends[:] = positions[self.nodes], positions[self.lines.edges]
        self.cells.set_array(self.stress[k])
        self.sticks.set_segments(plates.sticks(self.run, k))
        self.title.set_text(literal(self.clock[k]))
        self.canvas.restore_region(self.background)
        with settings():
            for artist in (self.cells, self.outline, self.sticks, self.title):
                self.axes.draw_artist(artist)
        return Image.fromarray(np.asarray(self.canvas.buffer_rgba())[..., :3].copy())
