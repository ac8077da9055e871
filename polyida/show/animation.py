"""Animated GIF of the deformed plates."""

from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.show import plates
from polyida.show.style import INK, box, colour_top, equal, figure, height_for, settings


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
    images = []
    for image in _draw(run, chosen, width):
        images.append(image)
        if progress:
            progress(len(images))
    palette = images[len(images) // 2].quantize(128)
    images = [image.quantize(palette=palette, dither=0) for image in images]
    images[0].save(
        path, save_all=True, append_images=images[1:], loop=0, optimize=False, duration=max(20, round(1000 * seconds / len(images)))
    )
    return path


def _draw(run, chosen, width):
    """Yield one RGB image a frame, all on one scale of place and colour."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection, PolyCollection
    from PIL import Image

    places = [run.node_positions(k) for k in chosen]
    stress = [run.von_mises(k) / 1e3 for k in chosen]
    low, high = box(np.concatenate(places))
    with settings():
        made, axes = figure(width, height_for(low, high, 0.82 * width, 0.6))
        cells = PolyCollection(
            plates.polygons(run.model, places[0]),
            array=stress[0],
            cmap="viridis",
            clim=(0, colour_top(stress)),
            edgecolors="face",
            linewidths=0.2,
        )
        outline = LineCollection(plates.outlines(run.model, places[0]), colors=INK, linewidths=0.5)
        for collection in (cells, outline):
            axes.add_collection(collection)
        equal(axes, low, high)
        made.colorbar(cells, ax=axes, shrink=0.8, pad=0.02, extend="max").set_label("von Mises stress, kPa")
        canvas = FigureCanvasAgg(made)
        for k, place, values in zip(chosen, places, stress):
            cells.set_verts(plates.polygons(run.model, place))
            cells.set_array(values)
            outline.set_segments(plates.outlines(run.model, place))
            axes.set_title(f"t = {run.t[k]:.3f} s", loc="left")
            canvas.draw()
            yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())
