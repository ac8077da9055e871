"""Result files opened and looked through: what they hold, what of it is whole."""

import json
import os
import time
import zlib
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.integrate.state import Counts, Restart, State
from polyida.io.checked import Checked
from polyida.io.frames import StoredFrames, held, rows_of
from polyida.io.layout import FORMAT, HEAD, frames_at_once, shapes_of, width_of
from polyida.io.lock import being_written
from polyida.io.source import Source

TRIES, PAUSE = 50, 0.01  # s: at a file that is being written


@contextmanager
def named(path):
    """Have every InputError name the file."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None


@contextmanager
def naming(path):
    """Turn whatever goes wrong in reading a file into one InputError that names it."""
    with named(path):
        try:
            yield
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001, a damaged file fails in the library, in json or here, in ways that nobody can list
            raise InputError(f"not a whole polyida trajectory ({type(error).__name__}: {error})") from None


def read(path):
    """The Stored of a file. Raises InputError naming it where it is missing, damaged or of another kind."""
    try:
        found = Path(path).is_file()
    except (TypeError, ValueError, OSError):
        found = False
    if not found:
        wrong = isinstance(path, (str, Path)) and f"{path}: no such file"
        raise InputError(wrong or f"{path!r:.100} must be the path of a file")
    with naming(path):
        live = being_written(path)
        return Stored(_opened(path, live), Path(path), os.path.getsize(path), live)


def read_open(descriptor, path):
    """The Stored of a file that this process has written, by its descriptor, whatever lies at its path by now."""
    with naming(path):
        source = Source(descriptor)
        return Stored(_h5(source), path, source.size)


def _opened(path, live):
    """The file opened for reading, also while it is written or after its writer was killed. Raises OSError."""
    import h5py

    if live:
        return h5py.File(path, "r", libver="latest", swmr=True, locking=False)
    source = Source(os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0)))
    return _h5(source) if source.marked else h5py.File(path, "r", locking=False)


def _h5(source):
    import h5py

    return h5py.File(source, "r")


class Stored:
    """An open file, checked: plain data `about`, the last whole `record`, `restart`, where the run goes on, or None.

    torn: whether a slot is not whole. counts; seconds: (CPU, wall). n, m: of the model. count: frames that hold.
    arrays: the datasets. Raises InputError, or whatever a damaged file makes fail.
    """

    def __init__(self, file, path, size, live=False):
        self.file, self.path, self.live, self.arrays = file, path, live, Checked(file, size)
        try:
            if str(file.attrs.get("format")) != FORMAT:
                raise InputError(f"not a polyida trajectory (format {file.attrs.get('format')!r}, {FORMAT!r} is needed)")
            self.about = json.loads(self.arrays.array("about", (None,)).astype(np.uint8).tobytes())
            self.record, numbers = self._newest()
            self.n = self.arrays.dataset("q", (None, None)).shape[1]
            self.m = self.arrays.dataset("lam", (None, None)).shape[1] if "lam" in file else 0
            self.shapes = shapes_of(self.n, self.m, dict.fromkeys(self.about["drives"]))
            self.seconds = float(self.record["cpu_seconds"]), float(self.record["wall_seconds"])
            self.counts = counts_of(self.record["counts"])
            self._unpack(numbers)
        except BaseException:
            file.close()
            raise

    def close(self):
        """Close the file."""
        self.file.close()

    def _newest(self):
        """(record, numbers) of the newer whole slot; one that is being written is waited for."""
        for _ in range(TRIES if self.live else 1):
            slots = [self._slot(f"slot {k}") for k in range(2)]
            if whole := [slot for slot in slots if slot]:
                self.torn = any(slot is None for slot in slots)
                return max(whole, key=lambda slot: int(slot[0]["commit"]))
            time.sleep(PAUSE * self.live)
        raise InputError("it has no whole record of a flush; nothing in it holds")

    def _slot(self, name):
        """(record, numbers) of a slot, None where it is not whole, () where nothing was written yet."""
        dataset = self.arrays.dataset(name, (None,))
        if self.live:
            dataset.refresh()
        stored = dataset[()].astype(np.uint8).tobytes()
        if not stored:
            return ()
        if len(stored) < HEAD.size:
            return None
        length, check, text = HEAD.unpack_from(stored)
        body = stored[HEAD.size : HEAD.size + length]
        if len(body) != length or zlib.crc32(body) != check:
            return None
        return json.loads(body[:text]), np.frombuffer(body[text:], float)

    def _unpack(self, numbers):
        """Split the numbers of a slot into the state to go on from and the frames behind the last block."""
        record, n, m = self.record, self.n, self.m
        self.count, rows = int(record["frames"]), int(record["tail"])
        lengths = [len(self.arrays.dataset(name, (None, *shape))) for name, shape in self.shapes.items() if shape != (0,)]
        if not 0 <= rows <= self.count <= min(lengths) + rows:
            raise InputError(f"it holds {min(lengths)} frames, {self.count - rows} are stated; the file is damaged")
        memory = [(str(name), tuple(map(int, shape))) for name, shape in record["memory"]]
        shapes = [(), (n,), (n,), (n,), (m,), *(shape for _, shape in memory)] if record["restart"] else []
        shapes += [(rows, *shape) for shape in self.shapes.values()]
        sizes = [int(np.prod(shape)) for shape in shapes]
        if min(sizes) < 0 or sum(sizes) != len(numbers) or not np.isfinite(numbers).all():
            raise InputError("the last frames, or the state to go on from, are damaged")
        parts = [part.reshape(shape) for part, shape in zip(np.split(numbers, np.cumsum(sizes)), shapes)]
        self.tail = dict(zip(self.shapes, parts[-len(self.shapes) :]))
        self.restart = self._restart(memory, parts) if record["restart"] else None

    def _restart(self, memory, parts):
        told, names = self.record["restart"], [name for name, _ in memory]
        state = State(float(parts[0]), *parts[1:5], dict(zip(names, parts[5:])))
        if not 0 <= int(told["frames"]) <= self.count:
            raise InputError("the state to go on from is damaged")
        return Restart(state, int(told["frames"]), counts_of(told["counts"]).as_dict())

    def check(self):
        """Look through all frames; those behind the first that is damaged are given up. Returns what is wrong, or "".

        Raises InputError where no frame is whole.
        """
        step, last = frames_at_once(width_of(self.shapes)), -np.inf
        for first in range(0, self.count, step):
            end = min(first + step, self.count)
            good, why = self._whole(first, end, last)
            if good < end:
                if good == 0:
                    raise InputError(f"all its frames are damaged: {why}")
                message = f"frames {good} to {self.count - 1} are damaged ({why}); these are the ones before"
                self.count, self.restart = good, None
                return message
            last = self.rows("t", first, end)[-1]
        return ""

    def _whole(self, first, end, last):
        """(the first frame from `first` to `end` that is not whole, or `end`; why). last: the time before."""
        reason = ""
        for name in (name for name, shape in self.shapes.items() if shape != (0,)):
            try:
                values = self.rows(name, first, end)
            except OSError as error:
                return first, f"{name}: {'its checksum does not fit' if 'filter' in str(error) else error}"
            wrong = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
            falls = np.diff(values, prepend=last) < 0 if name == "t" else np.zeros_like(wrong)
            if (wrong | falls).any():
                end = first + int((wrong | falls).argmax())
                reason = f"{name}: " + ("values that are not finite" if wrong.any() else "the times do not increase")
        return end, reason

    def rows(self, name, first, end):
        """Frames first to end of t, q, v, a, lam or a drive. Raises OSError where a checksum does not fit."""
        if self.shapes[name] == (0,):
            return np.zeros((end - first, 0))
        return rows_of(self.file[name], self._tail(name), self.count, first, end)

    def _tail(self, name):
        stored = int(self.record["frames"]) - int(self.record["tail"])
        return self.tail[name][: max(0, self.count - stored)]

    def frames(self, limit):
        """{name: frames}; the file is closed where all are in memory."""
        shapes = shapes_of(self.n, self.m)
        frames = held(self.file, shapes, self.count, {name: self._tail(name) for name in shapes}, limit, self.path)
        if not any(isinstance(values, StoredFrames) for values in frames.values()):
            self.close()
        return frames


def counts_of(stored):
    """Counts from plain data."""
    counts = Counts(**stored)
    for name, value in stored.items():
        if not isinstance(value, str if name == "backend" else int):
            raise InputError(f"the count {name} = {value!r} is damaged")
    return counts
