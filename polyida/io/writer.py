"""The HDF5 file that frames of a run are appended to, readable at every moment, also after the process was killed."""

import errno
import json
import os
import time
import zlib
from contextlib import contextmanager, suppress
from uuid import uuid4

import numpy as np

from polyida.errors import InputError
from polyida.io.layout import (
    CAN_TELL,
    FORMAT,
    HEAD,
    SENSORS,
    being_written,
    chunk_of,
    dtypes_of,
    frames_at_once,
    lock,
    require_unwritten,
    shapes_of,
    width_of,
)
from polyida.jit import entry

ABOVE = 1 << 18  # bytes that are reserved on the disk beyond what is known to be needed
SLOT_CHUNK = 1 << 16
YOUNG = 60.0  # s: a file of that age that nobody has locked may be about to be
FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))
LANE, SECOND, THIRD, FOURTH = np.uint64(0xFFFF), np.uint64(16), np.uint64(32), np.uint64(48)
TWO, THREE, FOUR = np.uint64(2), np.uint64(3), np.uint64(4)
CHECK = 4  # bytes of a chunk's checksum


def fletcher32(values):
    """Fletcher's checksum of contiguous numbers, a multiple of 8 bytes, as HDF5's filter appends it.

    Of the N words w_i of 16 bits, `s1 = sum w_i` and `s2 = sum (N - i) w_i`, both modulo 65535, where 0 stands for nothing
    but zeros: `65536 s2 + s1`. HDF5 takes the first byte of a word for the higher one; to change that multiplies both sums by
    256. Source: HDF5 File Format Specification 3.0, filter 3; J. Fletcher, IEEE Trans. Commun. 30, 1982.
    """
    s1, s2 = ((int(s) * 256 - 1) % 65535 + 1 if s else 0 for s in _sums(values.reshape(-1).view(np.uint64)))
    return s2 << 16 | s1


@entry
def _sums(quads):
    """s1 and s2, not reduced, of words that come in fours: each of the four places has sums of its own."""
    a0 = a1 = a2 = a3 = p0 = p1 = p2 = p3 = np.uint64(0)
    for k in range(quads.shape[0]):
        x = quads[k]
        a0 += x & LANE
        a1 += (x >> SECOND) & LANE
        a2 += (x >> THIRD) & LANE
        a3 += x >> FOURTH
        p0 += a0
        p1 += a1
        p2 += a2
        p3 += a3
    return a0 + a1 + a2 + a3, FOUR * (p0 + p1 + p2 + p3) - a1 - TWO * a2 - THREE * a3


