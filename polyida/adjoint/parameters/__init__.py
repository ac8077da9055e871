"""What a model depends on, by name, and the slopes in it of what is summed over a run."""

from typing import Any

from polyida.adjoint.parameters.drives import drive_works, in_time
from polyida.adjoint.parameters.numbers import of_fields, of_own
from polyida.adjoint.parameters.parameter import Parameter, Shared
from polyida.adjoint.parameters.parts import of_loads, of_motions, of_plates
from polyida.adjoint.parameters.profiles import of_profiles
from polyida.assembly.bodies.motion import motion_slopes, moves_at

__all__ = ["Parameter", "in_time", "parameters_of"]


def parameters_of(model: Any) -> dict[str, Parameter]:
    """{name: Parameter} of a model: of a scene those of its parts, of a model of one's own those that its `parameters` names."""
    found = _of_scene(model) if model.is_scene else of_own(model)
    return {parameter.name: parameter for parameter in found}


def _of_scene(model):
    def slopes(t, q, bar):
        return motion_slopes(model, t, q, bar)

    def changes(t, q, bar):
        return slopes(t, q, bar) if moves_at(model, t, q) else None

    yield from of_fields(model)
    yield from of_plates(model, changes)
    yield from of_loads(model, changes)
    yield from of_motions(model, slopes)
    yield from of_profiles(model, Shared(drive_works, model), changes)
