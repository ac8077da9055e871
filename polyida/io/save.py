"""Storage of a run: its frames in memory, and beyond a limit in a file; the other contents of the file of a run.

The file has the integrator, the scene and the plan before the run, and its status at every flush.
"""

import mmap
import os
import tempfile
from contextlib import suppress
from dataclasses import asdict, is_dataclass
from math import prod
from pathlib import Path

import numpy as np

from polyida import registry
from polyida.environment import LAZY, allocate
from polyida.errors import InputError
from polyida.io.layout import FRAMES, MEMORY_LIMIT, SENSORS, dtypes_of, require_unwritten, sensed_width, shapes_of
from polyida.io.reader import read_open
from polyida.io.scene_data import to_data
from polyida.io.writer import NotWritten, Writer, writing
from polyida.model import NONE
from polyida.reprs import FEW
from polyida.validation import flag, is_number

BLOCK = 1 << 20  # bytes that are written at once
WINDOW = 1 << 24  # bytes after which the system may drop those before from its cache
SMALL = 1 << 20  # bytes of a run's frames: fewer are copied to arrays of their own
PART = 8  # an array smaller than 1 / PART of the memory is copied: otherwise it would keep all of it


class Spill:
    """Temporary files, one for each array of a block, with numbers as in memory.

    rows: frames of a block; count: frames in complete blocks. Methods raise NotWritten.
    """

    def __init__(self, frame_bytes):
        self.rows, self.count, self.shown = max(1, BLOCK // frame_bytes), 0, Path(tempfile.gettempdir()) / "frames"
        self._files, self._cached = [], 0

    def append(self, block):
        """Append frames, a list of arrays. Safe to be interrupted and called again."""
        with writing(self.shown):
            self._files += [tempfile.TemporaryFile(buffering=0) for _ in block[len(self._files) :]]  # noqa: SIM115, they stay open
            for file, values in zip(self._files, block):
                _write(file, values.reshape(-1).view(np.uint8), self.count * values[:1].nbytes)
        self.count += len(block[0])
        self._cached += sum(values.nbytes for values in block)
        if self._cached > WINDOW and hasattr(os, "posix_fadvise"):
            for file in self._files:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
            self._cached = 0

    def arrays(self, block):
        """The frames as arrays, of the shapes and dtypes of a block; later changes of the arrays do not change the file."""
        return [_mapped(file, values, self.count) for file, values in zip(self._files, block)]


def _write(file, values, at):
    file.seek(at)
    done = 0
    while done < len(values):
        done += file.write(memoryview(values)[done:])


def _mapped(file, values, count):
    size = count * values[:1].nbytes
    if not size:
        return np.empty((count, *values.shape[1:]), values.dtype)
    mapping = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY)
    return np.frombuffer(mapping, values.dtype).reshape(count, *values.shape[1:])