class Table:
    """Datasets of the same length: shapes, dtypes {name: shape of a row, or its dtype}; those of no width are not in the file.

    rows: of a block; count: rows in whole blocks.
    """

    def __init__(self, shapes, dtypes):
        self.shapes, self.count, self.rows = shapes, 0, frames_at_once(width_of(shapes))
        self._packs = {name: _pack(chunk_of(self.rows, shape), dtypes[name]) for name, shape in shapes.items() if shape != (0,)}
        self.block_bytes = sum(len(stored) * -(-self._size(name) // numbers.size) for name, (stored, numbers) in self._packs.items())
        self._datasets = {}

    def make(self, file):
        """Create the datasets in an open file."""
        for name, (_, numbers) in self._packs.items():
            shape = self.shapes[name]
            options = {"maxshape": (None, *shape), "chunks": numbers.shape, "fletcher32": True}
            self._datasets[name] = file.create_dataset(name, (0, *shape), numbers.dtype, **options)

    def bytes(self, more=0):
        """Bytes of all chunks with `more` rows."""
        return -(-(self.count + more) // self.rows) * self.block_bytes

    def append(self, block):
        """Append rows, a list of arrays in the order of `shapes`: as many as a chunk holds, or the last ones."""
        for name, values in zip(self.shapes, block):
            if name in self._datasets:
                self._put(self._datasets[name].id, *self._packs[name], values)
        self.count += len(block[0])

    def _size(self, name):
        """Numbers of a block."""
        return self.rows * int(np.prod(self.shapes[name]))

    def _put(self, dataset, stored, numbers, values):
        """Write chunks as they are stored, past the library: with our own checksum, and copied once."""
        rows, flat, place = len(values), values.reshape(len(values), -1), numbers.reshape(len(numbers), -1)
        dataset.set_extent((self.count + rows, *values.shape[1:]))
        place[rows:] = 0.0
        for first in range(0, flat.shape[1], place.shape[1]):
            part = flat[:, first : first + place.shape[1]]
            place[:rows, : part.shape[1]], place[:, part.shape[1] :] = part, 0.0
            stored[-CHECK:] = np.frombuffer(fletcher32(stored[:-CHECK]).to_bytes(CHECK, "little"), np.uint8)
            dataset.write_direct_chunk((self.count, first)[: values.ndim], stored)


def _pack(chunk, dtype):
    """(the bytes of a chunk as it is stored, its numbers in them)."""
    stored = np.empty(dtype.itemsize * int(np.prod(chunk)) + CHECK, np.uint8)
    return stored, stored[:-CHECK].view(dtype).reshape(chunk)


class NotWritten(Exception):
    """The disk did not take what was to be written; `status` says in two words why."""

    def __init__(self, path, error):
        number = getattr(error, "errno", None)
        self.status = "disk full" if number in FULL else "not written"
        super().__init__(f"{path}: {os.strerror(number) if number else error}")


@contextmanager
def taken(path):
    """Have what the disk does not take raise NotWritten."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise NotWritten(path, error) from None


class Writer:
    """A file under construction, held open by its descriptor: beside `shown`, where `publishing` brings it. Methods raise NotWritten.

    path: where it lies. single: see FrameStore. frames, sensors: Tables; held: frames of the last commit. drives: {name: profile}; width:
    of a row of sensors, 0 where there are none.
    """

    def __init__(self, shown, n, m, about, arrays, drives, fsync=False, single=False, width=0):
        import h5py

        self.shown, self.path, self.commits = shown, shown.with_name(f".polyida-{uuid4().hex}.part"), 0
        self.held, self.drives, self.fsync, shapes = 0, drives, fsync, shapes_of(n, m, drives)
        self.frames, self.sensors = Table(shapes, dtypes_of(shapes, single)), Table({SENSORS: (width,)}, {SENSORS: np.dtype("f8")})
        self._tables = self.frames, self.sensors
        self._reserved, self._slots = 0, 2 * (sum(table.block_bytes for table in self._tables) + SLOT_CHUNK)
        with taken(shown):
            self.descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        try:
            with taken(shown):
                lock(self.descriptor)
                self._file = h5py.File(self.path, "w", libver="v110", locking=False)
                self._make(about, arrays)
                self._file.flush()
                self._start = self._file.id.get_filesize()
        except NotWritten:
            self._discard()
            raise

    @classmethod
    def create(cls, path, *contents):
        """A file that comes to `path` by `publishing`. Raises InputError."""
        # remove files that a process has made here and was killed before it published them, where that can be told
        for left in path.parent.glob(".polyida-*.part"):
            with suppress(OSError):
                if CAN_TELL and time.time() - left.stat().st_mtime > YOUNG and not being_written(left):
                    left.unlink()
        try:
            return cls(path, *contents)
        except NotWritten as error:
            raise InputError(f"no file can be written there: {error}") from None

    def _make(self, about, arrays):
        for table in self._tables:
            table.make(self._file)
        self._file.attrs["format"] = FORMAT
        text = np.frombuffer(json.dumps(about, default=_listed).encode(), np.uint8)
        for key, values in {"about": text, **arrays}.items():
            checked = {"chunks": values.shape, "fletcher32": True} if values.size else {}
            self._file.create_dataset(key, data=values, **checked)
        for slot in range(2):
            self._file.create_dataset(f"slot {slot}", (0,), "u1", maxshape=(None,), chunks=(SLOT_CHUNK,))
        self._file.flush()
        self._file.swmr_mode = True

    @property
    def rows(self):
        """Frames of a block."""
        return self.frames.rows

    @property
    def count(self):
        """Frames in whole blocks."""
        return self.frames.count

    def append(self, block, table=None):
        """Append a block of frames, a list of arrays in the order of their shapes, or of the rows of another table."""
        table = table or self.frames
        with taken(self.shown):
            self._reserve(table, len(block[0]))
            table.append(block)

    def commit(self, record, numbers, tail, sensed, last=False):
        """Make all so far hold: flush it, then `record` (plain data), the state `numbers`, the frames `tail`, the rows of sensors `sensed`.

        last: into both slots, so that damage to one of them does no harm.
        """
        record |= {"frames": self.frames.count + len(tail[0]), "tail": len(tail[0])}
        record |= {"sensors": self.sensors.count + len(sensed), "sensors tail": len(sensed)}
        numbers = np.concatenate([np.ravel(x) for x in (*numbers, *tail, sensed)]).tobytes()
        for _ in range(1 + last):
            text = json.dumps(record | {"commit": self.commits}, default=_listed).encode()
            body = text + numbers
            content = np.frombuffer(HEAD.pack(len(body), zlib.crc32(body), len(text)) + body, np.uint8)
            with taken(self.shown):
                self._slots = max(self._slots, 2 * (len(content) + SLOT_CHUNK))
                self._reserve()
                self._flush()
                slot = self._file[f"slot {self.commits % 2}"]
                slot.resize(max(len(slot), len(content)), axis=0)
                slot[: len(content)] = content
                self._flush()
            self.commits, self.held = self.commits + 1, record["frames"]

    def _flush(self):
        self._file.flush()
        if self.fsync:
            os.fsync(self.descriptor)

    def _reserve(self, growing=None, rows=0):
        """Have the disk promise room for `rows` more before HDF5 gets them: a file that it could not write it cannot close.

        HDF5 gives chunks their place late, so what is needed is counted here: whole chunks, their checksums and index.
        """
        chunks = sum(table.bytes(rows if table is growing else 0) for table in self._tables)
        need = self._start + chunks + chunks // 32 + self._slots + ABOVE
        if need > self._reserved and hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self.descriptor, 0, need)
            self._reserved = need

    @contextmanager
    def publishing(self, overwrite):
        """Context for what is written before the file is moved to its place; where that fails it is removed.

        Raises InputError, also where a file came there meanwhile that must not be overwritten.
        """
        try:
            yield
            self._publish(overwrite)
        except NotWritten as error:
            raise InputError(str(error)) from None
        finally:
            if self.path != self.shown:
                self._discard()

    def _publish(self, overwrite):
        try:
            if overwrite:
                require_unwritten(self.shown)
                os.replace(self.path, self.shown)
            else:
                _move_new(self.path, self.shown)
        except OSError as error:
            raise InputError(f"{self.shown}: the file cannot be put there ({error.strerror})") from None
        self.path = self.shown
        if self.fsync:
            with suppress(OSError):  # a system that brings no names to the disk
                folder = os.open(self.shown.parent, os.O_RDONLY)
                os.fsync(folder)
                os.close(folder)

    def in_place(self):
        """Whether the file is still where it was published."""
        with suppress(OSError):
            return os.path.samestat(os.stat(self.shown), os.fstat(self.descriptor))
        return False

    def close(self):
        """Close the file; it holds what was committed. Its descriptor stays open, to be read from and closed."""
        try:
            with taken(self.shown):
                self._file.close()
                # give back what was reserved beyond the end that the closed file states (superblock 3: bytes 28 to 35)
                os.lseek(self.descriptor, 0, os.SEEK_SET)
                head = os.read(self.descriptor, 36)
                end = int.from_bytes(head[28:36], "little")
                if head[8] == 3 and 0 < end < os.fstat(self.descriptor).st_size:
                    os.ftruncate(self.descriptor, end)
        finally:
            lock(self.descriptor, on=False)

    def _discard(self):
        with suppress(Exception):
            self.close()
        os.close(self.descriptor)
        with suppress(OSError):
            os.unlink(self.path)


def _move_new(source, target):
    """Move a file to a name that is free, or fail."""
    try:
        os.link(source, target)
        os.unlink(source)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        target.touch(exist_ok=False)
        os.replace(source, target)


def _listed(value):
    return value.tolist() if hasattr(value, "tolist") else str(value)
