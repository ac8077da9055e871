"""Values derived from the frames of a run: angles and reactions of joints, momentum, strain, stress, energy balance; tables of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.element import kernels
from polyida.errors import InputError
from polyida.io.frames import blocks, each
from polyida.joint.joint import Joint
from polyida.validation import LARGEST, floats, library, named_keywords


class Motion(NamedTuple):
    """A guarded model, t (frames,), and frames of q, v, a, lam, arrays or StoredFrames."""

    model: Any
    t: NDArray
    q: NDArray
    v: NDArray
    a: NDArray
    lam: NDArray


def angle_of(motion, joint):
    """The rotation of a joint's side b relative to side a, (frames,), rad, unwrapped over the frames."""
    model = motion.model
    joints = {name: model.parts[name] for name in model.joints if isinstance(model.parts[name], Joint)}
    name = next((name for name, part in joints.items() if part is joint), joint)
    if not isinstance(name, str) or name not in joints:
        raise InputError(f"angle: no joint is called {joint!r:.100}; known: {', '.join(map(repr, joints))}")
    return np.unwrap(np.concatenate([model.turn(name, q) for q in blocks(motion.q)]))


def names_of_joints(model):
    """The names, for a message: of the joints of a scene, not of its bodies that have rows; of all rows of a user's model."""
    names = [name for name in model.rows if not model.is_scene or isinstance(model.joints[name], Joint)]
    return ", ".join(map(repr, names)) or "none"


def reaction_of(model, name, t, q, lam, whole=False):
    """Reaction of a joint, (frames, k), over t (frames,), q (frames, n), lam (frames, m); of a user's model by its `reactions`.

    whole: (fx, fy, m) of a scene's joint. Of redundant constraints it is that with the least sum of squares of all multipliers.
    """
    if name in model.absent:
        return np.zeros((len(t), len(model.reaction_of(name, whole).components)))
    if model.redundant:
        lam = model.redundant.multipliers(t, q, lam)
    rows = (model.redundant or model).rows[name]
    return model.reactions(name, q, lam[:, rows], *((t, whole) if model.is_scene else ()))


def momenta_of(motion):
    """(frames, 3): momentum along x and y, N s, and angular momentum about the origin, N m s. Raises InputError if the model has none."""
    entries = [motion.model.momenta(q, v) for q, v in zip(each(motion.q), each(motion.v))]
    if any(values is None for values in entries):
        raise InputError(f"momentum: {motion.model.name} does not say it; let its class write momenta(q, v), giving (px, py, L)")
    return np.array(entries, float).reshape(-1, 3)


def strains(model, q):
    """Green's strain of every element of a scene at q, (cells, 3): Exx, Eyy, 2 Exy, means over its reference area, plate after plate."""
    u, parts = model.nodal(q), [np.zeros((0, 3))]
    for body in model.drawn:
        operator = body.operator
        parts.append(np.empty((operator.n_cells, 3)))
        weighed = operator.areas * body.factors[0]
        kernels.green_strain(operator.cells(body.nodes.start), operator.lane_cells, weighed, u, parts[-1])
    return np.concatenate(parts)


@named_keywords
def von_mises(stress: ArrayLike, zz: ArrayLike = 0.0) -> NDArray:
    """Compute the von Mises stress, `sqrt(((xx - yy)^2 + (yy - zz)^2 + (zz - xx)^2) / 2 + 3 xy^2)`.

    Parameters
    ----------
    stress : (..., 3) float
        Cauchy stress xx, yy, xy.
    zz : (...) float
        0 in plane stress; `run.von_mises(frame)` includes it in plane strain.

    Returns
    -------
    (...) float
        In the unit of the stress.
    """
    stresses, out = floats(stress), floats(zz)
    if stresses is None or not stresses.ndim or stresses.shape[-1] != 3:
        raise InputError(f"von_mises: stress = {stress!r} must be finite numbers (..., 3): xx, yy, xy")
    if np.abs(stresses).max(initial=0.0) > LARGEST:
        raise InputError(f"von_mises: stress = {stress!r:.100} must be numbers up to {LARGEST:g}")
    if out is None or out.shape not in ((), stresses.shape[:-1]) or np.abs(out).max(initial=0.0) > LARGEST:
        raise InputError(f"von_mises: zz = {zz!r} must be a finite number, or one for each of the stresses {stresses.shape[:-1]}")
    xx, yy, xy = np.moveaxis(stresses, -1, 0)
    return np.sqrt(((xx - yy) ** 2 + (yy - out) ** 2 + (out - xx) ** 2) / 2 + 3 * xy * xy)


def motor_work(run):
    """Work of all angle motors up to every frame, (frames,), J."""
    from polyida.joint.joints import AngleMotor

    motors = [name for name, joint in run.model.joints.items() if isinstance(joint, AngleMotor)]
    return sum((run.energy.work[name] for name in motors), np.zeros(len(run.t)))


def unbalanced(run):
    """Change of the total energy since the start less the work of all parts, more their dissipation, (frames,), J.

    Zero for the exact motion; NaN if a model has no potential.
    """
    energy = run.energy
    return energy.total - energy.total[0] - sum(energy.work.values()) + sum(energy.dissipated.values())


WORDS = {"N": "force", "N m": "torque"}
ENERGIES = ("kinetic", "potential", "strain", "total")
UNITS = {"q": "m", "v": "m/s", "a": "m/s2"}  # of a scene's


def dataframe(run):
    """The pandas.DataFrame of `Trajectory.to_dataframe`: a row for each frame."""
    from pandas import DataFrame

    return DataFrame({"t": run.t} | _columns(run))


