"""Trajectories in HDF5 files: frames, how the run went, and the scene as data. Nothing in a file is ever executed."""

import zlib
from contextlib import contextmanager
from dataclasses import asdict, dataclass, is_dataclass
from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.file_lock import being_written
from polyida.frame_file import FORMAT, FrameFile, NotWritten, held
from polyida.frames import FRAMES, MEMORY_LIMIT, StoredFrames, frames_at_once
from polyida.integrate.state import Counts, State
from polyida.scene_data import from_data, to_data
from polyida.trajectory import Restart, Trajectory
from polyida.untrusted import Reader, opened

STILL = "another process is still writing it; these are the frames up to its last flush"
KILLED = "the process that ran it ended without closing the file; it holds the frames up to the last flush"
INTEGRATORS = ("GeneralizedAlpha", "IDA", "EnergyMomentum")


def save(run, path, overwrite=False):
    """Write a trajectory; the file appears whole or not at all. Raises InputError where it must not be overwritten."""
    path = Path(path)
    require_free(path, overwrite)
    file = create(path, run.model, run.integrator, run.q.shape[1], run.lam.shape[1], run.plan, run.machine)
    try:
        copy_frames(file, [getattr(run, name) for name in FRAMES], len(run))
        commit(file, run.status, run.message, run.counts, (run.cpu_seconds, run.wall_seconds), run.restart)
        file.close()
        file.publish(overwrite)
    except NotWritten as error:
        raise InputError(str(error)) from None
    finally:
        if file.path != path:
            file.discard()


def require_free(path, overwrite):
    """Raise InputError where a file is in the way and must not be overwritten, or no file can be."""
    if path.is_dir():
        raise InputError(f"{path} is a folder; give the name of a file")
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists; pass overwrite=True (--overwrite) to replace it, or give another name")
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist")


def create(path, model, integrator, n, m, plan, machine):
    """A FrameFile with what is known before the run: integrator, scene, what was asked for, on what machine."""
    about, arrays, drives = describe(model, integrator)
    return FrameFile.create(path, n, m, about | {"plan": plan, "machine": machine}, arrays, drives)


def describe(model, integrator):
    """(plain data, {key: array}, {dataset: profile that has no formula}) of a model and an integrator."""
    kind = integrator if isinstance(integrator, str) else type(integrator).__name__
    settings = asdict(integrator) if is_dataclass(integrator) else {}
    about = {"integrator": {"kind": kind, "settings": settings}, "model": type(model).__name__, "drives": {}}
    if not hasattr(model, "parts"):
        return about, {}, {}
    about["scene"], arrays = to_data(model.parts, model.gravity)
    drives = {}
    for number, (name, part) in enumerate(model.parts.items()):
        profile = getattr(part, "angle", None) if hasattr(part, "a") else getattr(part, "profile", None)
        if profile is not None and not profile.formula:
            about["drives"][name] = f"drive {number}"
            drives[f"drive {number}"] = profile
    return about, {f"scene/{key}": array for key, array in arrays.items()}, drives


def copy_frames(file, frames, count):
    """Append the first `count` of frames (a list in the order of FRAMES), a bounded number at once."""
    step = frames_at_once(sum(values.shape[1] if values.ndim > 1 else 1 for values in frames))
    for first in range(0, count, step):
        file.append([values[first : min(first + step, count)] for values in frames])


def continuation(path, stored, model, integrator, plan):
    """A FrameFile in the place of a stored one, with its frames up to where the run goes on."""
    file = create(path, model, integrator, stored.n, stored.m, plan, dict(stored.about["machine"]))
    try:
        count = min(stored.restart.frames, stored.count)
        copy_frames(file, [held(stored.file, count, 0, path)[name] for name in FRAMES], count)
        seconds = float(stored.record["cpu_seconds"]), float(stored.record["wall_seconds"])
        commit(file, "running", "", Counts(**stored.restart.counts), seconds, stored.restart)
        file.publish(True)
    except NotWritten as error:
        raise InputError(str(error)) from None
    finally:
        if file.path != path:
            file.discard()
    return file


