"""Figures drawn by another process while this one goes on."""

import gc
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from polyida.machine import cores
from polyida.show.numbers import csv
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
