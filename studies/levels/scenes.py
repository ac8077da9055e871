"""A scene at another level: with rigid or reduced bodies instead of plates."""

import inspect
from dataclasses import fields, replace

from polyida import problems, registry
from polyida.body.plate import Plate
from polyida.joint.attachment import Attachment
from polyida.problems.mechanisms import body_at
from polyida.scene import Scene

FULL, RIGID = "full", "rigid"


def body_of(plate, level):
    """A plate at a level: "full", "rigid" or a number of modes."""
    return (body_at("reduced", level) if isinstance(level, int) else body_at(level))(plate)


def at_level(model, level):
    """The Scene of a model with each of its plates at a level, and all else holding on to these."""
    scene, parts = Scene(model.gravity), model.parts
    bodies = {name: body_of(part, level) for name, part in parts.items() if isinstance(part, Plate)}
    stand_for = [(parts[name], body) for name, body in bodies.items()]
    for name, part in parts.items():
        scene.add(bodies.get(name) or _held(name, part, stand_for))
    return scene


def _held(name, part, stand_for):
    """A part with its name and its sides on the bodies that replace their plates."""
    sides = {entry.name: getattr(part, entry.name) for entry in fields(part)}
    sides = {key: side for key, side in sides.items() if isinstance(side, Attachment)}
    return replace(
        part, name=name, **{key: replace(side, body=body) for key, side in sides.items() for plate, body in stand_for if side.body is plate}
    )


def goes_at_any_level(name):
    """True if a problem has an option `level`."""
    return "level" in inspect.signature(registry.find(registry.problems, name)).parameters


def problem_of(name):
    """The Problem of a name, of full plates."""
    return problems.get(name, **({"level": FULL} if goes_at_any_level(name) else {}))