def commit(file, status, message, counts, seconds, restart):
    """Make the frames so far hold, with how the run stands and where it goes on."""
    record = {
        "status": status,
        "message": message,
        "counts": counts.as_dict(),
        "cpu_seconds": seconds[0],
        "wall_seconds": seconds[1],
    }
    if restart is None:
        return file.commit(record | {"restart": None}, [np.zeros(0)], [])
    s = restart.state
    memory = {name: np.asarray(value, float) for name, value in s.memory.items()}
    record["restart"] = {"frames": restart.frames, "counts": restart.counts}
    file.commit(
        record, [s.t, s.q, s.v, s.a, s.lam, *memory.values()], [[name, list(x.shape)] for name, x in memory.items()]
    )


@dataclass
class Stored:
    """An open file, checked: plain data, arrays of the scene, the last whole record, where the run goes on."""

    path: Path
    file: object
    about: dict
    arrays: dict
    record: dict
    restart: Restart | None
    count: int
    n: int
    m: int

    def frames(self, limit):
        """{name: frames}; the file is closed where all are in memory."""
        frames = held(self.file, self.count, limit, self.path)
        if not (np.isfinite(frames["t"]).all() and (np.diff(frames["t"]) >= 0).all()):
            raise InputError("the times of the frames do not increase; the file is damaged")
        if not any(isinstance(values, StoredFrames) for values in frames.values()):
            self.file.close()
        return frames


def load(path, memory_limit=MEMORY_LIMIT):
    """Read a trajectory. Raises InputError naming the file where it is missing, truncated or of another kind.

    Frames beyond `memory_limit` bytes stay in the file and are read when asked for. A file of a run that was killed
    holds the frames up to the last flush, with status "interrupted"; one that is still written, those up to now, with
    status "running". The scene is built again from the file's data. A motor or load whose profile was a function of
    the user's own follows the values that the run saw, which are in the file.
    """
    with naming(path):
        stored = read(path)
        try:
            return _trajectory(stored, memory_limit)
        except BaseException:
            stored.file.close()
            raise


def _trajectory(stored, memory_limit):
    about, record = stored.about, stored.record
    model = model_of(stored, _drives(stored))
    status, message = str(record["status"]), str(record["message"])
    if status == "running":
        status, message = ("running", STILL) if being_written(stored.path) else ("interrupted", KILLED)
    return Trajectory(
        model,
        integrator_of(stored),
        **stored.frames(memory_limit),
        status=status,
        message=message,
        counts=counts_of(record["counts"]),
        cpu_seconds=float(record["cpu_seconds"]),
        wall_seconds=float(record["wall_seconds"]),
        machine=dict(about["machine"]),
        restart=stored.restart,
        plan=dict(about["plan"]),
    )


@contextmanager
def naming(path):
    """Turn whatever goes wrong with a file into one InputError that names it."""
    try:
        found = Path(path).is_file()
    except (TypeError, ValueError, OSError):
        found = False
    if not found:
        raise InputError(f"{path!r}: no such file" if not isinstance(path, (str, Path)) else f"{path}: no such file")
    path = Path(path)
    try:
        yield
    except InputError as error:
        raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    except Exception as error:  # a damaged file fails in the library, in json or here, in ways that nobody can list
        raise InputError(f"{path}: not a whole polyida trajectory ({type(error).__name__}: {error})") from None


def read(path):
    """The Stored of a file; raises whatever a damaged file makes fail."""
    file = opened(path)
    try:
        return _read(file, Path(path))
    except BaseException:
        file.close()
        raise


