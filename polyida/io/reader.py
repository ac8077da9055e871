"""Reading and checking the files of runs.

In: the path of a file, whole, damaged, cut off by a killed process or still being written. Out: a Stored with the last complete record, the
state to continue from and the committed frames, or an InputError that names the file. Nothing in a file is trusted.
"""

import json
import math
import os
import time
import zlib
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.integrate.state import Counts, Restart, State
from polyida.io.frames import StoredFrames
from polyida.io.layout import BLOCK_BYTES, FORMAT, FRAMES, HEAD, SENSORS, dtypes_of, frames_at_once, sensed_width, shapes_of, width_of
from polyida.io.locks import being_written
from polyida.io.unclosed import Source

TRIES, PAUSE = 50, 0.01  # s: at a file that is being written


@contextmanager
def naming(path, everything=True):
    """Context in which every InputError names the file; everything: any other exception becomes an InputError."""
    try:
        yield
    except InputError as error:
        raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    except Exception as error:  # noqa: BLE001, a damaged file fails in the library, in json or here, in many ways
        if not everything:
            raise
        raise InputError(f"{path}: not a whole polyida trajectory ({type(error).__name__}: {error})") from None


def read(path):
    """The Stored of a file. Raises InputError if it is missing, damaged or of another kind."""
    try:
        exists = Path(path).is_file()
    except (TypeError, ValueError, OSError):
        exists = False
    if not exists:
        lacking = "a folder; give the HDF5 file of a run" if isinstance(path, (str, Path)) and os.path.isdir(path) else "no such file"
        wrong = isinstance(path, (str, Path)) and f"{path}: {lacking}"
        raise InputError(wrong or f"{path!r:.100} must be the path of a file")
    if not being_written(path):
        with naming(path):
            return read_open(os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0)), Path(path))
    with naming(path):
        import h5py

        file = h5py.File(path, "r", libver="latest", swmr=True, locking=False)
        return Stored(file, Path(path), os.path.getsize(path), live=True)


def read_open(descriptor, path):
    """The Stored of a file that is not being written, by its descriptor, which the Stored then owns."""
    import h5py

    source = Source(descriptor)
    with naming(path):
        return Stored(h5py.File(source, "r"), path, source.size)


class StoredMemory(dict):
    """What an integrator kept for its next step, from a file. An entry that it needs and that is not there is an InputError."""

    def __init__(self, path, entries):
        """Take the path, for messages, and the entries {name: value}."""
        super().__init__(entries)
        self.path = path

    def __missing__(self, name):
        """Raise InputError for an entry that the file does not have."""
        raise InputError(f"{self.path}: the state to go on from is damaged: it has no {name!r}")


