"""Trajectories in HDF5 files: frames, how the run went, and the scene as data. Nothing in a file is ever executed."""

import json
import os
from dataclasses import asdict, is_dataclass
from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.integrate.state import Counts
from polyida.model import Model
from polyida.scene_data import from_data, to_data
from polyida.trajectory import Trajectory

FORMAT = "polyida trajectory 1"
FRAMES = ("t", "q", "v", "a", "lam")


def save(run, path, overwrite=False):
    """Write a trajectory; the file appears whole or not at all. Raises InputError where it exists and overwrite is False."""
    import h5py

    path = Path(path)
    require_free(path, overwrite)
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist")
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with h5py.File(partial, "w") as file:
            write_header(file, run.model, run.integrator)
            for name in FRAMES:
                file[name] = getattr(run, name)
            write_ending(file, run)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def require_free(path, overwrite):
    """Raise InputError where a file is in the way and must not be overwritten."""
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists; pass overwrite=True (--overwrite) to replace it, or give another name")


def write_header(file, model, integrator):
    """What is known before the run: format, integrator, names of phi's rows, the scene."""
    settings = asdict(integrator) if is_dataclass(integrator) else {}
    file.attrs["format"] = FORMAT
    file.attrs["integrator"] = json.dumps({"kind": type(integrator).__name__, "settings": settings}, default=_listed)
    file.attrs["model"] = type(model).__name__
    if hasattr(model, "parts"):
        description, arrays = to_data(model.parts, model.gravity)
        file.attrs["scene"] = json.dumps(description)
        for key, array in arrays.items():
            file[f"scene/{key}"] = array


def write_ending(file, run):
    """What is known after the run."""
    file.attrs["status"], file.attrs["message"] = run.status, run.message
    file.attrs["counts"] = json.dumps(run.counts.as_dict())
    file.attrs["cpu_seconds"], file.attrs["wall_seconds"] = run.cpu_seconds, run.wall_seconds
    file.attrs["machine"] = json.dumps(run.machine)
    for name, value in run.memory.items():
        file[f"memory/{name}"] = value
    motors = [name for name, part in getattr(run.model, "parts", {}).items() if _sampled(part)]
    for name in motors:
        part = run.model.parts[name]
        profile = getattr(part, "angle", None) or part.profile
        file[f"drives/{name}"] = np.array([profile.at(t) for t in run.t], float)


def _sampled(part):
    profile = getattr(part, "angle", None) or getattr(part, "profile", None)
    return profile is not None and not profile.formula


def _listed(value):
    return value.tolist() if hasattr(value, "tolist") else str(value)


def load(path):
    """Read a trajectory. Raises InputError naming the file where it is missing, truncated or of another kind.

    The scene is built again from the file's data. A motor or load whose profile was a function of the user's own follows the values
    that the run saw, which are in the file.
    """
    import h5py

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with h5py.File(path, "r") as file:
            return _read(file)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError) as error:
        raise InputError(f"{path}: not a whole polyida trajectory ({type(error).__name__}: {error})") from None


def _read(file):
    if file.attrs.get("format") != FORMAT:
        raise InputError(f"not a polyida trajectory (format {file.attrs.get('format')!r}, {FORMAT!r} is needed)")
    frames = {name: file[name][()] for name in FRAMES}
    count = len(frames["t"])
    if any(len(frames[name]) != count for name in FRAMES):
        raise InputError("frames of different lengths; the file is damaged")
    model = _model(file, frames["t"])
    if isinstance(model, Model) and frames["q"].shape[1:] != (model.n,):
        raise InputError(f"q has {frames['q'].shape[1:]} values a frame, the scene has {model.n}; the file is damaged")
    memory = {name: value[()] for name, value in file.get("memory", {}).items()}
    return Trajectory(
        model, _integrator(json.loads(file.attrs["integrator"])), **frames, status=str(file.attrs["status"]),
        message=str(file.attrs["message"]), counts=Counts(**json.loads(file.attrs["counts"])),
        cpu_seconds=float(file.attrs["cpu_seconds"]), wall_seconds=float(file.attrs["wall_seconds"]),
        machine=json.loads(file.attrs["machine"]), memory=memory,
    )


def _integrator(stored):
    import polyida

    if stored["kind"] not in ("GeneralizedAlpha", "IDA", "EnergyMomentum"):
        return stored["kind"]
    return getattr(polyida, stored["kind"])(**stored["settings"])


def _model(file, times):
    from polyida.scene import Scene

    if "scene" not in file.attrs:
        return None
    arrays = {}
    file["scene"].visititems(lambda key, node: arrays.update({key: node[()]}) if hasattr(node, "dtype") else None)
    drives = file.get("drives", {})
    parts, gravity = from_data(json.loads(file.attrs["scene"]), arrays,
                               lambda name: _interpolated(times, drives[name][()]) if name in drives else None)
    scene = Scene(gravity)
    for part in parts.values():
        scene.add(part)
    return scene.build()


def _interpolated(times, samples):
    from scipy.interpolate import CubicHermiteSpline

    from polyida.profile import Profile, constant

    if len(times) < 2:
        return constant(float(samples[0, 0]))
    curve = CubicHermiteSpline(times, samples[:, 0], samples[:, 1])
    return Profile(curve, curve.derivative(1), curve.derivative(2))
