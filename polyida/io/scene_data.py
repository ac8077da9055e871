"""A scene as plain data and back, for the file of a run: numbers and names, never code.

A part has a kind and fields. A field is plain, or one of: {"side": an attachment}, {"ground": [point, direction] or null},
{"complex": [real, imaginary]}, {"array": key}, {"named": {name: a field}}, {"part": a part of its own, such as the plate of a reduced
body}, {"each": list of profiles and numbers}, {"profile": formula}, {"drive": key} for a profile without a formula, {"mesh": key},
{"material": numbers}, {"unknown": type}.
"""

from collections.abc import Mapping
from dataclasses import astuple, fields

import numpy as np

from polyida import profile, registry
from polyida.assembly.factors import WHAT, given_factors
from polyida.body.body import BodyEdges, BodyPoint, coordinates_of
from polyida.body.plate import Material, Plate
from polyida.errors import InputError
from polyida.joint.attachment import Attachment, Ground
from polyida.mesh import PolygonMesh
from polyida.validation import is_number, is_whole


class UnknownPart(Exception):
    """The class of a part in a file is unknown, or a field of it cannot be stored."""


def to_data(model):
    """(description, arrays, drives) of a scene's parts and gravity.

    A dictionary for JSON, its arrays by key, and {key: (part, profile)} of the profiles without a formula.
    """
    parts = model.parts
    encoder = _Encoder(parts, {placed.name: placed.user.fields_to_store(placed.body) for placed in model.reduced_bodies})
    entries = [
        {"kind": registry.name_of(type(part)), "name": name, "fields": encoder.fields(name, f"part {number}", part)}
        for number, (name, part) in enumerate(parts.items())
    ]
    whole = {"gravity": encoder.value("gravity", "gravity", model.gravity), "parts": entries}
    whole |= {
        "factors": {
            name: [encoder.value(name, f"{name} {what}", x) for what, x in zip(WHAT, pair)] for name, pair in given_factors(model).items()
        }
    }
    return whole, encoder.arrays, encoder.drives


class _Encoder:
    """Converts fields of parts to data; collects arrays and drives."""

    def __init__(self, parts, stored_fields):
        """Take the parts of a scene and what some of its bodies store in place of their fields."""
        self.parts = parts  # {name: part}
        self.stored_fields = stored_fields  # {name: {field: value}} of bodies that store other fields than their own
        self.arrays = {}  # {key: array}
        self.drives = {}  # {key: (part, profile)}
        self.meshes = {}  # {id of a mesh: key}

    def fields(self, name, key, part):
        """{field: data} of a part without its name; key: the prefix of its arrays."""
        values = {field.name: getattr(part, field.name) for field in fields(part) if field.init and field.name != "name"}
        values |= self.stored_fields.get(name, {}) if part is self.parts.get(name) else {}
        return {field: self.value(name, f"{key} {field}", value) for field, value in values.items()}

    def value(self, name, key, value):
        """The data of a value of the part of that name."""
        if isinstance(value, Attachment):
            return {"side": self._side(key, value)}
        if isinstance(value, Ground):
            return {"ground": None if value.point is None else [_plain(value.point), _plain(value.direction)]}
        if isinstance(value, profile.Profile):
            return {"profile": list(value.formula)} if value.formula else {"drive": self._drive(name, value)}
        if isinstance(value, tuple) and any(isinstance(item, profile.Profile) for item in value):
            return {"each": [self.value(name, key, item) for item in value]}
        if isinstance(value, PolygonMesh):
            return {"mesh": self._mesh(value), "sections": list(value.sections), "order": value.order}
        if isinstance(value, Material):
            return {"material": [*astuple(value)]}
        if isinstance(value, Plate):
            fields = self.fields(name, key, value)
            return {"part": {"kind": registry.name_of(type(value)), "name": value.name, "fields": fields}}
        if isinstance(value, Mapping):
            return {"named": {str(known): self.value(name, f"{key} {known}", one) for known, one in value.items()}}
        if isinstance(value, np.ndarray) and value.dtype.kind in "iufb":
            self.arrays[key] = value
            return {"array": key}
        if value is None or isinstance(value, (str, bool)):
            return value
        if is_number(value):
            return int(value) if is_whole(value, -(2**62)) else float(value)
        if _numbers(value, "c"):
            return {"complex": [_plain(np.real(value)), _plain(np.imag(value))]}
        return _plain(value) if _numbers(value, "iuf") else {"unknown": type(value).__name__}

    def _side(self, key, side):
        """The data of an attachment: its body by name; its nodes and weights are arrays under `key`."""
        body = next(name for name, part in self.parts.items() if part is side.body)
        self.arrays |= {f"{key}/nodes": side.nodes, f"{key}/weights": _real(side.weights)}
        if side.turn_weights is not None:
            self.arrays[f"{key}/turn_weights"] = _real(side.turn_weights)
        corners = {"corners": list(side.corners)} if isinstance(side, BodyEdges) else {}
        return {"body": body, "name": side.name, "length": float(side.length), "key": key} | corners

    def _drive(self, name, value):
        """Store a profile without a formula, of the part of that name, among the drives; return its key."""
        key = f"drive {len(self.drives)}"
        self.drives[key] = name, value
        return key

    def _mesh(self, mesh):
        """The key of a mesh, whose arrays are stored when it is first met."""
        if id(mesh) not in self.meshes:
            key = self.meshes[id(mesh)] = f"mesh {len(self.meshes)}"
            self.arrays |= {f"{key}/points": mesh.points, f"{key}/nodes": mesh.nodes, f"{key}/offsets": mesh.offsets}
            self.arrays |= {f"{key}/section {number}": nodes for number, nodes in enumerate(mesh.sections.values())}
            pairs = {"supports": mesh.supports, "loads": mesh.loads}
            self.arrays |= {
                f"{key}/{name}": np.array([[n, *at] for n, at in points.items()], float) for name, points in pairs.items() if points
            }
        return self.meshes[id(mesh)]


