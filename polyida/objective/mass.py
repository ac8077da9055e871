"""Mass of the bodies of a scene as an objective."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from polyida.body.rigid_body import PointMass
from polyida.errors import InputError
from polyida.model.guarded import guard, unguarded
from polyida.objective.objective import Objective, Slopes, run_of
from polyida.objective.time_mean import named
from polyida.validation import is_one_of, named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Mass(Objective):
    """Mass of all bodies and point masses of a scene, or of one of them, kg; of plates with the factors of their cells.

    Parameters
    ----------
    part : str, body or PointMass, optional
        By default all.

    Raises
    ------
    InputError
        Of a run if its model is no scene, or if the part has no mass or is not in the scene.
    """

    part: Any = None
    of_frames = False

    def __call__(self, run: Any) -> float:
        return sum(self._masses(run_of("Mass", run).model).values())

    def named(self, model: Any) -> Mass:
        """Return the objective with the name of its part."""
        return replace(self, part=named(model, self.part))

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """Return a function of a slice of frames: all slopes are those of the last frame."""
        run = run_of("Mass", run)
        model = guard(run.model, "Mass")
        masses, direct = self._masses(model), {}
        for body in model.bodies:
            if body.name in masses:
                material, thickness, whole = body.plate.material, body.plate.thickness, masses[body.name]
                direct[f"{body.name}.mass"] = material.rho * thickness * body.mesh.cell_areas
                direct |= {f"{body.name}.rho": whole / material.rho, f"{body.name}.thickness": whole / thickness}
        direct |= {f"{name}.mass": 1.0 for name in masses if isinstance(model.parts[name], PointMass)}
        result = Slopes(direct=direct, of_model=lambda other: sum(self.named(model)._masses(guard(other)).values()))
        return lambda part: result if part.indices(len(run.t))[1] == len(run.t) else Slopes()

    def _masses(self, model):
        """{name: kg} of the chosen bodies and point masses."""
        if not model.is_scene:
            raise InputError(f"Mass: {type(unguarded(model)).__name__} is no scene's model; write it as a pi.objective.UserObjective")
        known = {body.name: body.whole_mass for body in (*model.bodies, *model.few)}
        known |= {name: part.mass for name, part in model.parts.items() if isinstance(part, PointMass)}
        name = named(model, self.part)
        if name is not None and not is_one_of(name, known):
            raise InputError(f"Mass: no body or point mass is called {self.part!r:.100}; known: {', '.join(map(repr, known)) or 'none'}")
        return {key: float(mass) for key, mass in known.items() if name in (None, key)}
