"""A point mass carried by an attachment."""

from dataclasses import dataclass

from polyida.body.material import positive
from polyida.joint.attachment import Attachment, require_attachment


@dataclass(frozen=True, eq=False)
class PointMass:
    """A mass (kg, > 0) at the mean point x of an attachment: kinetic energy `m |x'|^2 / 2`, weight `m g`."""

    at: Attachment
    mass: float
    name: str | None = None

    def __post_init__(self):
        require_attachment("PointMass" if self.name is None else f"point mass {self.name!r}", self.at)
        positive("PointMass" if self.name is None else f"point mass {self.name!r}", "mass", self.mass, "kilograms")
