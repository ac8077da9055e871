"""A run as a table of numbers: a data frame of what is looked at, a data set of everything."""

import numpy as np

from polyida.errors import InputError

WORDS = {"N": "force", "N m": "torque"}
ENERGIES = ("kinetic", "potential", "strain", "total")
UNITS = {"q": "m", "v": "m/s", "a": "m/s2"}  # of a scene's


def dataframe(run):
    """The pandas.DataFrame of `Trajectory.to_dataframe`."""
    from pandas import DataFrame

    return DataFrame({"t": run.t} | _columns(run))


def _columns(run):
    """{name: (frames,)}."""
    if run.model is None or not run.model.is_scene:
        return {f"{part}[{k}]": values for part in ("q", "v", "lam") for k, values in enumerate(np.asarray(getattr(run, part)).T)}
    places = {f"{name}.{axis}": values for name in run.model.named for axis, values in zip("xy", run.position(name).T)}
    energies = {f"energy.{part}": getattr(run.energy, part) for part in ENERGIES}
    return places | reactions(run) | energies | {"drift": run.drift}


def reactions(run):
    """{"joint.force_x", "joint.torque", ...: (frames,)} of all joints of a scene."""
    return {
        f"{name}.{quantity(run.model, name, k)[0].replace(' ', '_')}": values
        for name in run.model.joints
        for k, values in enumerate(run.reaction(name).T)
    }


def quantity(model, name, k):
    """("force x", "N") of component k of a reaction; where a joint has several of a name, as a clamp at each node, "force x 1" is the first."""
    said = components(model, name)
    of_name = [i for i, one in enumerate(said) if one == said[k]]
    return (f"{said[k][0]} {of_name.index(k) + 1}", said[k][1]) if len(of_name) > 1 else said[k]


def components(model, name):
    """("force x", "N") of each component of a reaction; of the rows of a body, and of a model of one's own, multipliers."""
    reaction = model.reaction_of(name) if model.is_scene else None
    if reaction is None:
        rows = model.rows[name]
        return [_of_row(model, row, k) for k, row in enumerate(range(rows.start, rows.stop))]
    return [(f"{WORDS[unit]} {axis}".rstrip(), unit) for axis, unit in reaction.components]


def _of_row(model, row, k):
    """What a row says of its multiplier, the k-th of its part."""
    unit, label = (model.units[row], model.labels[row]) if model.units else ("", "")
    axis = label.rsplit(" ", 1)[-1] if label.endswith((" x", " y")) else ""
    return (f"{WORDS[unit]} {axis}".rstrip(), unit) if unit in WORDS else (f"multiplier {k}", "")


def dataset(run):
    """The xarray.Dataset of `Trajectory.to_xarray`."""
    try:
        from xarray import Dataset
    except ImportError:
        raise InputError("to_xarray: xarray is not installed; pip install 'polyida[xarray]'") from None
    scene = run.model is not None and run.model.is_scene
    found = {part: (("t", "coordinate"), np.asarray(getattr(run, part)), {"units": UNITS[part]} if scene else {}) for part in UNITS}
    found["lam"] = (("t", "constraint"), np.asarray(run.lam))
    marks = {"t": ("t", run.t, {"units": "s"})}
    if run.model is not None and len(run.model.labels) == run.lam.shape[1]:
        marks["constraint"] = list(run.model.labels)
    if scene:
        found |= _of_scene(run)
        units = [quantity(run.model, name, k)[1] for name in run.model.joints for k in range(run.reaction(name).shape[1])]
        marks |= {"point": list(run.model.named), "axis": ["x", "y"], "component": list(reactions(run)), "unit": ("component", units)}
    plain = {name: value for name, value in run.counts.as_dict().items() if isinstance(value, (int, str))}
    about = {"status": run.status, "message": run.message, "integrator": repr(run.integrator), "cpu_seconds": run.cpu_seconds}
    return Dataset(found | _sensed(run), marks, about | plain)


def _of_scene(run):
    """Places of named points, reactions, energies, drift."""
    names, pushed = list(run.model.named), list(reactions(run).values())
    places = np.stack([run.position(name) for name in names], axis=1) if names else np.zeros((len(run), 0, 2))
    found = {"position": (("t", "point", "axis"), places, {"units": "m"})}
    found["reaction"] = (("t", "component"), np.stack(pushed, axis=1) if pushed else np.zeros((len(run), 0)))
    found |= {part: ("t", getattr(run.energy, part), {"units": "J"}) for part in ENERGIES}
    return found | {"drift": ("t", run.drift)}


def _sensed(run):
    """What sensors gave, over the time of every step."""
    if not run.sensors:
        return {}
    found = {f"sensor.{name}": (("step", *(f"{name}_{k}" for k in range(values.ndim - 1))), values) for name, values in run.sensors.items()}
    return found | {"t_step": ("step", run.sensors.t, {"units": "s"})}
