"""The HDF5 file that frames of a run are appended to, readable at every moment, also after the process was killed."""

import errno
import json
import os
import time
import zlib
from contextlib import contextmanager, suppress
from math import prod
from uuid import uuid4

import numpy as np

from polyida.errors import InputError
from polyida.io.layout import FORMAT, HEAD, SENSORS, chunk_of, dtypes_of, frames_at_once, shapes_of, width_of
from polyida.io.locks import HAS_LOCKS, being_written, lock, require_unwritten

ABOVE = 1 << 18  # bytes that are reserved on the disk beyond the known size
SLOT_CHUNK = 1 << 16
CHECK = 4  # bytes of a chunk's checksum
YOUNG = 60.0  # s: a younger file without a lock may be locked soon
FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


class Table:
    """Datasets that grow together, block by block; a block is written once. Datasets without columns are not in the file.

    shapes, dtypes: {name: shape of a row, or its dtype}. rows: of a block. count: rows in complete blocks.
    """

    def __init__(self, shapes, dtypes):
        """Take {name: shape of a row} and {name: dtype}; the datasets are made by `make`."""
        self.shapes, self.dtypes = shapes, dtypes
        self.count = 0
        self.rows = frames_at_once(width_of(shapes))
        self.chunks = {name: chunk_of(self.rows, shape) for name, shape in shapes.items() if shape != (0,)}
        self._datasets = {}  # {name: dataset} of an open file
        self.block_bytes = 0  # on the disk
        for name, chunk in self.chunks.items():
            count = -(-self.rows * prod(shapes[name]) // prod(chunk))
            self.block_bytes += count * (prod(chunk) * dtypes[name].itemsize + CHECK)

    def make(self, file):
        """Create the table's empty datasets in an open HDF5 file."""
        for name, chunk in self.chunks.items():
            options = {"maxshape": (None, *self.shapes[name]), "chunks": chunk, "fletcher32": True}
            file.create_dataset(name, (0, *self.shapes[name]), self.dtypes[name], **options)

    def open(self, file):
        """Take the datasets of an open file, to append to them."""
        self._datasets = {name: file[name] for name in self.chunks}

    def bytes(self, more=0):
        """Bytes of all chunks of the table with `more` further rows."""
        return -(-(self.count + more) // self.rows) * self.block_bytes

    def append(self, block):
        """Append rows, a list of arrays in the order of `shapes`: a block, or fewer as the last ones."""
        for name, values in zip(self.shapes, block):
            if name in self._datasets:
                self._datasets[name].resize(self.count + len(values), axis=0)
                self._datasets[name][self.count :] = values
        self.count += len(block[0])


class NotWritten(Exception):
    """Writing failed; `status` is "disk full" or "not written"."""

    def __init__(self, path, error):
        """Take the path and the exception, whose errno gives the status and the message."""
        number = getattr(error, "errno", None)
        self.status = "disk full" if number in FULL else "not written"
        super().__init__(f"{path}: {os.strerror(number) if number else error}")


def write_all(descriptor, data):
    """Write all bytes at the present place of a descriptor."""
    left = memoryview(data)
    while left:
        left = left[os.write(descriptor, left) :]


@contextmanager
def writing(path):
    """Context in which errors of the disk become NotWritten."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        raise NotWritten(path, error) from None


class Writer:
    """An open file, beside `shown` until `publishing` moves it there. Methods raise NotWritten.

    path: its present place. single: see FrameStore. frames, sensors: Tables; committed: frames of the last commit. drives: {name: profile}; width:
    of a row of sensors, 0 without sensors.
    """

    def __init__(self, shown, n, m, about, arrays, drives, fsync=False, single=False, width=0):
        """Make the file beside its place.

        about: plain data; arrays: {path: array} of the scene; fsync: wait for the disk at each commit.
        """
        import h5py

        self.shown, self.path = shown, shown.with_name(f".polyida-{uuid4().hex}.part")
        self.drives, self.fsync = drives, fsync
        shapes = shapes_of(n, m, drives)
        self.frames = Table(shapes, dtypes_of(shapes, single))
        self.sensors = Table({SENSORS: (width,)}, {SENSORS: np.dtype("f8")})
        self.commits = self.committed = 0  # number of commits, and of frames in the last one
        self._tables = self.frames, self.sensors
        head = self._head(about, arrays)
        self._start = len(head)  # bytes of the file without frames
        self._slots = 2 * (sum(table.block_bytes for table in self._tables) + SLOT_CHUNK)  # bytes of both
        self._reserved = 0  # bytes of the file that the disk has reserved
        self._file = None  # the open file of h5py
        with writing(shown):
            self.descriptor = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666)
        try:
            with writing(shown):
                lock(self.descriptor)
                write_all(self.descriptor, head)
                self._reserve()
                self._file = h5py.File(self.path, "r+", libver="v110", locking=False)
                for table in self._tables:
                    table.open(self._file)
                self._file.swmr_mode = True  # cuts the file to what is in it
                self._reserved = 0
                self._reserve()
        except NotWritten:
            self._discard()
            raise

    @classmethod
    def create(cls, path, *contents):
        """A file that `publishing` moves to `path`. Raises InputError."""
        # remove files of processes that were killed before they published them
        for old in path.parent.glob(".polyida-*.part"):
            with suppress(OSError):
                if HAS_LOCKS and time.time() - old.stat().st_mtime > YOUNG and not being_written(old):
                    old.unlink()
        try:
            return cls(path, *contents)
        except NotWritten as error:
            raise InputError(f"no file can be written there: {error}") from None

    def _head(self, about, arrays):
        """The bytes of a file without frames, made in memory: HDF5 crashes later if it cannot write what it has begun."""
        import h5py

        with h5py.File(self.path.name, "w", libver="v110", driver="core", backing_store=False) as file:
            for table in self._tables:
                table.make(file)
            file.attrs["format"] = FORMAT
            text = np.frombuffer(json.dumps(about, default=_listed).encode(), np.uint8)
            for key, values in {"about": text, **arrays}.items():
                checked = {"chunks": values.shape, "fletcher32": True} if values.size else {}
                file.create_dataset(key, data=values, **checked)
            for slot in range(2):
                file.create_dataset(f"slot {slot}", (0,), "u1", maxshape=(None,), chunks=(SLOT_CHUNK,))
            file.flush()
            return file.id.get_file_image()

    @property
    def rows(self):
        """Number of frames of a block."""
        return self.frames.rows

    @property
    def count(self):
        """Number of frames in the whole blocks that were written."""
        return self.frames.count

    def append(self, block, table=None):
        """Append a block of frames, a list of arrays in the order of their shapes, or of the rows of another table."""
        table = table or self.frames
        with writing(self.shown):
            self._reserve(table, len(block[0]))
            table.append(block)

    def commit(self, record, numbers, tail, sensed, last=False):
        """Commit all frames so far: flush them, then `record` (plain data), the state `numbers`, frames `tail` and sensor rows `sensed`.

        last: into both slots, so that damage to one of them does no harm.
        """
        record |= {"frames": self.frames.count + len(tail[0]), "tail": len(tail[0])}
        record |= {"sensors": self.sensors.count + len(sensed), "sensors tail": len(sensed)}
        numbers = np.concatenate([np.ravel(x) for x in (*numbers, *tail, sensed)]).tobytes()
        for _ in range(1 + last):
            text = json.dumps(record | {"commit": self.commits}, default=_listed).encode()
            body = text + numbers
            content = np.frombuffer(HEAD.pack(len(body), zlib.crc32(body), len(text)) + body, np.uint8)
            with writing(self.shown):
                self._slots = max(self._slots, 2 * (len(content) + SLOT_CHUNK))
                self._reserve()
                self._flush()
                slot = self._file[f"slot {self.commits % 2}"]
                slot.resize(max(len(slot), len(content)), axis=0)
                slot[: len(content)] = content
                self._flush()
            self.commits, self.committed = self.commits + 1, record["frames"]

    def _flush(self):
        """Hand the data of the file to the operating system, and to the disk if `fsync` is set."""
        self._file.flush()
        if self.fsync:
            os.fsync(self.descriptor)

    def _reserve(self, growing=None, rows=0):
        """Reserve space on the disk for `rows` more: HDF5 cannot close a file that it could not write.

        HDF5 places chunks late, so the size is computed here: complete chunks, their checksums and index.
        """
        size = os.fstat(self.descriptor).st_size
        if size < self._reserved:
            raise OSError(f"another program cut the file to {size} bytes")
        chunks = sum(table.bytes(rows if table is growing else 0) for table in self._tables)
        need = self._start + chunks + chunks // 32 + self._slots + ABOVE
        if need <= self._reserved:
            return
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self.descriptor, 0, need)
        else:  # macOS, Windows
            os.lseek(self.descriptor, 0, os.SEEK_END)
            write_all(self.descriptor, bytes(max(0, need - size)))
        self._reserved = need

    @contextmanager
    def publishing(self, overwrite):
        """Context of the first writes: at its end the file is moved to its place; after an error it is removed.

        Raises InputError, also if another file has appeared there that must not be overwritten.
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
        """Move the file to its place. Raises InputError if another one is there that must not be replaced."""
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
            with suppress(OSError):  # systems that cannot sync a folder
                folder = os.open(self.shown.parent, os.O_RDONLY)
                os.fsync(folder)
                os.close(folder)

    def in_place(self):
        """True if the file is still where it was published."""
        with suppress(OSError):
            return os.path.samestat(os.stat(self.shown), os.fstat(self.descriptor))
        return False

    def close(self):
        """Close the file with the committed frames. Its descriptor stays open for reading."""
        try:
            with writing(self.shown):
                if self._file is None:
                    return
                self._file.close()
                # release the reserved space beyond the end of the closed file (superblock 3: bytes 28 to 35)
                os.lseek(self.descriptor, 0, os.SEEK_SET)
                head = os.read(self.descriptor, 36)
                end = int.from_bytes(head[28:36], "little")
                if head[8] == 3 and 0 < end < os.fstat(self.descriptor).st_size:
                    os.ftruncate(self.descriptor, end)
        finally:
            lock(self.descriptor, on=False)

    def _discard(self):
        """Close and remove the file; errors of either are ignored."""
        with suppress(Exception):
            self.close()
        os.close(self.descriptor)
        with suppress(OSError):
            os.unlink(self.path)


def _move_new(source, target):
    """Move a file to a name that is free. Raises FileExistsError if it is not."""
    try:
        os.link(source, target)
        os.unlink(source)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        target.touch(exist_ok=False)
        os.replace(source, target)


def _listed(value):
    """A value that JSON does not know as plain data: lists of an array, otherwise its text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)
