"""`load`: a Trajectory from a file; the scene and the integrator that made it are built again from the file's data."""

from dataclasses import is_dataclass
from pathlib import Path

import numpy as np

from polyida import registry
from polyida.errors import InputError
from polyida.io.layout import MEMORY_LIMIT, require_bytes
from polyida.io.reader import naming, read
from polyida.io.scene_data import UnknownPart, factors_from, from_data
from polyida.sensor import Sensors
from polyida.trajectory import Trajectory
from polyida.validation import is_flag, named_keywords

STILL = "another process is still writing it; these are the frames up to its last flush"
KILLED = "the process that ran it ended without closing the file; it holds the frames up to the last flush"
TORN = "; the record of one flush is not whole: cut off by the end of the process, or damaged"


@named_keywords
def load(path: str | Path, memory_limit: float = MEMORY_LIMIT, check: bool = True) -> Trajectory:
    """Read a trajectory. Raises InputError naming the file where it is missing, truncated or of another kind.

    Frames beyond `memory_limit` bytes stay in the file and are read when asked for. A file of a run that was killed
    holds the frames up to the last flush, with status "interrupted"; one that is still written, those up to now, with
    status "running". All frames are looked at: where some are damaged, those before them come back, with status
    "damaged" and a message that says which and why. check=False looks at none of them, for files that take long to read: what
    is damaged raises InputError when it is asked for. The scene is built again from the file's data. A motor or load
    whose profile was a function of the user's own follows the values that the run saw, which are in the file; without a
    frame there is no model then.
    """
    require_bytes("load", memory_limit)
    if not is_flag(check):
        raise InputError(f"load: check = {check!r} must be True or False")
    stored = read(path)
    with naming(path):
        try:
            about, record = stored.about, stored.record
            damage = stored.check() if check else ""
            model, missing = _model(stored)
            status, message, sensors = str(record["status"]), str(record["message"]), sensors_of(stored)
            if status == "running":
                status, message = ("running", STILL) if stored.live else ("interrupted", KILLED + TORN * stored.torn)
            if damage:
                status, message = "damaged", damage
            return Trajectory(
                model,
                integrator_of(stored),
                **stored.frames(memory_limit),
                status=status,
                message=message,
                counts=stored.counts,
                cpu_seconds=stored.seconds[0],
                wall_seconds=stored.seconds[1],
                machine=dict(about["machine"]),
                restart=stored.restart,
                plan=dict(about["plan"]),
                missing=missing,
                sensors=sensors,
            )
        except BaseException:
            stored.file.close()
            raise


def sensors_of(stored):
    """The Sensors in a file."""
    return Sensors(stored.sensors, np.asarray(stored.sensed)) if stored.sensors else Sensors()


def _model(stored):
    """(model or None, why there is none)."""
    if stored.about["drives"] and not stored.count:
        return None, "its profiles are functions of a user's own, of which the file holds no value yet"
    try:
        times = np.asarray(stored.columns["t"])
        drives = {key: _interpolated(times, np.asarray(stored.columns[key])) for key in stored.about["drives"]}
        return model_of(stored, drives), Trajectory.missing
    except UnknownPart as unknown:
        return None, f"the file's scene cannot be built: {unknown}"


def integrator_of(stored):
    """The integrator with its settings, or its name where `registry.integrators` has no dataclass of that name."""
    kind, settings = stored.about["integrator"]["kind"], stored.about["integrator"]["settings"]
    known = registry.find(registry.integrators, kind)
    return known(**settings) if is_dataclass(known) else str(kind)


def model_of(stored, drives):
    """The scene's model built from data, None for a model of a user's own; drives: {key: profile}. Raises UnknownPart."""
    from polyida.scene import Scene

    if "scene" not in stored.about:
        return None
    arrays = stored.arrays("scene")
    parts, gravity = from_data(stored.about["scene"], arrays, drives.get)
    scene = Scene(gravity)
    for part in parts.values():
        scene.add(part)
    model, factors = scene.build(stored.about.get("redundant", "refuse")), factors_from(stored.about["scene"], arrays)
    model = model.with_factors(**factors) if factors else model
    if (model.n, model.m) != (stored.n, stored.m):
        raise InputError(
            f"frames have {stored.n} coordinates and {stored.m} multipliers, the scene has {model.n} and {model.m}; the file is damaged"
        )
    return model


def _interpolated(times, samples):
    """The profile through the values (frames, 3) that a run saw."""
    from scipy.interpolate import CubicHermiteSpline

    from polyida.profile import Profile, constant

    times, chosen = np.unique(times, return_index=True)
    if len(times) < 2:
        return constant(float(samples[0, 0]))
    curve = CubicHermiteSpline(times, samples[chosen, 0], samples[chosen, 1])
    return Profile(curve, curve.derivative(1), curve.derivative(2))
