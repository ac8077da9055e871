"""The HDF5 file that frames of a run are appended to, readable at every moment, also after the process was killed.

Layout: `format` (attribute); `about`, JSON as bytes; `scene/...`, arrays that `about` refers to; frames `t`
(frames,), `q`, `v`, `a` (frames, n), `lam` (frames, m), in HDF5's mode for one writer and many readers (SWMR); `drive
i` (frames, 3) of profiles that have no formula; two slots each of `record` (JSON: how many frames hold, how the run
stands) and `restart` (the state to go on from). A flush writes the frames, then the slot that is older: the other one
stays whole whenever the process ends.
"""

import errno
import json
import os
import struct
import tempfile
import zlib
from contextlib import suppress

import numpy as np

from polyida.errors import InputError
from polyida.file_lock import lock
from polyida.frames import FRAMES, StoredFrames, frames_at_once

FORMAT = "polyida trajectory 2"
ABOVE = 1 << 18  # bytes that are reserved on the disk beyond what is known to be needed
SLOTS = 4 << 15  # bytes of the first chunks of the slots
FULL = (errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC))


class NotWritten(Exception):
    """The disk did not take what was to be written; `status` says in two words why."""

    def __init__(self, path, error):
        number = getattr(error, "errno", None)
        self.status = "disk full" if number in FULL else "not written"
        super().__init__(f"{path}: {os.strerror(number) if number else error}")


