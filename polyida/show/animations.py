"""Animations of a run: a page in a notebook, and files as GIF, MP4, SVG and HTML."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.files import disk_errors, remove_left_over, replacing, write_file
from polyida.progress import require_progress
from polyida.show import html, plates
from polyida.show.moving_svg import moving_svg
from polyida.show.styles import INK, STICK, colour_limit, figure_to_scale, finish_layout, literal, settings, show_to_scale, stress_colorbar
from polyida.validation import library, named_keywords, path_of, positive

MOST_FRAMES, MP4_RATE = {".gif": 80, ".svg": 40, ".html": html.MAX_FRAMES}, 25  # default number of frames; frames per second of an MP4
WIDEST = 100  # inches
SUFFIXES = (".gif", ".mp4", ".svg", ".html")


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
    """Write the motion of a run, with its supports, joints and forces, plates coloured by von Mises stress; names of events stay for 5 frames.

    Parameters
    ----------
    run : Trajectory
    path : str or Path
        A file that ends in .gif, .mp4, .svg (outlines alone, in the colours of a light or a dark page) or .html (a page with a slider).
    frames : int, optional
        Largest number of frames, evenly spread in time. Default: 80 of a GIF, 40 of an SVG, 25 per second of an MP4; of a page up to 60.
    seconds : float, s, optional
        Duration. Default: the simulated time, between 4 and 12 s.
    width : float, inch
        Of a GIF and MP4; the others have the width of where they are shown.
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
    suffix = _require_writable(run, path, overwrite)
    require_progress("animation", progress)
    width = positive("animation", "width", width, "inches")
    if width > WIDEST:
        raise InputError(f"animation: width = {width:.6g} inches must be at most {WIDEST}")
    seconds = float(np.clip(run.t[-1] - run.t[0], 4, 12)) if seconds is None else positive("animation", "seconds", seconds, "seconds")
    default = max(1, round(MP4_RATE * seconds)) if suffix == ".mp4" else MOST_FRAMES[suffix]
    indices = plates.spread(run, default if frames is None else frames)
    tell = progress or (lambda done: None)
    if suffix in (".svg", ".html"):
        text = moving_svg(run, indices, seconds) if suffix == ".svg" else _page(run, seconds, len(indices))
        with disk_errors(f"animation {path}"):
            write_file(path, text)
        tell(1.0)
        return path
    picture = FramePicture(run, indices, width)

    def images():
        """Yield the image of each frame and tell the progress."""
        for done, k in enumerate(indices, start=1):
            yield picture.image(k)
            tell(done / len(indices))

    write = _write_gif if suffix == ".gif" else _write_mp4
    remove_left_over(path.parent)
    with disk_errors(f"animation {path}"), replacing(path) as part:
        write(part, picture.image(indices[len(indices) // 2]), images(), seconds / len(indices))
    return path


def _require_writable(run, path, overwrite):
    """The suffix of a file that can be written from a run. Raises InputError for another suffix or run, an existing file, and without ffmpeg."""
    plates.require_run("animation", run, overwrite)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"animation {path}: only {', '.join(SUFFIXES)} can be written")
    if suffix == ".mp4":
        _ffmpeg()
    if path.exists() and not overwrite:
        raise InputError(f"animation {path} exists: choose another name, or pass overwrite=True (--overwrite)")
    return suffix


class Animation:
    """The motion of a run: a page with a slider where a notebook shows it. `save` writes it to a file.

    Parameters
    ----------
    run : Trajectory
    seconds : float, s, optional
        Duration. Default: the simulated time, between 4 and 12 s.

    Raises
    ------
    InputError
        For a run without frames, or without anything to draw.
    """

    def __init__(self, run: Any, seconds: float | None = None) -> None:
        """Check that the run has frames and bodies that can be drawn."""
        plates.require_run("animate", run, False)
        plates.bodies(run.model)
        self.run = run
        self.seconds = None if seconds is None else positive("animate", "seconds", seconds, "seconds")

    def __repr__(self):
        """One line: the run, and how the animation is shown."""
        return f"<Animation of {self.run!r}: it is shown in a notebook, and written by save('motion.gif')>"

    def _repr_html_(self):
        """A page of its own within the notebook's, so that neither changes the other."""
        return f'<iframe srcdoc="{escape(_page(self.run, self.seconds))}" style="width: 100%; height: 34rem; border: 0"></iframe>'

    @named_keywords
    def save(self, path: str | Path, frames: int | None = None, width: float = 6.4, overwrite: bool = False) -> Path:
        """Write a file that ends in .gif, .mp4, .svg or .html; return its path. The arguments are those of `pi.show.animation`."""
        return animation(self.run, path, frames=frames, seconds=self.seconds, width=width, overwrite=overwrite)


def _page(run, seconds, frames=html.MAX_FRAMES):
    """The text of a page that shows the motion alone."""
    return html.page_text("The motion", [html.Movie(run, "", seconds, frames)])


def _write_gif(path, sample, images, duration):
    """Write images as a GIF. sample: the image whose colours all frames share; duration: of a frame, s."""
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
    """The module imageio_ffmpeg. Raises an error that says how to install it if it is missing."""
    return library("imageio_ffmpeg", "animation: MP4 needs imageio-ffmpeg: pip install 'polyida[movie]'")


class FramePicture:
    """A picture that shows one frame of a run after the other with the same axes and colours.

    Axes and colorbar are drawn once; each frame restores them and draws plates and time. `corners` and `ends` are arrays that the drawn
    cells and edges view: filling them moves the cells.
    """

    def __init__(self, run, frames, width):
        """Draw axes, colorbar and empty artists once, and keep the background that each frame restores."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection, PathCollection
        from matplotlib.path import Path as Outline

        self.run = run
        self.lines = plates.curves(run.model)
        self.nodes, offsets = plates.closed(self.lines.nodes, self.lines.offsets)
        self.corners, self.ends = np.zeros((len(self.nodes), 2)), np.zeros((len(self.lines.edges), 2, 2))
        self.drawn, low, high = plates.symbols_of(run, frames)
        self.numbers = {int(k): i for i, k in enumerate(frames)}  # of the frames within `drawn`
        self.clock = dict(zip(frames, plates.clock(run, frames)))
        self.stress = {k: run.von_mises(k) / 1e3 for k in frames}
        style = {"cmap": "viridis", "clim": (0, colour_limit([*self.stress.values()])), "edgecolors": "face", "linewidths": 0.2}
        with settings():
            new, self.axes, side = figure_to_scale(low, high, width, bool(run.model.drawn))
            cells = [Outline(corners) for corners in np.split(self.corners, offsets[1:-1])] if len(self.corners) else []
            self.cells = self.axes.add_collection(PathCollection(cells, animated=True, **style))
            self.outline = self.axes.add_collection(LineCollection(self.ends, colors=INK, linewidths=0.5, animated=True))
            self.sticks = self.axes.add_collection(LineCollection([], colors=STICK, linewidths=1.6, capstyle="round", animated=True))
            self.joints, self.forces, self.pins = plates.draw_symbols(self.axes, self.drawn, 0, animated=True)
            self.title = self.axes.set_title(literal(self.clock[frames[0]]), loc="left", animated=True)
            show_to_scale(self.axes, low, high)
            if run.model.drawn:
                stress_colorbar(new, self.axes, self.cells, side)
            finish_layout(new)
            self.canvas = FigureCanvasAgg(new)
            self.canvas.draw()
            self.background = self.canvas.copy_from_bbox(new.bbox)

    def image(self, k):
        """Draw frame k and return it as an RGB image, (height, width, 3)."""
        from PIL import Image

        positions = self.lines.places(self.run.node_positions(k))
        self.corners[:], self.ends[:] = positions[self.nodes], positions[self.lines.edges]
        self.cells.set_array(self.stress[k])
        self.sticks.set_segments(plates.sticks(self.run, k))
        number = self.numbers[int(k)]
        self.joints.set_segments(self.drawn.joints[number])
        self.forces.set_segments(self.drawn.forces[number])
        self.pins.set_data(*self.drawn.pins[number].T)
        self.title.set_text(literal(self.clock[k]))
        self.canvas.restore_region(self.background)
        with settings():
            for artist in (self.cells, self.outline, self.sticks, self.joints, self.forces, self.pins, self.title):
                self.axes.draw_artist(artist)
        return Image.fromarray(np.asarray(self.canvas.buffer_rgba())[..., :3].copy())