def _plain(value):
    """An array of numbers as nested lists of floats."""
    return np.asarray(value, float).tolist()


def _numbers(value, kinds):
    """True for a complex number, tuple, list or array whose numpy dtype has one of the letters `kinds`, such as "iuf"."""
    return isinstance(value, (complex, tuple, list, np.ndarray)) and np.asarray(value).dtype.kind in kinds


def from_data(description, arrays, drives=None):
    """{name: part} and gravity from data. drives(key): the profile of a drive.

    Raises InputError if the data are no scene, and UnknownPart for a kind that is not in `registry.parts` and for a field without data.
    """
    reader = _Decoder(arrays, drives or (lambda key: None))
    try:
        reader.waiting = {entry["name"]: entry for entry in description["parts"]}
        parts = {name: reader.part_of(name) for name in [*reader.waiting]}
        return parts, reader.value({"name": "gravity"}, "gravity", description["gravity"])
    except (InputError, UnknownPart):
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"the scene in the file is damaged: {type(error).__name__} {error}") from None


def factors_from(description, arrays):
    """{plate: (stiffness, mass)} of plates with factors of cells, from data."""
    reader = _Decoder(arrays, None)
    try:
        pairs = description.get("factors", {}).items()
        return {name: tuple(reader.value({"name": name}, "factors", one) for one in pair) for name, pair in pairs}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"the factors in the file are damaged: {type(error).__name__} {error}") from None


