"""Dead loads: forces that keep their direction, with a time profile."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.joint.attachment import Attachment, labelled, require_attachment
from polyida.profile import Profile, as_profile, constant
from polyida.validation import named_keywords, settle, vector2


@named_keywords
@dataclass(frozen=True, eq=False)
class PointLoad:
    """A force (fx, fy), N, at the mean point of an attachment, times a profile of time (1 where none is given)."""

    at: Attachment
    force: tuple
    profile: Profile | Callable[[float], float] | float = constant(1.0)
    name: str | None = None

    def __post_init__(self):
        label = labelled("PointLoad", self.name)
        require_attachment(label, self.at)
        settle(self, force=tuple(vector2(label, "force", self.force).tolist()), profile=as_profile(self.profile, label))

    def nodal(self) -> NDArray:
        """Nodal forces on the attachment's nodes at profile value 1, (k, 2), N."""
        return self.at.share(self.force)


@named_keywords
@dataclass(frozen=True, eq=False)
class EdgeTraction:
    """A traction (tx, ty), Pa, per reference area of a section of the boundary (length times thickness), times a profile of time."""

    at: Attachment
    traction: tuple
    profile: Profile | Callable[[float], float] | float = constant(1.0)
    name: str | None = None

    def __post_init__(self):
        label = labelled("EdgeTraction", self.name)
        require_attachment(label, self.at)
        if not self.at.length > 0:
            raise InputError(f"{label}: {self.at!r} has no length to act on; use a section of two neighbouring nodes or more")
        traction = tuple(vector2(label, "traction", self.traction).tolist())
        settle(self, traction=traction, profile=as_profile(self.profile, label))

    def nodal(self) -> NDArray:
        """Nodal forces on the section's nodes at profile value 1, (k, 2), N: exact for the elements' linear edges."""
        section = self.at.body.mesh.section(self.at.nodes)
        lengths = np.empty(len(self.at.nodes))
        lengths[np.argsort(self.at.nodes)] = section.lengths[np.argsort(section.nodes)]
        return np.outer(lengths * self.at.body.thickness, np.asarray(self.traction, float))
