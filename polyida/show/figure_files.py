"""Files of figures: PNG, PDF, SVG and the numbers as CSV, rendered here or in a second process."""

import gc
import os
import pickle
import re
import signal
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from itertools import zip_longest
from multiprocessing import get_context, parent_process
from threading import Thread

import numpy as np

from polyida.environment import cores
from polyida.show.styles import figure, rendered

KINDS = ("png", "pdf", "svg")
DIGITS = ".9g"


class FigureWriter:
    """Renders figures in a second process while this process continues; use it in a `with`.

    The second process starts at once and loads matplotlib; `wait_until_ready` returns when this is done, so that timed code does not share
    the processor with it. Without a second core, and if the second process fails, this process renders.
    """

    def __init__(self):
        """Make a writer without figures; the second process starts in `__enter__`."""
        self.figures = {}  # by their names
        self.futures = {}  # {name: Future of its files} of figures that the second process renders
        self.pool = None  # of the second process, None without one

    def __enter__(self):
        """Start the second process and let it draw an empty figure, so that it has loaded matplotlib."""
        if cores() > 1:
            self.pool = ProcessPoolExecutor(1, get_context("spawn"), _start_process)
            self.started = self.pool.submit(_render_pickled, pickle.dumps(figure()[0]))
        return self

    def __exit__(self, *exception):
        """Stop the second process and drop the figures that it has not begun."""
        if self.pool:
            self.pool.shutdown(cancel_futures=True)

    def wait_until_ready(self):
        """Return when the second process has loaded what it needs."""
        if self.pool:
            self.started.exception()

    def add(self, name, figure):
        """Render a figure in the second process under a name; without that process, store it for `files`."""
        self.figures[name] = figure
        if self.pool:
            with suppress(Exception):  # a figure that cannot be pickled is rendered here
                self.futures[name] = self.pool.submit(_render_pickled, pickle.dumps(figure))

    def files(self):
        """{name: {kind: bytes}} of all figures. This process renders the last ones if the second process has not started them."""
        files = {}
        for name in reversed(self.figures):
            future = self.futures.get(name)
            if future and not future.cancel():
                with suppress(Exception):  # the error is raised again below if it belongs to the figure
                    files[name] = future.result()
            if name not in files:
                files[name] = figure_files(self.figures[name])
        return files


def figure_files(figure):
    """The files of a figure, {kind: bytes}, its numbers as "csv" among them."""
    return {kind: rendered(figure, kind) for kind in KINDS} | {"csv": csv(figure).encode()}


def _render_pickled(pickled):
    """Return the files {kind: bytes} of a pickled figure; runs in the second process."""
    files = figure_files(pickle.loads(pickled))
    gc.freeze()  # the loaded modules are never garbage
    return files


def _start_process():
    """Ignore Ctrl-C, which is for the first process, and end when the first process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=lambda: (parent_process().join(), os._exit(1)), daemon=True).start()


def csv(figure):
    """The numbers of a figure as CSV: a column for each coordinate of its lines, points, segments and polygons."""
    table = columns(figure)
    head = ",".join('"{}"'.format(heading.replace('"', '""')) for heading, _ in table)
    texts = [["" if value != value else format(value, DIGITS) for value in np.asarray(values, float)] for _, values in table]
    return "\n".join([head, *map(",".join, zip_longest(*texts, fillvalue=""))]) + "\n"


def columns(figure):
    """[(heading, values)] of a figure. Lines of a panel that share x have one column of x.

    If a panel has artists with labels, those without a label are frames and guides and are left out.
    """
    panels = [(axes, series) for axes in figure.axes if (series := _series(axes))]
    table = []
    for axes, series in panels:
        title = _one_line(next(filter(None, map(axes.get_title, ("left", "center", "right"))), axes.get_ylabel()))
        panel, previous = f"{title}: " if len(panels) > 1 else "", None
        x = next((other.get_xlabel() for other in axes.get_shared_x_axes().get_siblings(axes) if other.get_xlabel()), "x")
        for label, names, values in series:
            same_x = previous is not None and np.array_equal(previous, values[0], equal_nan=True)
            for name, column in list(zip([x, *names], values, strict=True))[same_x:]:
                suffix = f" ({label})" if label and not (previous is None and name == x) else ""
                table.append((f"{panel}{_one_line(name)}{suffix}", column))
            previous = values[0]
    return table


def _one_line(label):
    """A label in one line without the signs of a formula; an escaped dollar is a dollar."""
    return re.sub(r"(\\\$)|[$\\]", lambda match: "$" if match[1] else "", label.replace("\n", " "))


def _series(axes):
    """[(label, names of the columns after x, [x, ...])] of what a panel shows in data coordinates."""
    lines = [line for line in axes.get_lines() if line.get_transform() == axes.transData and len(line.get_xdata())]
    series = [(line.get_label(), [axes.get_ylabel()], [_floats(line.get_xdata()), _floats(line.get_ydata())]) for line in lines]
    series += [(artist.get_label(), *_collection(artist, axes)) for artist in axes.collections]
    series = [(label, names, values) for label, names, values in series if values]
    labelled = [(_one_line(label), names, values) for label, names, values in series if label and label[0] != "_"]
    return labelled or [("", names, values) for _, names, values in series if len(names) == 1]


def _floats(values):
    """Values as an array of floats, NaN in place of masked ones."""
    return np.asarray(np.ma.filled(np.ma.asarray(values, float), np.nan))


def _collection(artist, axes):
    """(names, values) of points, or of the corners of segments and polygons with their number and their colour value."""
    from matplotlib.collections import LineCollection, PathCollection, PolyCollection

    vertical = axes.get_ylabel() or "y"
    if isinstance(artist, PathCollection):
        return [vertical], list(_floats(artist.get_offsets()).T) if len(artist.get_offsets()) else []
    if not isinstance(artist, LineCollection | PolyCollection) or not artist.get_paths():
        return [], []
    closed = isinstance(artist, PolyCollection)
    corners = [path.vertices[:-1] if closed else path.vertices for path in artist.get_paths()]
    counts = [len(points) for points in corners]
    values = [*np.concatenate(corners).T, np.repeat(np.arange(len(counts)), counts)]
    if artist.get_array() is None:
        return [vertical, "number"], values
    quantity = next((bar.ax.get_ylabel() or bar.ax.get_xlabel() for bar in (other.colorbar for other in axes.collections) if bar), "value")
    return [vertical, "number", quantity], [*values, np.repeat(_floats(artist.get_array()), counts)]