class _Decoder:
    """Makes parts from entries; a joint makes its bodies, which may stand behind it."""

    def __init__(self, arrays, drives):
        """Take the arrays of a file and the function (key) -> profile of drives."""
        self.arrays, self.drives = arrays, drives
        self.parts = {}  # {name: part} of those made so far
        self.meshes = {}  # {key: mesh}
        self.waiting = {}  # {name: entry} of those not made yet

    def part_of(self, name):
        """The part of that name, made when it is first asked for."""
        if name not in self.parts:
            self.parts[name] = self.part(self.waiting.pop(name))
        return self.parts[name]

    def part(self, entry):
        """The part of an entry {"kind", "name", "fields"} of the data."""
        was_penalty = entry["kind"] == "Contact" and "stiffness" in entry["fields"]  # its name before
        kind = registry.find(registry.parts, "PenaltyContact" if was_penalty else entry["kind"])
        if kind is None:
            raise UnknownPart(f"its part {entry['name']!r} is a {entry['kind']}; define or import that class before loading")
        values = {key: self.value(entry, key, value) for key, value in entry["fields"].items()}
        return kind(**values, name=entry["name"])

    def value(self, entry, key, value):
        """The value of a field from its plain data `entry`; key: the prefix of its arrays."""
        if not isinstance(value, dict):
            return tuple(value) if isinstance(value, list) else value
        if "unknown" in value:
            raise UnknownPart(f"{key} of its part {entry['name']!r} is a {value['unknown']}, which no file can hold")
        if "ground" in value:
            return Ground() if value["ground"] is None else Ground().at(*value["ground"])
        if "profile" in value:
            return profile.from_formula(tuple(value["profile"]))
        if "each" in value:
            return tuple(self.value(entry, key, item) for item in value["each"])
        if "drive" in value:
            return self.drives(value["drive"]) or profile.constant(0.0)
        if "complex" in value:
            real, imaginary = map(np.array, value["complex"])
            return real + 1j * imaginary
        if "material" in value:
            return Material(*value["material"])
        if "array" in value:
            return self.arrays[value["array"]]
        if "named" in value:
            return {known: self.value(entry, key, one) for known, one in value["named"].items()}
        if "part" in value:
            return self.part(value["part"])
        return self._mesh(value["mesh"], value["sections"], value.get("order", 1)) if "mesh" in value else self._side(value["side"])

    def _mesh(self, key, names, order):
        """The mesh of a key, made when it is first asked for. names: of its sections."""
        arrays = self.arrays
        if key not in self.meshes:
            sections = {name: arrays[f"{key}/section {number}"] for number, name in enumerate(names)}
            pairs = [{int(n): at for n, *at in arrays.get(f"{key}/{name}", np.zeros((0, 3))).tolist()} for name in ("supports", "loads")]
            cells = (arrays[f"{key}/{part}"] for part in ("points", "nodes", "offsets"))
            self.meshes[key] = PolygonMesh(*cells, sections, *pairs, order)
        return self.meshes[key]

    def _side(self, side):
        """The attachment of data. Raises InputError unless it selects nodes of its body, with a weight each."""
        key, arrays = side["key"], self.arrays
        nodes, body = arrays[f"{key}/nodes"], self.part_of(side["body"])
        if "corners" in side:
            return body.edges(*map(str, side["corners"]))
        real = arrays[f"{key}/weights"].ndim == 1
        kind, count = (Attachment, body.mesh.n_nodes) if real else (BodyPoint, len(coordinates_of(body)))
        weights, turn = (
            None if array is None else _weights(array, kind) for array in (arrays[f"{key}/weights"], arrays.get(f"{key}/turn_weights"))
        )
        if nodes.size == 0 or nodes.dtype.kind != "i" or nodes.min() < 0 or nodes.max() >= count:
            raise InputError(f"the scene in the file is damaged: {key} selects nodes that {side['body']!r} does not have")
        if not nodes.shape == weights.shape == (weights if turn is None else turn).shape == (nodes.size,):
            raise InputError(f"the scene in the file is damaged: {key} has not one weight a node")
        if not 0 <= float(side["length"]) < np.inf:
            raise InputError(f"the scene in the file is damaged: {key} has the length {side['length']}")
        return kind(body, nodes.astype(np.int32), weights, turn, float(side["length"]), str(side["name"]))


def _real(weights):
    """Weights of a file: real ones unchanged, complex ones (k,) as (k, 2)."""
    return np.stack([weights.real, weights.imag], axis=1) if np.iscomplexobj(weights) else weights


def _weights(array, kind):
    """Weights (k,) of an array of a file: floats for an Attachment, otherwise complex, stored as (k, 2)."""
    weights = np.asarray(array, float)
    return weights if kind is Attachment else weights[:, 0] + 1j * weights[:, 1]