class Stored:
    """An open file, checked: what the run was, its last complete record, and its frames, which are read when needed.

    Raises InputError, or another exception for a damaged file.
    """

    def __init__(self, file, path, size, live=False):
        """Check an open file and read all but its frames. size: its bytes; live: another process is writing it.

        Sets about (plain data: integrator, scene, plan, machine), record (plain data: the status at the last flush), n and m of the model, shapes
        and sensors ({name: shape}), seconds (CPU, wall, compiling), counts, count (committed frames), single (True: single precision), columns
        ({name: StoredFrames} of t, q, v, a, lam and the drives), sensed (StoredFrames of the sensors), restart (the Restart, or None) and torn
        (True if a slot is not complete).
        """
        self.file, self.path, self.live = file, path, live
        self._size = size  # bytes of the file
        self._claimed = {}  # {name of a dataset: bytes that it claims to have}
        try:
            if str(file.attrs.get("format")) != FORMAT:
                raise InputError(f"not a polyida trajectory (format {file.attrs.get('format')!r}, {FORMAT!r} is needed)")
            self.about = json.loads(self._array("about").astype(np.uint8).tobytes())
            self.record, numbers = self._newest()
            self.n, self.m = (self._dataset(name, None, None).shape[1] if name in file else 0 for name in ("q", "lam"))
            self.shapes = shapes_of(self.n, self.m, dict.fromkeys(self.about["drives"]))
            self.sensors = {str(name): tuple(map(int, shape)) for name, shape in self.about.get(SENSORS, {}).items()}
            self.seconds = tuple(float(self.record.get(f"{kind}_seconds", 0.0)) for kind in ("cpu", "wall", "compile"))
            self.counts = counts_of(self.record["counts"])
            self._unpack(numbers)
        except BaseException:
            file.close()
            raise

    def _dataset(self, name, *shape):
        """The dataset of that name, not read; shape: the required one, with None for any length.

        Files are not trusted: links, virtual, external or compressed datasets, types other than integers and floats, and sizes beyond that
        of the file raise InputError.
        """
        import h5py

        if not isinstance(self.file.get(name, getlink=True), h5py.HardLink):
            raise InputError(f"{name} is not in the file")
        node = self.file[name]
        if not isinstance(node, h5py.Dataset) or node.dtype.kind not in "fiu" or node.shape is None:
            raise InputError(f"{name} does not hold numbers")
        if shape and (len(shape) != node.ndim or any(b not in (None, a) for a, b in zip(node.shape, shape))):
            raise InputError(f"{name} has the shape {node.shape}; {shape} is needed")
        plist = node.id.get_create_plist()
        if node.is_virtual or node.external or {plist.get_filter(k)[0] for k in range(plist.get_nfilters())} - {h5py.h5z.FILTER_FLETCHER32}:
            raise InputError(f"{name} is virtual, external or compressed")
        self._claimed[name] = node.dtype.itemsize * math.prod(node.shape)
        claim = max(sum(self._claimed.values()), node.dtype.itemsize * math.prod(node.chunks or (0,)))
        if claim > 2 * self._size + BLOCK_BYTES:
            raise InputError(f"{name} claims {claim} bytes, the file has {self._size}")
        return node

    def _array(self, name):
        """A dataset as an array: finite float64, int64, or bytes. Raises InputError if it is damaged."""
        try:
            values = np.asarray(self._dataset(name)[()])
        except OSError as error:
            raise InputError(f"{name} is damaged ({error})") from None
        if values.dtype != np.uint8:
            values = values.astype(np.float64 if values.dtype.kind == "f" else np.int64)
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError(f"{name} holds values that are not finite")
        return values

    def arrays(self, group):
        """{path in the group: array} of a group that may be missing."""
        import h5py

        names = []
        self.file.visititems(lambda name, node: names.append(name) if isinstance(node, h5py.Dataset) else None)
        return {name.removeprefix(f"{group}/"): self._array(name) for name in names if name.startswith(f"{group}/")}

    def _newest(self):
        """(record, numbers) of the newer complete slot; waits for one that is being written."""
        for _ in range(TRIES if self.live else 1):
            slots = [self._slot(f"slot {k}") for k in range(2)]
            if whole := [slot for slot in slots if slot]:
                self.torn = any(slot is None for slot in slots)
                return max(whole, key=lambda slot: int(slot[0]["commit"]))
            time.sleep(PAUSE * self.live)
        raise InputError("it has no whole record of a flush; nothing in it holds")

    def _slot(self, name):
        """(record, numbers) of a slot, None if it is not complete, () if nothing was written yet."""
        dataset = self._dataset(name, None)
        if self.live:
            dataset.refresh()
        stored = dataset[()].astype(np.uint8).tobytes()
        if not stored:
            return ()
        length, check, text = HEAD.unpack_from(stored.ljust(HEAD.size, b"\0"))
        body = stored[HEAD.size : HEAD.size + length]
        if not body or len(body) != length or zlib.crc32(body) != check:
            return None
        return json.loads(body[:text]), np.frombuffer(body[text:], float)

    def _unpack(self, numbers):
        """Set frames, sensor values and the state to continue from, by the datasets and the numbers of a slot."""
        record, width = self.record, (sensed_width(self.sensors),)
        self.count, tail = int(record["frames"]), int(record["tail"])
        steps, sensed_tail = int(record.get(SENSORS, 0)), int(record.get("sensors tail", 0))
        datasets = self._found("frames", self.shapes, self.count, tail)
        tails = {name: (tail, *shape) for name, shape in self.shapes.items()} | {SENSORS: (sensed_tail, *width)}
        state, memory, tails = self._split(numbers, tails)
        self.single = datasets["q"].dtype == np.float32
        none = np.zeros((self.count, 0))  # lam without constraints
        self.columns = {
            name: StoredFrames(datasets.get(name, none), tails[name].astype(dtype), self.count, self.path)
            for name, dtype in dtypes_of(self.shapes, self.single).items()
        }
        datasets = self._found("steps of sensors", {SENSORS: width}, steps, sensed_tail)
        self.sensed = StoredFrames(datasets.get(SENSORS, none[:0]), tails[SENSORS], steps, self.path)
        self.restart = self._restart(state, memory) if record["restart"] else None

    def _split(self, numbers, tails):
        """({name: array} of the state to continue from, of its memory and of the last frames), in which order the numbers of a slot have them.

        tails: {name: shape}. Raises InputError unless the sizes fit and all numbers are finite.
        """
        state, memory = {}, {}
        if self.record["restart"]:
            state = shapes_of(self.n, self.m)
            memory = {str(name): tuple(map(int, shape)) for name, shape in self.record["memory"]}
        groups = state, memory, tails
        sizes = [int(np.prod(shape)) for group in groups for shape in group.values()]
        if min(sizes) < 0 or sum(sizes) != len(numbers) or not np.isfinite(numbers).all():
            raise InputError("the last frames, or the state to go on from, are damaged")
        parts = iter(np.split(numbers, np.cumsum(sizes)))
        return [{name: next(parts).reshape(shape) for name, shape in group.items()} for group in groups]

    def _found(self, what, shapes, count, rows):
        """{name: dataset} of columns with `count` committed rows, the last `rows` of which are in the slot."""
        datasets = {name: self._dataset(name, None, *shape) for name, shape in shapes.items() if shape != (0,)}
        least = min(map(len, datasets.values()), default=count)
        if not 0 <= rows <= count <= least + rows:
            raise InputError(f"it holds {least} {what}, {count - rows} are stated; the file is damaged")
        return datasets

    def _restart(self, state, memory):
        """The Restart of the record, from {name: array} of a state and of the integrator's memory. Raises InputError for a damaged one."""
        stored, t = self.record["restart"], float(state.pop("t"))
        if not 0 <= int(stored["frames"]) <= self.count:
            raise InputError("the state to go on from is damaged")
        return Restart(
            State(t, **state, memory=StoredMemory(self.path, memory)), int(stored["frames"]), counts_of(stored["counts"]).as_dict()
        )

    def check(self):
        """Read all frames and sensor values, and drop those from the first damaged one on. Returns what is damaged, or "".

        Raises InputError if no frame is left.
        """
        good, why = min((self._whole(name, frames) for name, frames in self.columns.items()), key=lambda pair: pair[0])
        sensed, fault = self._whole(SENSORS, self.sensed)
        wrong = []
        if good == 0 < self.count:
            raise InputError(f"all its frames are damaged: {why}")
        if good < self.count:
            wrong.append(f"frames {good} to {self.count - 1} are damaged ({why}); these are the ones before")
        if sensed < len(self.sensed):
            wrong.append(f"of sensors, steps {sensed} to {len(self.sensed) - 1} are damaged ({fault})")
        if wrong:
            self.count, self.restart = good, None
            for frames in self.columns.values():
                frames.cut(good)
            self.sensed.cut(sensed)
        return "; ".join(wrong)

    def _whole(self, name, frames):
        """(number of frames of a column before the first damaged one, the damage)."""
        step, last, count = frames_at_once(width_of(self.shapes)), -np.inf, len(frames)
        for first in range(0, count, step):
            try:
                values = frames.rows(first, min(first + step, count))
            except OSError as error:
                return first, f"{name}: {'its checksum does not fit' if 'filter' in str(error) or 'Fletcher32' in str(error) else error}"
            wrong = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
            falls = np.diff(values, prepend=last) < 0 if name == "t" else wrong
            if (wrong | falls).any():
                fault = "values that are not finite" if wrong.any() else "the times do not increase"
                return first + int((wrong | falls).argmax()), f"{name}: {fault}"
            last = values[-1]
        return count, ""

    def frames(self, limit):
        """{name: frames} of t, q, v, a and lam: arrays, or StoredFrames of large ones if all together exceed `limit` bytes.

        The file is closed if all are arrays.
        """
        columns = {name: self.columns[name] for name in FRAMES}
        whole = sum(values.nbytes for values in columns.values()) <= limit
        columns = {name: np.asarray(x) if whole or name == "t" or 32 * x.nbytes <= limit else x for name, x in columns.items()}
        if not any(isinstance(values, StoredFrames) for values in columns.values()):
            self.file.close()
        return columns


def counts_of(stored):
    """The Counts of plain data in a file. Raises InputError for a count that is no whole number."""
    counts = Counts(**stored)
    for name, value in stored.items():
        if not isinstance(value, str if name == "backend" else int):
            raise InputError(f"the count {name} = {value!r} is damaged")
    return counts
