"""A point mass carried by an attachment."""

from dataclasses import dataclass

from polyida.given import positive, settle
from polyida.joint.attachment import Attachment, labelled, require_attachment
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class PointMass:
    """A mass (kg, > 0) at the mean point x of an attachment: kinetic energy `m |x'|^2 / 2`, weight `m g`."""

    at: Attachment
    mass: float
    name: str | None = None

    def __post_init__(self):
        label = labelled("PointMass", self.name)
        require_attachment(label, self.at)
        settle(self, mass=positive(label, "mass", self.mass, "kilograms"))
