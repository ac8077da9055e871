"""What a user writes: parts that are added to a scene, which is then built into one model."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from numpy.typing import ArrayLike

from polyida.assembly.build import sides_held
from polyida.assembly.closing import Assembly, close
from polyida.assembly.scene_model import SceneModel
from polyida.body.body import Body, OwnPart
from polyida.body.plate import Plate
from polyida.body.rigid_body import PointMass
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, require_element
from polyida.force.loads import EdgeTraction, PointLoad
from polyida.joint.joint import Joint
from polyida.profile import Profile, as_profile
from polyida.reprs import counted, cut, settings, short, table
from polyida.validation import is_number, is_one_of, named_keywords, number, vector2

Part = TypeVar("Part", bound=Plate | PointMass | PointLoad | EdgeTraction | Joint | OwnPart)
REDUNDANT = ("refuse", "least-norm")
KINDS = {Plate: "plate", PointMass: "mass", PointLoad: "load", EdgeTraction: "traction"}
KINDS_AND_BASES = (*KINDS, Joint, ForceElement, Body)


@named_keywords
class Scene:
    """Flexible plates, joints, motors, masses, loads, bodies and forces of one's own in the x-y plane.

    gravity: acceleration (gx, gy), m/s2; each a number, or a profile or function of time where it is switched or turned. `add` parts in
    any order, then `build` a model; a scene can be added to and built again.
    """

    def __init__(self, gravity: "ArrayLike | Sequence[float | Profile | Callable[[float], float]]" = (0.0, 0.0)) -> None:
        self.gravity = _gravity(gravity)
        self.parts: dict[str, Any] = {}
        self._built: set[str] = set()  # names of the parts that models hold on to

    def __repr__(self):
        return f"<Scene: {len(self.parts)} part{'s' * (len(self.parts) != 1)}{': ' * bool(self.parts)}{cut(counted(self.parts))}>"

    def _repr_html_(self):
        """A table of the parts, for notebooks."""
        rows = [(name, type(part).__name__, settings(part)) for name, part in self.parts.items()]
        gravity = ", ".join(f"{g:.6g}" if is_number(g) else short(g) for g in self.gravity)
        return table(f"Scene, gravity ({gravity}) m/s²", ("name", "kind", "what it is given"), rows)

    def add(self, part: Part) -> Part:
        """Add a part and return it. Parts without a name are called by kind and number ("plate 1").

        Raises InputError for what is no part, and for a name that is taken.
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
        number = 1 + sum(kind_of(part) == kind for part in self.parts.values())
        while f"{kind} {number}" in self.parts:
            number += 1
        return f"{kind} {number}"

    def assemble(self) -> Assembly:
        """Move the bodies, each as rigid and by as little as it takes, until all joints are closed; an Assembly that says by how much.

        Unknowns are place and angle of each body, equations the rows of the joints as drawn, those that are driven at t = 0, solved
        to round-off. What joints take from the drawing they keep: a joint to plain `ground` its place there, a motor or clamp the angle
        between its sides; a body clamped to the ground stays. Bodies are moved where they are, by their `origin` and `angle`: their
        attachments hold on. One of a user's own without these two stays too.
        Raises InputError, with nothing moved, naming the joints that stay open and by how much; and where bodies would have to move
        of which there is a model already.
        """
        self._require_sides("assemble")
        return close(self.parts, self._built)

    def build(self, redundant: str = "refuse") -> SceneModel:
        """The model of the scene as it is now. Raises InputError naming the part that is wrong.

        redundant: what becomes of rows of joints that follow from others, as those of a second hinge on one axis. "refuse": runs do not
        start, and the message names them. "least-norm": they are left out, `model.redundant.labels` names them, and reactions are those
        of all rows with the least sum of squares; `run.unique(name)` says which of them are the only ones. Rows that are independent
        elsewhere, or contradict others, are refused.
        """
        if not is_one_of(redundant, REDUNDANT):
            raise InputError(f"Scene.build: redundant = {redundant!r} must be one of {', '.join(map(repr, REDUNDANT))}")
        self._require_sides("build")
        model = SceneModel(self.parts, self.gravity, redundant)
        self._built |= set(self.parts)
        return model

    def _require_sides(self, what):
        """Raise InputError unless there are bodies, and parts hold on to bodies of this scene."""
        bodies = [part for part in self.parts.values() if isinstance(part, (Plate, Body))]
        if not bodies:
            raise InputError(f"Scene.{what}: the scene has no plate and no other body")
        for name, part in self.parts.items():
            for side in sides_held(name, part):
                if not any(side.body is body for body in bodies):
                    raise InputError(f"{name}: {side!r} is of a body that is not in the scene; add it with scene.add")


def _gravity(given):
    """Two floats, (2,), or a tuple of floats and profiles. Raises InputError."""
    if not (isinstance(given, (tuple, list)) and len(given) == 2 and any(map(callable, given))):
        return vector2("Scene", "gravity", given)
    return tuple(as_profile(g, "Scene: gravity") if callable(g) else number("Scene", "gravity", g, "m/s2") for g in given)


def kind_of(part):
    """What a part without a name is called with a number."""
    if isinstance(part, Joint):
        return part.kind or type(part).__name__.lower()
    if isinstance(part, (ForceElement, Body)):
        return type(part).__name__.lower()
    return next(word for kind, word in KINDS.items() if isinstance(part, kind))