def _read(file, path):
    if str(file.attrs.get("format")) != FORMAT:
        raise InputError(f"not a polyida trajectory (format {file.attrs.get('format')!r}, {FORMAT!r} is needed)")
    reader = Reader(file, path)
    about, records = reader.text("about"), [reader.record(f"record {slot}") for slot in range(2)]
    records = [record for record in records if isinstance(record, dict)]
    if not records:
        raise InputError("it has no record of a flush; nothing in it holds")
    record = max(records, key=lambda record: int(record["commit"]))
    n = reader.dataset("q", (None, None)).shape[1]
    m = reader.dataset("lam", (None, None)).shape[1] if reader.has("lam") else 0
    count, widths = int(record["frames"]), {"t": (), "q": (n,), "v": (n,), "a": (n,)} | ({"lam": (m,)} if m else {})
    lengths = [len(reader.dataset(name, (None, *width))) for name, width in widths.items()]
    if not 0 <= count <= min(lengths):
        raise InputError(f"it holds {min(lengths)} frames, {count} are stated; the file is damaged")
    restart = _restart(reader, record, n, m)
    return Stored(path, file, about, reader.group("scene"), record, restart, count, n, m)


def _restart(reader, record, n, m):
    """Where the run goes on, or None where the file does not say."""
    if record["restart"] is None:
        return None
    numbers = reader.array(f"restart {int(record['commit']) % 2}", (None,)).astype(float)[: int(record["numbers"])]
    if zlib.crc32(numbers.tobytes()) != record["check"]:
        raise InputError("the state to go on from is damaged")
    shapes = [(), (n,), (n,), (n,), (m,), *(tuple(map(int, shape)) for _, shape in record["memory"])]
    sizes = [int(np.prod(shape)) for shape in shapes]
    if min(sizes) < 0 or sum(sizes) != len(numbers) or any(size > 4 * (n + m) + 64 for size in sizes):
        raise InputError("the state to go on from is damaged")
    parts = [part.reshape(shape) for part, shape in zip(np.split(numbers, np.cumsum(sizes)), shapes)]
    memory = {str(name): part for (name, _), part in zip(record["memory"], parts[5:])}
    state = State(float(parts[0]), *parts[1:5], memory)
    if not 0 <= int(record["restart"]["frames"]) <= record["frames"]:
        raise InputError("the state to go on from is damaged")
    return Restart(state, int(record["restart"]["frames"]), counts_of(record["restart"]["counts"]).as_dict())


def counts_of(stored):
    """Counts from plain data."""
    counts = Counts(**stored)
    for name, value in stored.items():
        if not isinstance(value, str if name == "backend" else int):
            raise InputError(f"the count {name} = {value!r} is damaged")
    return counts


def integrator_of(stored):
    """The integrator with its settings, or its name where it is none of polyida's."""
    import polyida

    kind, settings = stored.about["integrator"]["kind"], stored.about["integrator"]["settings"]
    return getattr(polyida, kind)(**settings) if kind in INTEGRATORS else str(kind)


def model_of(stored, drives):
    """The scene's model built from data, None for a model of a user's own; drives: {part: profile}."""
    from polyida.scene import Scene

    if "scene" not in stored.about:
        return None
    parts, gravity = from_data(stored.about["scene"], stored.arrays, drives.get)
    scene = Scene(gravity)
    for part in parts.values():
        scene.add(part)
    model = scene.build()
    if (model.n, model.m) != (stored.n, stored.m):
        raise InputError(
            f"frames have {stored.n} coordinates and {stored.m} multipliers, the scene has {model.n} and {model.m}; "
            "the file is damaged"
        )
    return model


def _drives(stored):
    """{part: profile through the values that the run saw}."""
    reader, times = Reader(stored.file, stored.path), np.asarray(stored.file["t"][: stored.count], float)
    return {
        name: _interpolated(times, reader.array(key, (None, 3))[: stored.count])
        for name, key in stored.about["drives"].items()
    }


def _interpolated(times, samples):
    from scipy.interpolate import CubicHermiteSpline

    from polyida.profile import Profile, constant

    times, chosen = np.unique(times, return_index=True)
    if len(times) < 2:
        return constant(float(samples[0, 0]))
    curve = CubicHermiteSpline(times, samples[chosen, 0], samples[chosen, 1])
    return Profile(curve, curve.derivative(1), curve.derivative(2))
