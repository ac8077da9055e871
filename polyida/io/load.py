"""`load`: a Trajectory from a file, with the scene and the integrator built again from the file's data."""

from dataclasses import is_dataclass
from pathlib import Path

import numpy as np

from polyida import registry
from polyida.errors import InputError
from polyida.event import Events
from polyida.io.layout import MEMORY_LIMIT
from polyida.io.reader import naming, read
from polyida.io.scene_data import UnknownPart, factors_from, from_data
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.reprs import settings_of
from polyida.sensor import Sensors
from polyida.trajectory import Trajectory
from polyida.validation import flag, named_keywords, require_bytes

STILL = "another process is still writing it; these are the frames up to its last flush"
KILLED = "the process that ran it ended without closing the file; it holds the frames up to the last flush"
TORN = "; the record of one flush is not whole: cut off by the end of the process, or damaged"


@named_keywords
def load(path: str | Path, memory_limit: float = MEMORY_LIMIT, check: bool = True, model: Model | None = None) -> Trajectory:
    """Read a trajectory from a file of `solve(..., out=path)` or `run.save(path)`.

    The file of a killed run has the frames up to the last flush, with status "interrupted"; one that is still written those up to now, with
    status "running". The scene is built again from the file's data. A motor or load whose profile was a user's function follows the values
    of the run, which are in the file; without a frame there is no model then.

    Parameters
    ----------
    path : path of the file
    memory_limit : float, bytes
        More frames than this stay in the file and are read when needed.
    check : bool
        Read all frames. If some are damaged, those before them are returned, with status "damaged" and the reason as message. False: damaged
        frames raise InputError when they are read.
    model : Model, optional
        The model of the run, as in `resume`: a user's own model is in no file, and without it a run has frames only. By default the scene in
        the file.

    Returns
    -------
    Trajectory
        The run in the file.

    Raises
    ------
    InputError
        If the file is missing, truncated or of another kind, and for a model of other sizes than those of the run.
    """
    require_bytes("load", memory_limit)
    flag("load", "check", check)
    stored = read(path)
    with naming(path):
        try:
            about, record = stored.about, stored.record
            damage = stored.check() if check else ""
            events = Events.from_data(record.get("events", []))
            model, missing = _model(stored) if model is None else (_given(stored, model, events), Trajectory.missing)
            integrator = integrator_of(stored)
            sensors = sensors_of(stored)
            status, message = str(record["status"]), str(record["message"])
            if status == "running":
                status, message = ("running", STILL) if stored.live else ("interrupted", KILLED + TORN * stored.torn)
            if damage:
                status, message = "damaged", damage
            return Trajectory(
                model,
                integrator,
                **stored.frames(memory_limit),
                status=status,
                message=message,
                counts=stored.counts,
                cpu_seconds=stored.seconds[0],
                wall_seconds=stored.seconds[1],
                compile_seconds=stored.seconds[2],
                machine=dict(about["machine"]),
                restart=stored.restart,
                plan=dict(about["plan"]),
                missing=missing,
                sensors=sensors,
                events=events,
                settings_used=settings_used(stored, integrator),
            )
        except BaseException:
            stored.file.close()
            raise


def settings_used(stored, integrator):
    """{setting: value} that the run used: fields of the integrator, replaced by what the file records; the latter alone if it is a name."""
    used = {name: tuple(value) if isinstance(value, list) else value for name, value in stored.record.get("settings_used", {}).items()}
    return used if isinstance(integrator, str) else settings_of(integrator) | used


def sensors_of(stored):
    """The Sensors of an open run file with all recorded values."""
    return Sensors(stored.sensors, np.asarray(stored.sensed)) if stored.sensors else Sensors()


def _model(stored):
    """(model of the stored scene, or None if it cannot be built; the reason why it is missing)."""
    if stored.about["drives"] and not stored.count:
        return None, "its profiles are functions of a user's own, of which the file holds no value yet"
    try:
        times = np.asarray(stored.columns["t"])
        drives = {key: _interpolated(times, np.asarray(stored.columns[key])) for key in stored.about["drives"]}
        return model_of(stored, drives), Trajectory.missing
    except UnknownPart as unknown:
        return None, f"the file's scene cannot be built: {unknown}"


def _given(stored, model, events):
    """Return the model that the user gives for a stored run; raise InputError unless its n and m are those of the frames.

    stored: the open file. events: the events of the run. A user's model may have fewer rows if events change models; it is then set in
    events.
    """
    known = guard(model, "load")
    if max((one.model for one in events), default=0):
        raise InputError("events of the run change to other models, which no file holds; load it without model=")
    changing = events.given and not known.is_scene  # models that its events name may have more rows
    if known.n != stored.n or not (known.m == stored.m or changing and known.m < stored.m):
        states = f" + k = {known.n - known.k} + {known.k}" if known.k and not known.is_scene else f" = {known.n}"
        raise InputError(
            f"frames have {stored.n} coordinates and {stored.m} multipliers; the model has n{states} and m = {known.m}: it is another model"
        )
    if changing:
        known.columns = slice(0, known.m)
        events.models = [known]
    return model


def integrator_of(stored):
    """The integrator with its settings, or its name if `registry.integrators` has no dataclass of that name."""
    kind, settings = stored.about["integrator"]["kind"], stored.about["integrator"]["settings"]
    known = registry.find(registry.integrators, kind)
    return known(**settings) if is_dataclass(known) else str(kind)


def model_of(stored, drives):
    """The model of the scene in the file, None for a user's model; drives: {key: profile}. Raises UnknownPart."""
    from polyida.assembly.scene_model import SceneModel
    from polyida.scene import Scene

    if "scene" not in stored.about:
        return None
    arrays = stored.arrays("scene")
    parts, gravity = from_data(stored.about["scene"], arrays, drives.get)
    scene = Scene(gravity)
    late, redundant = stored.about.get("late"), stored.about.get("redundant", "refuse")
    for part in parts.values():
        scene.add(part)
    model = scene.build(redundant) if late is None else SceneModel(scene.parts, scene.gravity, redundant, False, tuple(late))
    factors = factors_from(stored.about["scene"], arrays)
    model = model.with_factors(**factors) if factors else model
    if (model.n, model.m) != (stored.n, stored.m):
        raise InputError(
            f"frames have {stored.n} coordinates and {stored.m} multipliers, the scene has {model.n} and {model.m}; the file is damaged"
        )
    return model


def _interpolated(times, samples):
    """The profile that interpolates the stored values and first derivatives (frames, 3) of a run by cubics."""
    from scipy.interpolate import CubicHermiteSpline

    from polyida.profile import Profile, constant

    times, chosen = np.unique(times, return_index=True)
    if len(times) < 2:
        return constant(float(samples[0, 0]))
    curve = CubicHermiteSpline(times, samples[chosen, 0], samples[chosen, 1])
    return Profile(curve, curve.derivative(1), curve.derivative(2))
