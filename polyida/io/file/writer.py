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
from polyida.io.file.checksum import fletcher32
from polyida.io.file.layout import FORMAT, HEAD, chunk_of, dtypes_of, frames_at_once, shapes_of, width_of
from polyida.io.file.lock import CAN_TELL, being_written, lock, require_unwritten

ABOVE = 1 << 18  # bytes that are reserved on the disk beyond what is known to be needed
SLOT_CHUNK = 1 << 16
CHECK = 4  # bytes of a chunk's checksum
YOUNG = 60.0  # s: a file of that age that nobody has locked may be about to be
FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


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

    path: where it lies. single: see FrameStore. count: frames in whole blocks; held: frames of the last commit. drives: {name: profile}.
    """

    def __init__(self, shown, n, m, about, arrays, drives, fsync=False, single=False):
        import h5py

        self.shown, self.path, self.commits = shown, shown.with_name(f".polyida-{uuid4().hex}.part"), 0
        self.count = self.held = 0
        self.drives, self.fsync, self.shapes = drives, fsync, shapes_of(n, m, drives)
        self.rows = frames_at_once(width_of(self.shapes))
        shapes, dtypes = self.shapes.items(), dtypes_of(self.shapes, single)
        self._packs = {name: _pack(chunk_of(self.rows, shape), dtypes[name]) for name, shape in shapes if shape != (0,)}
        self._block = sum(len(stored) * -(-self._size(name) // numbers.size) for name, (stored, numbers) in self._packs.items())
        self._reserved, self._slots, self._datasets = 0, 2 * (self._block + SLOT_CHUNK), {}
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
        _remove_leftovers(path.parent)
        try:
            return cls(path, *contents)
        except NotWritten as error:
            raise InputError(f"no file can be written there: {error}") from None

    def _make(self, about, arrays):
        for name, (_, numbers) in self._packs.items():
            shape = self.shapes[name]
            options = {"maxshape": (None, *shape), "chunks": numbers.shape, "fletcher32": True}
            self._datasets[name] = self._file.create_dataset(name, (0, *shape), numbers.dtype, **options)
        self._file.attrs["format"] = FORMAT
        text = np.frombuffer(json.dumps(about, default=_listed).encode(), np.uint8)
        for key, values in {"about": text, **arrays}.items():
            checked = {"chunks": values.shape, "fletcher32": True} if values.size else {}
            self._file.create_dataset(key, data=values, **checked)
        for slot in range(2):
            self._file.create_dataset(f"slot {slot}", (0,), "u1", maxshape=(None,), chunks=(SLOT_CHUNK,))
        self._file.flush()
        self._file.swmr_mode = True

    def _size(self, name):
        """Numbers of a block."""
        return self.rows * int(np.prod(self.shapes[name]))

    def append(self, block):
        """Append frames, a list of arrays in the order of `shapes`: as many as a chunk holds, or the run's last ones."""
        end = self.count + len(block[0])
        with taken(self.shown):
            self._reserve(end)
            for name, values in zip(self.shapes, block):
                if name in self._datasets:
                    self._put(self._datasets[name].id, *self._packs[name], values)
        self.count = end

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

    def commit(self, record, numbers, tail, last=False):
        """Make all frames so far hold: flush them, then `record` (plain data), the state `numbers` and the frames `tail`.

        last: into both slots, so that damage to one of them does no harm.
        """
        record |= {"frames": self.count + len(tail[0]), "tail": len(tail[0])}
        numbers = np.concatenate([np.ravel(x) for x in (*numbers, *tail)]).tobytes()
        for _ in range(1 + last):
            text = json.dumps(record | {"commit": self.commits}, default=_listed).encode()
            body = text + numbers
            content = np.frombuffer(HEAD.pack(len(body), zlib.crc32(body), len(text)) + body, np.uint8)
            with taken(self.shown):
                self._slots = max(self._slots, 2 * (len(content) + SLOT_CHUNK))
                self._reserve(self.count)
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

    def _reserve(self, count):
        """Have the disk promise room for `count` frames before HDF5 gets them: a file that it could not write it cannot close.

        HDF5 gives chunks their place late, so what is needed is counted here: whole chunks, their checksums and index.
        """
        chunks = -(-count // self.rows) * self._block
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
                _trim(self.descriptor)
        finally:
            lock(self.descriptor, on=False)

    def _discard(self):
        with suppress(Exception):
            self.close()
        os.close(self.descriptor)
        with suppress(OSError):
            os.unlink(self.path)


def _remove_leftovers(folder):
    """Remove files that a process has made here and was killed before it published them, where that can be told."""
    for path in folder.glob(".polyida-*.part"):
        with suppress(OSError):
            if CAN_TELL and time.time() - path.stat().st_mtime > YOUNG and not being_written(path):
                path.unlink()


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


def _pack(chunk, dtype):
    """(the bytes of a chunk as it is stored, its numbers in them)."""
    stored = np.empty(dtype.itemsize * int(np.prod(chunk)) + CHECK, np.uint8)
    return stored, stored[:-CHECK].view(dtype).reshape(chunk)


def _trim(descriptor):
    """Give back what was reserved beyond the end that the closed file states (superblock 3: bytes 28 to 35)."""
    os.lseek(descriptor, 0, os.SEEK_SET)
    head = os.read(descriptor, 36)
    end = int.from_bytes(head[28:36], "little")
    if head[8] == 3 and 0 < end < os.fstat(descriptor).st_size:
        os.ftruncate(descriptor, end)


def _listed(value):
    return value.tolist() if hasattr(value, "tolist") else str(value)
