"""The contents of the file of a run, and where it may be written.

Before the run `create` writes the integrator, the scene and the plan. At every flush `commit` writes the status, and the state to continue from.
`save` does both for a run that has ended.
"""

import os
from dataclasses import asdict, is_dataclass
from pathlib import Path

import numpy as np

from polyida import registry
from polyida.errors import InputError
from polyida.io.layout import FRAMES, SENSORS, sensed_width
from polyida.io.locks import require_unwritten
from polyida.io.scene_data import to_data
from polyida.io.store import FrameStore
from polyida.io.writer import Writer
from polyida.model import NONE
from polyida.reprs import FEW
from polyida.validation import flag, is_number


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
    """Return the absolute path of a file that can be written, after symbolic links.

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
    """True for None, a bool, a number, a text, or a tuple of at most FEW numbers."""
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
