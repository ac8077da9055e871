"""Animated GIF of the deformed plates."""

from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.show import plates
from polyida.show.style import INK, STICK, box, colour_top, equal, lay_out, scaled, settings, stress_key


def gif(run, path, frames=80, seconds=None, width=6.4, overwrite=False, progress=None):
    """Write the motion of a run as an animated GIF, coloured by von Mises stress; returns the path.

    frames: how many pictures at most, evenly spread in time. seconds: how long one pass takes; by default the simulated
    time, held to 4..12 s. progress: called with the number of pictures done. Raises InputError for a suffix other than
    .gif or an existing file.
    """
    if not isinstance(path, (str, Path)):
        raise InputError(f"animation {path!r} must be the path of a file")
    plates.require_run("animation", run, overwrite)
    path = Path(path)
    if path.suffix.lower() != ".gif":
        raise InputError(f"animation {path}: only .gif can be written")
    if path.exists() and not overwrite:
        raise InputError(f"animation {path} exists: choose another name or say overwrite")
    chosen = plates.spread(run, frames)
    seconds = float(np.clip(run.t[-1] - run.t[0], 4, 12)) if seconds is None else seconds
    picture = Picture(run, chosen, width)
    palette, images = picture.at(chosen[len(chosen) // 2]).quantize(128), []
    for k in chosen:
        images.append(picture.at(k).quantize(palette=palette, dither=0))
        if progress:
            progress(len(images))
    images[0].save(
        path, save_all=True, append_images=images[1:], loop=0, optimize=False, duration=max(20, round(1000 * seconds / len(images)))
    )
    return path


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
