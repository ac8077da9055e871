"""What every joint is: two sides and the formula of its rows."""

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

from polyida import registry
from polyida.joint.attachment import Ground, labelled, require_directions, require_sides
from polyida.joint.formula import Row, Vector

FORCE = (("x", "N"), ("y", "N"))  # axis and unit of the components of a reaction


@dataclass(frozen=True, eq=False)
class Joint:
    """A holonomic constraint between attachments a and b of two bodies, or of a body and the ground.

    A joint of one's own is a class with `rows()`, a list of rows made of `self.a.x`, `self.a.d`, `self.b.x`, `self.b.d` (place, m,
    and direction of a side, without unit) by `pi.cross`, `pi.dot`, `+`, `-`, numbers, `.turned(profile)` and profiles, which move a row
    in time, as in `pi.dot(self.a.d, self.b.x - self.a.x) - self.stroke`; a product has at most two factors; a vector stands for its two
    components. Further fields (numbers,
    profiles, attachments) make it a frozen dataclass; they are saved with it. A joint without driven rows must be closed in the reference
    configuration: what is apart by less than 1e-6 of the scene's size counts as that.
    """

    a: Any
    b: Any
    name: str | None = field(default=None, kw_only=True)
    kind: ClassVar[str | None] = None  # what a joint without a name is called with a number; the class's name where None
    placing: ClassVar[str] = "place the bodies so that they meet"  # what to do where it is not closed at rest

    def __init_subclass__(cls, **options):
        super().__init_subclass__(**options)
        registry.parts[registry.name_of(cls)] = cls

    def __post_init__(self):
        require_sides(labelled(type(self).__name__, self.name), self.a, self.b)

    def rows(self) -> list[Row | Vector]:
        """Rows of phi, a list of Row and Vector."""
        raise NotImplementedError(f"{type(self).__name__} gives no rows()")

    @property
    def components(self) -> tuple[tuple[str, str], ...] | None:
        """(axis, unit) of the components of its reaction.

        None: force and moment, as far as the rows act by them on b. Of one row that acts on the point of b alone, the force along
        d phi/dx_b, its direction: one number, N.
        """
        return None

    @property
    def by_points(self) -> bool:
        """Whether its reaction is the force on each point of b in its rows, not the sum of these and their moment."""
        return False

    def require_directions(self, *sides: Any) -> None:
        """Raise InputError unless these sides have a direction, or both where none are given."""
        require_directions(labelled(type(self).__name__, self.name), *(sides or (self.a, self.b)))

    def keep_drawing(self) -> None:
        """Called before `scene.assemble()` moves bodies: keep of the drawing what rows() would take from another one otherwise."""

    def facing(self) -> Self:
        """The joint with plain `ground` put where its other side is in the reference configuration."""
        a, b = (side.facing(other) if isinstance(side, Ground) else side for side, other in ((self.a, self.b), (self.b, self.a)))
        return replace(self, a=a, b=b)
