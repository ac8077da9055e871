"""Scene: parts that are assembled and built into one model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from polyida.assembly.build import attached_sides, own_sides
from polyida.assembly.closing import Assembly, close
from polyida.assembly.scene_model import SceneModel
from polyida.body.body import Body, points_of, sticks_between
from polyida.body.plate import Plate
from polyida.body.rigid_body import PointMass
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, require_element, sides_of
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.joint.attachment import Ground, OwnPart
from polyida.joint.joint import Joint
from polyida.profile import Profile, as_profile
from polyida.reprs import counted, cut, settings, short, table
from polyida.validation import is_number, is_one_of, named_keywords, number, vector2

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Part = TypeVar("Part", bound=Plate | PointMass | PointLoad | EdgeTraction | OwnPart)
REDUNDANT = ("refuse", "least-norm")
KINDS = {Plate: "plate", PointMass: "mass", PointLoad: "load", EdgeTraction: "traction"}
KINDS_AND_BASES = (*KINDS, Joint, ForceElement, Body)


@named_keywords
class Scene:
    """Flexible plates, joints, motors, masses, loads, and users' bodies and forces in the x-y plane.

    `add` parts in any order, then `build` a model; a scene can be extended and built again.

    Parameters
    ----------
    gravity : pair of float, profile or function of t, m/s2
        Acceleration (gx, gy).
    """

    def __init__(self, gravity: ArrayLike | Sequence[float | Profile | Callable[[float], float]] = (0.0, 0.0)) -> None:
        """Take gravity (2,), m/s^2, a number or a profile for each component; the scene has no part yet."""
        self.gravity = _gravity(gravity)
        self.parts: dict[str, Any] = {}
        self._built: set[str] = set()  # names of the parts of models

    def __repr__(self):
        """One line with the number of parts and how many there are of each kind."""
        return f"<Scene: {len(self.parts)} part{'s' * (len(self.parts) != 1)}{': ' * bool(self.parts)}{cut(counted(self.parts))}>"

    def _repr_html_(self):
        """A table of the parts, for notebooks."""
        rows = [(name, type(part).__name__, settings(part)) for name, part in self.parts.items()]
        gravity = ", ".join(f"{g:.6g}" if is_number(g) else short(g) for g in self.gravity)
        return table(f"Scene, gravity ({gravity}) m/s²", ("name", "kind", "settings"), rows)

    def add(self, part: Part) -> Part:
        """Add a part to the scene and return it.

        Parameters
        ----------
        part : Plate, PointMass, Joint, Body, ForceElement, PointLoad or EdgeTraction
            Without a name it is called by kind and number ("plate 1").

        Returns
        -------
        the part

        Raises
        ------
        InputError
            For anything else, and for a name that is taken.
        """
        if not isinstance(part, KINDS_AND_BASES):
            known = ", ".join(kind.__name__ for kind in KINDS_AND_BASES)
            raise InputError(f"Scene.add: {part!r} is no part of a scene; parts are {known}")
        if isinstance(part, ForceElement):
            require_element(part)
        if isinstance(part, Body):
            part.require()
        if any(part is known for known in self.parts.values()):
            raise InputError(f"Scene.add: {part.name or kind_of(part)!r} is in the scene already")
        name = part.name or self._next_name(kind_of(part))
        if name in self.parts:
            raise InputError(f"Scene.add: the name {name!r} is taken by a {kind_of(self.parts[name])}; names must differ")
        self.parts[name] = part
        return part

    def _next_name(self, kind):
        """The automatic name of a part: its kind and the first free number."""
        number = 1 + sum(kind_of(part) == kind for part in self.parts.values())
        while f"{kind} {number}" in self.parts:
            number += 1
        return f"{kind} {number}"

    @named_keywords
    def plot(self, axes: Axes | None = None) -> Axes:
        """Draw the parts as they are now, with their names: before `assemble` also joints whose sides do not meet, with a line between them.

        Parameters
        ----------
        axes : Axes, optional
            New pyplot axes if None.

        Returns
        -------
        axes : Axes
            Lengths in m.

        Raises
        ------
        InputError
            If the scene has no body, or a part is attached to a body of another scene.
        """
        from polyida.show.plates import draw_scene
        from polyida.show.styles import on_axes

        self.require_sides("plot")
        bodies: dict[str, tuple] = {}
        for name, part in self.parts.items():
            if isinstance(part, (Plate, Body)):
                plate = part if isinstance(part, Plate) else part.plate
                if plate is None:
                    bodies[name] = None, sticks_between(np.reshape([point.point for point in points_of(part)], (-1, 2)))
                else:
                    bodies[name] = plate.mesh, plate.points
        places = {name: _places_of(name, part) for name, part in self.parts.items() if name not in bodies}
        with on_axes(axes) as axis:
            draw_scene(axis, bodies, self.parts, places)
            return axis

    def assemble(self) -> Assembly:
        """Close all joints by the least motion of the bodies, each as a rigid one.

        Unknowns are `origin` and `angle` of each body; equations are the rows of the joints, of motors at t = 0, solved to round-off. Joints
        to plain `ground` keep their place there, motors and clamps the angle between their sides as drawn. A body that is clamped to the
        ground, and a user's body without `origin` and `angle`, does not move.

        Returns
        -------
        Assembly
            By how much each body was moved.

        Raises
        ------
        InputError
            With nothing moved: if joints stay open, with their distances; and if bodies of an existing model would have to move.
        """
        self.require_sides("assemble")
        return close(self.parts, self._built)

    def build(self, redundant: str = "refuse") -> SceneModel:
        """Build the model of the scene as it is now.

        Parameters
        ----------
        redundant : "refuse" or "least-norm"
            Treatment of dependent rows of joints, such as those of a second hinge on one axis. "refuse": runs do not start, and the message
            names the rows. "least-norm": they are left out, `model.redundant.labels` names them, and reactions are those of all rows with the
            least sum of squares; `run.unique(name)` is True for unique ones. Rows that are independent elsewhere, or contradict others, are
            refused; a run ends, with their names, where they contradict others later.

        Returns
        -------
        SceneModel

        Raises
        ------
        InputError
            Naming the wrong part.
        """
        if not is_one_of(redundant, REDUNDANT):
            raise InputError(f"Scene.build: redundant = {redundant!r} must be one of {', '.join(map(repr, REDUNDANT))}")
        self.require_sides("build")
        model = SceneModel(self.parts, self.gravity, redundant)
        self._built |= set(self.parts)
        return model

    def require_sides(self, what: str) -> None:
        """Raise InputError unless there are bodies, and all parts are attached to bodies of this scene.

        Parameters
        ----------
        what : str
            Method that requires it, for the message.
        """
        bodies = [part for part in self.parts.values() if isinstance(part, (Plate, Body))]
        if not bodies:
            raise InputError(f"Scene.{what}: the scene has no plate and no other body")
        for name, part in self.parts.items():
            for side in attached_sides(name, part):
                if not any(side.body is body for body in bodies):
                    raise InputError(f"{name}: {side!r} is of a body that is not in the scene; add it with scene.add")


def _gravity(gravity):
    """Two floats, (2,), or a tuple of floats and profiles. Raises InputError."""
    if callable(gravity):
        raise InputError("Scene: gravity is one function; it must be a pair (gx, gy) of numbers, profiles or functions of time, m/s2")
    if not (isinstance(gravity, (tuple, list)) and len(gravity) == 2 and any(map(callable, gravity))):
        return vector2("Scene", "gravity", gravity)
    return tuple(as_profile(g, "Scene: gravity") if callable(g) else number("Scene", "gravity", g, "m/s2") for g in gravity)


def _places_of(name, part):
    """Where a part holds on to bodies and to the ground, (k, 2), m, as drawn."""
    if isinstance(part, ForceElement):
        return np.array(
            [side.rest if side.at is None else side.at.point for side in sides_of(name, part) if side.at or side.part == "point"]
        )
    sides = own_sides(part)
    held = next((side for side in sides if side.body), None)
    return np.array([(side.facing(held) if isinstance(side, Ground) else side).point for side in sides] if held else np.zeros((0, 2)))


def kind_of(part):
    """The word for a part's kind, of which its automatic name is made, such as "revolute" or "plate"."""
    if isinstance(part, Joint):
        return part.kind or type(part).__name__.lower()
    if isinstance(part, (ForceElement, Body)):
        return type(part).__name__.lower()
    return next(word for kind, word in KINDS.items() if isinstance(part, kind))