class FrameStore:
    """Accepted states of one run.

    They are written to their final place in memory, up to `limit` bytes, and block after block from there to the `file`, if there is one.
    Beyond the limit, or from the start if more frames are `expected`, they go to the file or to temporary files, and memory has one block.
    single: q, v, a and lam in single precision. Raises NotWritten.
    """

    def __init__(self, n, m, limit=MEMORY_LIMIT, file=None, single=False, expected=0):
        self.file, self.limit, self.count, self._single = file, limit, 0, single
        self.drives = list(file.drives.values()) if file else []
        shapes = shapes_of(n, m, range(len(self.drives)))
        self._shapes, self._dtypes = list(shapes.values()), list(dtypes_of(shapes, single).values())
        self._away, self._first, self._rows = file, 0, 0  # the file of the frames before the block; their number; rows in the block
        many = self._many() if limit >= self._bytes(max(expected, file.rows if file else 1)) else [()]
        self._whole = len(many[0]) > 0
        self._block = many if self._whole else self._few()

    def _bytes(self, frames):
        return frames * sum(prod(shape) * dtype.itemsize for shape, dtype in zip(self._shapes, self._dtypes))

    def _many(self):
        """A block for all frames, a multiple of blocks of the file."""
        arrays = allocate(self._shapes, self._dtypes, self.limit)
        rows = len(arrays[0]) - (len(arrays[0]) % self.file.rows if self.file else 0)
        return [values[:rows] for values in arrays]

    def _few(self):
        """A block for frames on their way to a file."""
        self._away = self._away or Spill(self._bytes(1))
        return [np.empty((self._away.rows, *shape), dtype) for shape, dtype in zip(self._shapes, self._dtypes)]

    def rows(self, count):
        """The arrays of the next `count` frames, [q, v, a, lam], to write into; None if they are not the final ones."""
        first, end = self._rows, self._rows + count
        if self._single or not self._whole or end > len(self._block[0]):
            return None
        return [values[first:end] for values in self._block[1 : len(FRAMES)]]

    def extend(self, stretch):
        """Store the states of a Stretch; those that are in `rows` already are not copied."""
        self._extend([getattr(stretch, name) for name in FRAMES])

    def copy(self, columns, count):
        """Store the first `count` frames of arrays or StoredFrames, in the order of FRAMES."""
        for first in range(0, count, self.file.rows):
            self._extend([values[first : min(first + self.file.rows, count)] for values in columns])

    def _extend(self, columns):
        done, whole = 0, len(columns[0])
        while done < whole:
            first, free = self._rows, len(self._block[0]) - self._rows
            if self._away:
                free = min(free, self._away.count + self._away.rows - self.count)
            count = min(free, whole - done)
            for values, column in zip(self._block, columns):
                values[first : first + count] = column[done : done + count]
            for values, profile in zip(self._block[len(FRAMES) :], self.drives):
                values[first : first + count] = [profile.at(t) for t in columns[0][done : done + count]]
            self._rows, self.count, done = first + count, self.count + count, done + count
            if count == free:
                self.put_away()

    def waiting(self):
        """The frames that the file does not have yet, one block at most."""
        first = self._away.count - self._first
        return [values[first : self._rows] for values in self._block]

    def put_away(self):
        """Write waiting frames to the file; after a full block memory has one block. It may be interrupted and called again."""
        full = self._rows == len(self._block[0])
        if full and self._away is None:
            self._away = Spill(self._bytes(1))
        while self._away and self.count > self._away.count:
            self._away.append([values[: self._away.rows] for values in self.waiting()])
        if full:
            block = self._few() if self._whole else self._block
            self._whole, self._block, self._first, self._rows = False, block, self.count, 0

    def arrays(self):
        """{name: frames} of all stored, or committed, frames, arrays or StoredFrames. The store cannot be used afterwards."""
        block, self._block = self._block, []
        if self.file:
            with suppress(NotWritten):
                self.file.close()
            if not self._whole:
                return read_open(self.file.descriptor, self.file.shown).frames(self.limit)
            os.close(self.file.descriptor)
        if not self._whole:
            return dict(zip(FRAMES, self._away.arrays(block)))
        columns = [values[: self.file.committed if self.file else self.count] for values in block]
        whole = sum(values.nbytes for values in columns)
        stays = LAZY and whole > SMALL
        return {name: values if stays and PART * values.nbytes > whole else values.copy() for name, values in zip(FRAMES, columns)}


def save(run, path, overwrite=False):
    """Write a trajectory; the file appears complete or not at all. Raises InputError if it exists and overwrite is False."""
    run.known_model("save")
    path, n, m = free(path, overwrite), run.q.shape[1], run.lam.shape[1]
    single = run.q.dtype == np.float32
    file = create(path, run.model, run.integrator, n, m, run.plan, run.machine, single, run.sensors.shapes)
    with file.publishing(overwrite):
        store = FrameStore(n, m, 0, file, single)
        store.copy([getattr(run, name) for name in FRAMES], len(run))
        store.put_away()
        seconds, sensed = (run.cpu_seconds, run.wall_seconds, run.compile_seconds), behind_blocks(file, run.sensors.rows)
        commit(store, run.status, run.message, run.counts, seconds, run.restart, sensed, True, run.events, run.settings_used)
        file.close()
    os.close(file.descriptor)


