"""Reading and checking the files of runs.

HDF5 marks a file that is open for writing, and afterwards opens it only in SWMR mode, in which it reads a damaged spot again and again for
hours. Here the mark is removed from the data that HDF5 reads, not from the file: the flags of the superblock (version 3: byte 11) are
cleared, its end of file (bytes 28 to 35) is set to the size of the file, and its checksum (bytes 44 to 47) is recomputed. Source: HDF5 File
Format Specification 3.0; checksum: Bob Jenkins, lookup3.
"""

import io
import json
import math
import os
import struct
import time
import zlib
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.integrate.state import Counts, Restart, State
from polyida.io.layout import (
    BLOCK_BYTES,
    FORMAT,
    FRAMES,
    HEAD,
    SENSORS,
    StoredFrames,
    being_written,
    dtypes_of,
    frames_at_once,
    sensed_width,
    shapes_of,
    width_of,
)

START, LENGTH = b"\x89HDF\r\n\x1a\n\3\x08", 48  # of a superblock of version 3
MASK = 0xFFFFFFFF


class Source(io.RawIOBase):
    """A readable file object that owns a descriptor and has a position of its own, also after a fork."""

    def __init__(self, descriptor):
        self._descriptor, self._at, self.size = descriptor, 0, os.fstat(descriptor).st_size
        self._head = b""
        head = self._part(LENGTH)
        marked = head[:10] == START and len(head) == LENGTH and head[11] != 0
        body = head[:11] + b"\0" + head[12:28] + struct.pack("<Q", self.size) + head[36:44]
        self._head = body + struct.pack("<I", checksum(body)) if marked else head

    def __del__(self):
        os.close(self._descriptor)

    def seek(self, offset, whence=0):
        """As io.RawIOBase."""
        self._at = offset + (0, self._at, self.size)[whence]
        return self._at

    def tell(self):
        """As io.RawIOBase."""
        return self._at

    def readinto(self, buffer):
        """As io.RawIOBase, with the superblock repaired."""
        view = memoryview(buffer).cast("B")
        data = self._part(len(view))
        view[: len(data)] = data
        self._at += len(data)
        return len(data)

    def _part(self, size):
        if hasattr(os, "pread"):
            data = os.pread(self._descriptor, size, self._at)
        else:
            os.lseek(self._descriptor, self._at, os.SEEK_SET)
            data = os.read(self._descriptor, size)
        return self._head[self._at : self._at + len(data)] + data[max(0, len(self._head) - self._at) :]


def checksum(data):
    """lookup3 of the 44 bytes before a superblock's checksum."""
    words = [*struct.unpack("<11I", data), 0]
    a = b = c = 0xDEADBEEF + len(data)
    for k in (0, 3, 6):
        a, b, c = a + words[k], b + words[k + 1], c + words[k + 2]
        for shift in (4, 6, 8, 16, 19, 4):
            a, b, c = b, b + c & MASK, (a - c & MASK) ^ _turned(c, shift)
    x, y, z = c, b + words[10] & MASK, a + words[9] & MASK
    for shift in (14, 11, 25, 16, 4, 14, 24):
        x, y, z = z, (x ^ y) - _turned(y, shift) & MASK, y
    return y


def _turned(x, shift):
    x &= MASK
    return (x << shift | x >> 32 - shift) & MASK


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
        super().__init__(entries)
        self.path = path

    def __missing__(self, name):
        raise InputError(f"{self.path}: the state to go on from is damaged: it has no {name!r}")


class Stored:
    """An open file, checked: plain data `about`, the last complete `record`, `restart`, the state to continue from, or None.

    torn: True if a slot is not complete. seconds: (CPU, wall). n, m: of the model. count: committed frames. single: True if frames have
    single precision. columns: {name: StoredFrames} of t, q, v, a, lam and the drives; sensed: StoredFrames of the sensors. Raises InputError,
    or another exception for a damaged file.
    """

    def __init__(self, file, path, size, live=False):
        self.file, self.path, self.live, self._size, self._claimed = file, path, live, size, {}
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
        """A complete dataset: finite float64, int64, or bytes."""
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
        """Split the numbers of a slot into the state to continue from and the frames after the last block."""
        record, n, m = self.record, self.n, self.m
        memory = [(str(name), tuple(map(int, shape))) for name, shape in record["memory"]]
        shapes = [(), (n,), (n,), (n,), (m,), *(shape for _, shape in memory)] if record["restart"] else []
        self.count, rows = int(record["frames"]), int(record["tail"])
        steps, sensed, width = int(record.get(SENSORS, 0)), int(record.get("sensors tail", 0)), (sensed_width(self.sensors),)
        datasets = self._found("frames", self.shapes, self.count, rows)
        shapes += [*((rows, *shape) for shape in self.shapes.values()), (sensed, *width)]
        sizes = [int(np.prod(shape)) for shape in shapes]
        if min(sizes) < 0 or sum(sizes) != len(numbers) or not np.isfinite(numbers).all():
            raise InputError("the last frames, or the state to go on from, are damaged")
        parts = [part.reshape(shape) for part, shape in zip(np.split(numbers, np.cumsum(sizes)), shapes)]
        tails = dict(zip(self.shapes, parts[-len(self.shapes) - 1 :]))
        self.single = datasets["q"].dtype == np.float32
        none = np.zeros((self.count, 0))  # lam without constraints
        self.columns = {
            name: StoredFrames(datasets.get(name, none), tails[name].astype(dtype), self.count, self.path)
            for name, dtype in dtypes_of(self.shapes, self.single).items()
        }
        datasets = self._found("steps of sensors", {SENSORS: width}, steps, sensed)
        self.sensed = StoredFrames(datasets.get(SENSORS, none[:0]), parts[-1], steps, self.path)
        self.restart = self._restart([name for name, _ in memory], parts) if record["restart"] else None

    def _found(self, what, shapes, count, rows):
        """{name: dataset} of columns with `count` committed rows, the last `rows` of which are in the slot."""
        datasets = {name: self._dataset(name, None, *shape) for name, shape in shapes.items() if shape != (0,)}
        least = min(map(len, datasets.values()), default=count)
        if not 0 <= rows <= count <= least + rows:
            raise InputError(f"it holds {least} {what}, {count - rows} are stated; the file is damaged")
        return datasets

    def _restart(self, names, parts):
        stored, memory = self.record["restart"], StoredMemory(self.path, zip(names, parts[5:]))
        state = State(float(parts[0]), *parts[1:5], memory)
        if not 0 <= int(stored["frames"]) <= self.count:
            raise InputError("the state to go on from is damaged")
        return Restart(state, int(stored["frames"]), counts_of(stored["counts"]).as_dict())

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
                return first + int((wrong | falls).argmax()), f"{name}: " + (
                    "values that are not finite" if wrong.any() else "the times do not increase"
                )
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
    """Counts from plain data."""
    counts = Counts(**stored)
    for name, value in stored.items():
        if not isinstance(value, str if name == "backend" else int):
            raise InputError(f"the count {name} = {value!r} is damaged")
    return counts