class FrameFile:
    """A file under construction; made by `create` or `temporary`. Methods raise NotWritten."""

    def __init__(self, path, n, m, about=None, arrays=None, drives=None):
        import h5py

        self.path, self.shown, self.count, self.commits, self.drives = path, path, 0, 0, drives or {}
        self._reserved, self._reserver, self._datasets, self._slots = 0, os.open(path, os.O_RDWR), {}, 0
        try:
            lock(self._reserver)
            self._file = h5py.File(path, "w", libver="v110", locking=False)
            self._make(n, m, about, arrays or {})
            self._file.flush()
            self._start = self._file.id.get_filesize()
        except OSError as error:
            raise NotWritten(path, error) from None

    @classmethod
    def create(cls, path, n, m, about, arrays, drives):
        """A file beside `path` that comes to its place by `publish`."""
        hidden = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            hidden.unlink(missing_ok=True)
            hidden.touch()
            file = cls(hidden, n, m, about, arrays, drives)
        except (OSError, NotWritten) as error:
            with suppress(OSError):
                hidden.unlink(missing_ok=True)
            raise InputError(
                f"{path}: no file can be written there ({getattr(error, 'strerror', None) or error})"
            ) from None
        file.shown = path
        return file

    @classmethod
    def temporary(cls, n, m):
        """A file without a name in the folder for temporary files; it is gone when nobody reads it any more."""
        handle, path = tempfile.mkstemp(prefix="polyida-", suffix=".h5")
        os.close(handle)
        try:
            return cls(path, n, m)
        finally:
            os.unlink(path)

    def _make(self, n, m, about, arrays):
        for name, width in zip(FRAMES, (None, n, n, n, m)):
            self._dataset(name, width)
        for name in self.drives:
            self._dataset(name, 3)
        if about is None:
            return
        self._file.attrs["format"] = FORMAT
        self._file["about"] = np.frombuffer(json.dumps(about, default=_listed).encode(), np.uint8)
        for key, values in arrays.items():
            self._file[key] = values
        for slot in range(2):
            self._file.create_dataset(f"record {slot}", (0,), "u1", maxshape=(None,), chunks=(1 << 14,))
            self._file.create_dataset(f"restart {slot}", (0,), "f8", maxshape=(None,), chunks=(1 << 12,))
        self._file.flush()
        self._file.swmr_mode = True

    def _dataset(self, name, width):
        if width == 0:
            return
        shape, rows = (() if width is None else (width,)), frames_at_once(32 * (width or 1))
        self._datasets[name] = self._file.create_dataset(
            name, (0, *shape), "f8", maxshape=(None, *shape), chunks=(rows, *shape), fill_time="never"
        )

    def append(self, block):
        """Append frames, a list of arrays in the order of FRAMES."""
        end = self.count + len(block[0])
        values = dict(zip(FRAMES, block))
        values |= {name: np.array([profile.at(t) for t in block[0]], float) for name, profile in self.drives.items()}
        try:
            self._reserve(end)
            for name, dataset in self._datasets.items():
                dataset.resize(end, axis=0)
                dataset[self.count : end] = values[name]
        except (OSError, RuntimeError) as error:
            raise NotWritten(self.shown, error) from None
        self.count = end

    def commit(self, record, restart, memory):
        """Make all frames so far hold: flush them, then `record` (plain data) with the numbers `restart`."""
        slot = self.commits % 2
        numbers = np.concatenate([np.ravel(x) for x in restart])
        record = record | {
            "commit": self.commits,
            "frames": self.count,
            "memory": memory,
            "numbers": len(numbers),
            "check": zlib.crc32(numbers.tobytes()),
        }
        text = json.dumps(record, default=_listed).encode()
        try:
            self._slots = max(self._slots, 2 * (numbers.nbytes + len(text)) + SLOTS)
            self._reserve(self.count)
            self._put(f"restart {slot}", numbers)
            self._file.flush()
            self._put(f"record {slot}", np.frombuffer(struct.pack("<II", len(text), zlib.crc32(text)) + text, np.uint8))
            self._file.flush()
        except (OSError, RuntimeError) as error:
            raise NotWritten(self.shown, error) from None
        self.commits += 1

    def _put(self, name, values):
        dataset = self._file[name]
        if len(dataset) < len(values):
            dataset.resize(len(values), axis=0)
        dataset[: len(values)] = values

    def _reserve(self, count):
        """Have the disk promise room for `count` frames before HDF5 gets them: a file that it could not write it cannot close.

        HDF5 gives chunks their place late, so what is needed is counted here: whole chunks, and their index.
        """
        chunks = sum(-(-count // x.chunks[0]) * 8 * int(np.prod(x.chunks)) for x in self._datasets.values())
        need = self._start + chunks + chunks // 32 + self._slots + ABOVE
        if need > self._reserved and hasattr(os, "posix_fallocate"):
            os.posix_fallocate(self._reserver, 0, need)
            self._reserved = need

    def publish(self, overwrite):
        """Move the file to its place. Raises InputError where one came there meanwhile and `overwrite` is False."""
        try:
            if overwrite:
                os.replace(self.path, self.shown)
            else:
                _move_new(self.path, self.shown)
        except OSError as error:
            raise InputError(f"{self.shown}: the file cannot be put there ({error.strerror})") from None
        self.path = self.shown

    def frames(self, limit):
        """{name: frames} of a temporary file, to which nothing is added any more."""
        os.close(self._reserver)
        return held(self._file, self.count, limit, self.shown)

    def close(self):
        """Close the file; it holds what was committed."""
        try:
            self._file.close()
            _trim(self.path)
        except (OSError, RuntimeError) as error:
            raise NotWritten(self.shown, error) from None
        finally:
            os.close(self._reserver)

    def discard(self):
        """Close and remove a file that was not published."""
        with suppress(NotWritten):
            self.close()
        with suppress(OSError):
            os.unlink(self.path)


def held(file, count, limit, path):
    """{name: frames} of the first `count` frames of an open file: arrays, or StoredFrames of what is large."""
    frames = {"t": file["t"][:count]}
    sizes = {name: file[name].shape[1] if name in file else 0 for name in FRAMES[1:]}
    whole = 8 * count * sum(sizes.values()) <= limit
    for name, width in sizes.items():
        if width == 0:
            frames[name] = np.zeros((count, 0))
        else:
            stored = StoredFrames(file[name], count, file, path)
            frames[name] = np.asarray(stored) if whole or 32 * stored.nbytes <= limit else stored
    return frames


def _move_new(source, target):
    """Move a file to a name that is free, or fail."""
    try:
        os.link(source, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if os.path.exists(target):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST)) from None
        os.rename(source, target)
    else:
        os.unlink(source)


def _trim(path):
    """Give back what was reserved beyond the end that the closed file states (superblock 3: bytes 28 to 35)."""
    if not os.path.exists(path):
        return
    with open(path, "r+b") as file:
        head = file.read(36)
        end = int.from_bytes(head[28:36], "little")
        if head[8] == 3 and 0 < end < os.path.getsize(path):
            file.truncate(end)


def _listed(value):
    return value.tolist() if hasattr(value, "tolist") else str(value)
