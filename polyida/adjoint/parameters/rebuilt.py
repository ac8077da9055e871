"""A scene with something in it changed, all else the same."""

from dataclasses import fields, replace

from polyida.assembly.scene_model import SceneModel
from polyida.joint.attachment import Attachment


def rebuilt(model, parts, gravity=None):
    """The model of other parts of the same names, with the factors of this one."""
    made = SceneModel(parts, model.gravity if gravity is None else gravity, model.treats_redundant)
    return made.with_factors(**model.factors) if model.factors else made


def changed(part, path, value):
    """The part with another value in a field, or in that of what stands in a field: path, their names."""
    key, *inner = path
    return replace(part, **{key: changed(getattr(part, key), inner, value) if inner else value})


def with_part(model, name, new):
    """The model with a part changed; what holds on to a body holds on to the changed one."""
    old = model.parts[name]
    on_new = lambda value: value.on(new) if isinstance(value, Attachment) and value.body is old else value  # noqa: E731
    return rebuilt(model, {known: new if part is old else _with(part, on_new) for known, part in model.parts.items()})


def with_profile(model, old, new):
    """The model with another profile wherever it has this one."""
    parts = {name: holding_profile(part, old, new) for name, part in model.parts.items()}
    return rebuilt(model, parts, tuple(new if g is old else g for g in model.gravity))


def holding_profile(part, old, new):
    """The part with another profile in its fields, alone or in a tuple, in place of one; itself where it has not that."""
    return _with(part, lambda value: new if value is old else value)


def _with(part, change):
    """The part with `change` done to its fields and to what tuples among them hold; itself where that changes nothing."""
    given = {field.name: getattr(part, field.name) for field in fields(part) if field.init}
    found = {name: tuple(map(change, value)) if isinstance(value, tuple) else change(value) for name, value in given.items()}
    different = {name: value for name, value in found.items() if not _same(value, given[name])}
    return replace(part, **different) if different else part


def _same(one, other):
    return one is other or isinstance(one, tuple) and len(one) == len(other) and all(x is y for x, y in zip(one, other))