def free(path_given, overwrite):
    """The absolute path of a file that can be written, symbolic links followed.

    Raises InputError if the file exists and must not be overwritten, is being written, or cannot be written there.
    """
    flag(path_given, "overwrite", overwrite)
    try:
        path = Path(path_given).resolve()
        folder, file, there, home = path.is_dir(), path.is_file(), path.exists(), path.parent.is_dir()
    except (TypeError, ValueError, OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path_given!r:.100} must be the path of a file ({reason})") from None
    if path.is_symlink():  # Python 3.13 gives a loop back
        raise InputError(f"{path_given} is a symlink that leads nowhere but to itself")
    if folder:
        raise InputError(f"{str(path_given)!r} is a folder; give the name of a file")
    if there and not file:
        raise InputError(f"{path_given} is a device or a pipe, no file; frames cannot be written there")
    if there and not overwrite:
        raise InputError(f"{path_given} exists; pass overwrite=True (--overwrite) to replace it, or give another name")
    if not home:
        raise InputError(f"{path_given}: the folder {path.parent} does not exist")
    if there:
        require_unwritten(path)
    return path


def behind_blocks(file, rows):
    """Write complete blocks of sensor rows to a file; returns the rows after them."""
    table = file.sensors
    while len(rows) - table.count >= table.rows:
        file.append([rows[table.count : table.count + table.rows]], table)
    return rows[table.count :]


def create(path, model, integrator, n, m, plan, machine, single=False, sensors=NONE):
    """A Writer with the contents that are known before the run: integrator, scene, plan, machine. sensors: {name: shape of a value}."""
    kind = integrator if isinstance(integrator, str) else registry.name_of(type(integrator))
    settings = asdict(integrator) if is_dataclass(integrator) else {}
    about = {"integrator": {"kind": kind, "settings": settings}, "model": type(model).__name__, "plan": plan, "machine": machine}
    about |= {SENSORS: dict(sensors)} if sensors else {}
    scene, arrays, drives = to_data(model) if model.parts else (None, {}, {})
    about |= ({"scene": scene, "redundant": model.treats_redundant, "late": model.late} if scene else {}) | {
        "drives": {key: name for key, (name, _) in drives.items()}
    }
    profiles = {key: profile for key, (_, profile) in drives.items()}
    arrays = {f"scene/{key}": array for key, array in arrays.items()}
    return Writer.create(path, n, m, about, arrays, profiles, bool(plan.get("fsync")), single, sensed_width(sensors))


def _is_short(value):
    """True for a number, a text, True, False, None, and a few numbers."""
    return (
        value is None
        or isinstance(value, bool | int | float | str)
        or isinstance(value, tuple)
        and len(value) <= FEW
        and all(map(is_number, value))
    )


def commit(store, status, message, counts, seconds, restart, sensed, last=False, events=None, used=None):
    """Commit the frames so far with the status of the run and the state to continue from.

    sensed: sensor rows after the blocks. events: Events or None. used: {setting: value} of the integrator; lists are among its settings, in "about".
    """
    record = {
        "status": status,
        "message": message,
        "counts": counts.as_dict(),
        "cpu_seconds": seconds[0],
        "wall_seconds": seconds[1],
        "compile_seconds": seconds[2],
        "settings_used": {name: value for name, value in (used or {}).items() if _is_short(value)},
        "restart": None,
        "memory": [],
    }
    record |= {"events": events.to_data()} if events is not None and (events.given or len(events)) else {}
    numbers = []
    if restart:
        s = restart.state
        memory = {name: np.asarray(value, float) for name, value in s.memory.items()}
        record |= {
            "restart": {"frames": restart.frames, "counts": restart.counts},
            "memory": [[name, list(value.shape)] for name, value in memory.items()],
        }
        numbers = [s.t, s.q, s.v, s.a, s.lam, *memory.values()]
    store.file.commit(record, numbers, store.waiting(), sensed, last)