def _columns(run):
    """{name of a column: (frames,)} of a run: q, v, lam of a model; places, states, reactions, energies and drift of a scene."""
    if run.model is None or not run.model.is_scene:
        hidden = [] if run.model is None else run.known_model("to_dataframe").hidden
        parts = {part: np.delete(np.asarray(getattr(run, part)), hidden, axis=1) for part in "qv"} | {"lam": np.asarray(run.lam)}
        return {f"{part}[{k}]": values for part, numbers in parts.items() for k, values in enumerate(numbers.T)} | states_of(run)
    places = {f"{name}.{axis}": values for name in run.model.named for axis, values in zip("xy", run.position(name).T)}
    energies = {f"energy.{part}": getattr(run.energy, part) for part in ENERGIES}
    return places | states_of(run) | reactions(run) | energies | {"drift": run.drift}


def states_of(run):
    """{"element.state": (frames,)} of the force elements of a scene with algebraic states and outputs, or {"x[0]": ...} of a user's model."""
    if run.model is None:
        return {}
    if not run.model.is_scene:
        return {f"x[{k}]": values for k, values in enumerate(run.states().T)} if run.known_model("states").own_states else {}
    elements = [own for own in run.model.own_forces if own.names]
    return {f"{own.name}.{one}": values for own in elements for one, values in zip(own.names, run.states(own.name).T)}


def reactions(run):
    """{"joint.force_x", "joint.torque", ...: (frames,)} of all joints of a scene."""
    return {
        f"{name}.{quantity(run.model, name, k)[0].replace(' ', '_')}": values
        for name in run.model.joints
        for k, values in enumerate(run.reaction(name).T)
    }


def quantity(model, name, k):
    """("force x", "N") of component k of a reaction; if a joint has several of a name, as a clamp at each node, "force x 1" is the first."""
    labels = components(model, name)
    of_name = [i for i, one in enumerate(labels) if one == labels[k]]
    return (f"{labels[k][0]} {of_name.index(k) + 1}", labels[k][1]) if len(of_name) > 1 else labels[k]


def components(model, name):
    """("force x", "N") of each component of a reaction; multipliers of the rows of a body, and of a user's model."""
    reaction = model.reaction_of(name) if model.is_scene else None
    if reaction is None:
        rows = model.rows[name]
        return [_of_row(model, row, k) for k, row in enumerate(range(rows.start, rows.stop))]
    return [(f"{WORDS[unit]} {axis}".rstrip(), unit) for axis, unit in reaction.components]


def _of_row(model, row, k):
    """Name and unit of the multiplier of a row, the k-th of its part."""
    unit, label = (model.units[row], model.labels[row]) if model.units else ("", "")
    axis = label.rsplit(" ", 1)[-1] if label.endswith((" x", " y")) else ""
    return (f"{WORDS[unit]} {axis}".rstrip(), unit) if unit in WORDS else (f"multiplier {k}", "")


def dataset(run):
    """The xarray.Dataset of `Trajectory.to_xarray`, over the times of the frames."""
    scene = run.model is not None and run.model.is_scene
    entries = {part: (("t", "coordinate"), np.asarray(getattr(run, part)), {"units": UNITS[part]} if scene else {}) for part in UNITS}
    entries["lam"] = (("t", "constraint"), np.asarray(run.lam))
    marks = {"t": ("t", run.t, {"units": "s"})}
    if run.model is not None and len(run.model.labels) == run.lam.shape[1]:
        marks["constraint"] = list(run.model.labels)
    if scene:
        entries |= _of_scene(run)
        units = [quantity(run.model, name, k)[1] for name in run.model.joints for k in range(run.reaction(name).shape[1])]
        marks |= {"point": list(run.model.named), "axis": ["x", "y"], "component": list(reactions(run)), "unit": ("component", units)}
    if states := states_of(run):
        entries["x"], marks["state"] = (("t", "state"), np.stack([*states.values()], axis=1)), [*states]
    plain = {name: value for name, value in run.counts.as_dict().items() if isinstance(value, (int, str))}
    about = {"status": run.status, "message": run.message, "integrator": repr(run.integrator), "cpu_seconds": run.cpu_seconds}
    return xarray().Dataset(entries | _sensed(run), marks, about | plain)


def xarray():
    """The package xarray. Raises InputError if it is not installed."""
    return library("xarray", "to_xarray: xarray is not installed; pip install 'polyida[xarray]'")


def _of_scene(run):
    """{name: variable} for xarray: places of named points, reactions, energies and drift over the frames of a scene."""
    names, pushed = list(run.model.named), list(reactions(run).values())
    places = np.stack([run.position(name) for name in names], axis=1) if names else np.zeros((len(run), 0, 2))
    entries = {"position": (("t", "point", "axis"), places, {"units": "m"})}
    entries["reaction"] = (("t", "component"), np.stack(pushed, axis=1) if pushed else np.zeros((len(run), 0)))
    entries |= {part: ("t", getattr(run.energy, part), {"units": "J"}) for part in ENERGIES}
    return entries | {"drift": ("t", run.drift)}


def _sensed(run):
    """{name: variable} for xarray: values of the sensors over the times of all steps."""
    if not run.sensors:
        return {}
    entries = {
        f"sensor.{name}": (("step", *(f"{name}_{k}" for k in range(values.ndim - 1))), values) for name, values in run.sensors.items()
    }
    return entries | {"t_step": ("step", run.sensors.t, {"units": "s"})}
