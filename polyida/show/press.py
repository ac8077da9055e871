"""Files of figures: pictures, their numbers as CSV, and a process that draws them while this one goes on."""

import gc
import os
import pickle
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import zip_longest

import numpy as np

from polyida.environment import cores
from polyida.show.style import figure, rendered

KINDS = ("png", "pdf", "svg")
START = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); from polyida.show.press import serve; serve()"


class Press:
    """Draws figures, {kind: bytes} of each, in a process of its own, one after the other; use it in a `with`.

    That process has imported what it needs when `ready` comes back, and takes no time until a figure comes. What it
    cannot draw, for want of a second core or for any other reason, is drawn here.
    """

    def __init__(self):
        self.sheets, self.process, self.answers, self.line = {}, None, True, ThreadPoolExecutor(1)

    def __enter__(self):
        if cores() > 1:
            with suppress(OSError):
                paths = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
                self.process = subprocess.Popen([sys.executable, "-c", START], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=paths)
        self.begun = self.line.submit(self._answer)
        return self

    def __exit__(self, *exception):
        if self.process:
            self.process.kill()
        self.line.shutdown(cancel_futures=True)
        if self.process:
            self.process.communicate()

    def ready(self):
        """Come back when the other process has started, so that it takes no time from what is measured from now on."""
        self.begun.result()

    def __contains__(self, name):
        return name in self.sheets

    def __getitem__(self, name):
        return self.sheets[name][0]

    def give(self, name, made):
        """Have a figure drawn."""
        self.sheets[name] = made, self.line.submit(self._drawn, _pickled(made))

    def files(self):
        """{name: {kind: bytes}} of all figures that were given. Those at the end that the other process has not begun are drawn here."""
        found = {}
        for name, (made, sent) in reversed(self.sheets.items()):
            found[name] = (None if sent.cancel() else sent.result()) or drawn(made)
        return found

    def _drawn(self, sheet):
        """The files of a pickled figure, {kind: bytes}, or None where they are to be drawn here."""
        if self.process is None or sheet is None or not self.answers:
            return None
        with suppress(OSError):
            pickle.dump(sheet, self.process.stdin)
            self.process.stdin.flush()
            return self._answer()

    def _answer(self):
        """What the other process says next; None where it is not there, or says what makes no sense: then it is asked no more."""
        try:
            return pickle.load(self.process.stdout)
        except Exception:  # noqa: BLE001, bytes that are no answer fail in many ways
            self.answers = False


def drawn(made):
    """The files of a figure, {kind: bytes}, its numbers among them."""
    return {kind: rendered(made, kind) for kind in KINDS} | {"csv": csv(made).encode()}


def _pickled(made):
    """The figure in bytes, None where it holds what cannot be pickled."""
    with suppress(Exception):
        return pickle.dumps(made)


def serve():
    """The other process: figures come in, their files go out, until nobody is there. What fails is left to who gave it."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    files = drawn(figure()[0])  # imports and reads what every drawing needs
    gc.freeze()  # none of that is ever garbage
    while True:
        pickle.dump(files, out)
        out.flush()
        try:
            sheet = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            files = drawn(pickle.loads(sheet))
        except Exception:  # noqa: BLE001, it is raised again where the figure came from
            files = None


DIGITS = ".9g"


def columns(figure):
    """[(heading, values)] of the lines, points, segments and polygons of a figure. x is there once where lines of a panel share it.

    Where a panel has lines or points with labels, those without are frames and guides, and left out.
    """
    panels = [(axes, _series(axes)) for axes in figure.axes]
    panels, found = [(axes, series) for axes, series in panels if series], []
    for axes, series in panels:
        panel, known = f"{_title(axes)}: " if len(panels) > 1 else "", None
        x = next((other.get_xlabel() for other in axes.get_shared_x_axes().get_siblings(axes) if other.get_xlabel()), "x")
        for label, names, values in series:
            own = list(zip([x, *names], values, strict=True))[known is not None and np.array_equal(known, values[0], equal_nan=True) :]
            first, known = known is None, values[0]
            found += [(panel + _heading(name, "" if first and name == x else label), column) for name, column in own]
    return found


def csv(figure):
    """The columns of a figure as CSV, a heading above each; columns that are shorter end in empty fields."""
    found = columns(figure)
    head = ",".join('"{}"'.format(heading.replace('"', '""')) for heading, _ in found)
    texts = [["" if value != value else format(value, DIGITS) for value in np.asarray(values, float)] for _, values in found]
    return "\n".join([head, *map(",".join, zip_longest(*texts, fillvalue=""))]) + "\n"


def _title(axes):
    return _words(next(filter(None, map(axes.get_title, ("left", "center", "right"))), axes.get_ylabel()))


def _heading(name, label):
    return f"{_words(name)} ({label})" if label else _words(name)


def _words(label):
    """A label in one line, without the signs of matplotlib's formulas; a dollar that `plain` wrote as one is one."""
    return re.sub(r"(\\\$)|[$\\]", lambda found: "$" if found[1] else "", label.replace("\n", " "))


def _series(axes):
    """[(label, names of the columns after x, [x, ...])] of what a panel shows in its own coordinates."""
    lines = [line for line in axes.get_lines() if line.get_transform() == axes.transData and len(line.get_xdata())]
    found = [(line.get_label(), [axes.get_ylabel()], [_floats(line.get_xdata()), _floats(line.get_ydata())]) for line in lines]
    found += [(artist.get_label(), *_collected(artist, axes)) for artist in axes.collections]
    found = [(label, names, values) for label, names, values in found if values]
    named = [(_words(label), names, values) for label, names, values in found if label and label[0] != "_"]
    return named or [("", names, values) for _, names, values in found if len(names) == 1]


def _floats(values):
    return np.asarray(np.ma.filled(np.ma.asarray(values, float), np.nan))


def _collected(artist, axes):
    """(names, values) of points, or of the corners of segments and polygons with the number of each and its value."""
    from matplotlib.collections import LineCollection, PathCollection, PolyCollection

    vertical = axes.get_ylabel() or "y"
    if isinstance(artist, PathCollection):
        return [vertical], list(_floats(artist.get_offsets()).T) if len(artist.get_offsets()) else []
    if not isinstance(artist, LineCollection | PolyCollection) or not artist.get_paths():
        return [], []
    closed = isinstance(artist, PolyCollection)
    corners = [path.vertices[:-1] if closed else path.vertices for path in artist.get_paths()]
    counts = [len(place) for place in corners]
    values = [*np.concatenate(corners).T, np.repeat(np.arange(len(counts)), counts)]
    if artist.get_array() is None:
        return [vertical, "number"], values
    quantity = next((bar.ax.get_ylabel() or bar.ax.get_xlabel() for bar in (other.colorbar for other in axes.collections) if bar), "value")
    return [vertical, "number", quantity], [*values, np.repeat(_floats(artist.get_array()), counts)]
