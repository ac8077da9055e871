"""A scene as plain data and back, so that a result file holds the scene that made it: numbers and names, never code."""

from dataclasses import astuple

import numpy as np

from polyida import profile
from polyida.body.loads import EdgeTraction, PointLoad
from polyida.body.material import Material
from polyida.body.plate import Plate
from polyida.body.point_mass import PointMass
from polyida.errors import InputError
from polyida.joint.angle_motor import AngleMotor
from polyida.joint.attachment import Attachment, ground
from polyida.joint.clamp import Clamp
from polyida.joint.revolute import Revolute
from polyida.mesh import PolygonMesh

KINDS = {kind.__name__: kind for kind in (Plate, Revolute, Clamp, AngleMotor, PointMass, PointLoad, EdgeTraction)}


def to_data(parts, gravity):
    """(description, arrays) of {name: part}: a JSON-ready dictionary, and the arrays it refers to by key."""
    arrays, meshes, entries = {}, {}, []
    for number, (name, part) in enumerate(parts.items()):
        entry = {"kind": type(part).__name__, "name": name}
        if isinstance(part, Plate):
            entry |= _plate(part, meshes, arrays)
        else:
            for key in ("a", "b", "at"):
                if hasattr(part, key):
                    entry[key] = _attachment(getattr(part, key), parts, f"part {number} {key}", arrays)
            entry |= {key: _plain(getattr(part, key)) for key in ("mass", "force", "traction") if hasattr(part, key)}
            entry |= {key: list(getattr(part, key).formula) for key in ("angle", "profile") if hasattr(part, key)}
        entries.append(entry)
    return {"gravity": _plain(gravity), "parts": entries}, arrays


def _plate(plate, meshes, arrays):
    mesh = plate.mesh
    if id(mesh) not in meshes:
        key = meshes[id(mesh)] = f"mesh {len(meshes)}"
        arrays |= {f"{key}/points": mesh.points, f"{key}/nodes": mesh.nodes, f"{key}/offsets": mesh.offsets}
        arrays |= {f"{key}/section {number}": nodes for number, nodes in enumerate(mesh.sections.values())}
    material = plate.material
    return {"mesh": meshes[id(mesh)], "sections": list(mesh.sections), "material": [*astuple(material)], "tau": plate.tau,
            "thickness": plate.thickness, "origin": _plain(plate.origin), "angle": plate.angle, "element": plate.element}


def _attachment(side, parts, key, arrays):
    if side is ground:
        return None
    body = next(name for name, part in parts.items() if part is side.body)
    arrays |= {f"{key}/nodes": side.nodes, f"{key}/weights": side.weights}
    if side.turn_weights is not None:
        arrays[f"{key}/turn_weights"] = side.turn_weights
    return {"body": body, "name": side.name, "length": float(side.length), "key": key}


def _plain(value):
    return np.asarray(value, float).tolist()


def from_data(description, arrays, drives=None):
    """{name: part} and gravity from data. `drives(part name)` gives a profile for one that has no formula.

    Raises InputError where the data do not describe a scene.
    """
    parts, meshes = {}, {}
    try:
        for entry in description["parts"]:
            parts[entry["name"]] = _part(entry, parts, meshes, arrays, drives or (lambda name: None))
        return parts, tuple(map(float, description["gravity"]))
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"the scene in the file is damaged: {type(error).__name__} {error}") from None


def _part(entry, parts, meshes, arrays, drives):
    kind, name = KINDS[entry["kind"]], entry["name"]
    if kind is Plate:
        return Plate(_mesh(entry["mesh"], entry["sections"], meshes, arrays), Material(*entry["material"]), entry["thickness"],
                     tuple(entry["origin"]), entry["angle"], name, entry["element"], entry["tau"])
    given = {key: _side(entry[key], parts, arrays) for key in ("a", "b", "at") if key in entry}
    given |= {key: entry[key] for key in ("mass", "force", "traction") if key in entry}
    for key in ("angle", "profile"):
        if key in entry:
            given[key] = profile.from_formula(tuple(entry[key])) or drives(name) or profile.constant(0.0)
    return kind(**given, name=name)


def _mesh(key, names, meshes, arrays):
    if key not in meshes:
        sections = {name: arrays[f"{key}/section {number}"] for number, name in enumerate(names)}
        meshes[key] = PolygonMesh(arrays[f"{key}/points"], arrays[f"{key}/nodes"], arrays[f"{key}/offsets"], sections)
    return meshes[key]


def _side(side, parts, arrays):
    if side is None:
        return ground
    key = side["key"]
    nodes, body = arrays[f"{key}/nodes"], parts[side["body"]]
    weights, turn = np.asarray(arrays[f"{key}/weights"], float), arrays.get(f"{key}/turn_weights")
    turn = None if turn is None else np.asarray(turn, float)
    if nodes.size == 0 or nodes.dtype.kind != "i" or nodes.min() < 0 or nodes.max() >= body.mesh.n_nodes:
        raise InputError(f"the scene in the file is damaged: {key} selects nodes that plate {side['body']!r} does not have")
    if not nodes.shape == weights.shape == (weights if turn is None else turn).shape == (nodes.size,):
        raise InputError(f"the scene in the file is damaged: {key} has not one weight a node")
    if not 0 <= float(side["length"]) < np.inf:
        raise InputError(f"the scene in the file is damaged: {key} has the length {side['length']}")
    return Attachment(body, nodes.astype(np.int32), weights, turn, float(side["length"]), str(side["name"]))
