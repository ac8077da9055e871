"""Distance: two points a fixed length apart."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from polyida.body.material import positive
from polyida.errors import InputError
from polyida.given import settle
from polyida.joint.attachment import labelled
from polyida.joint.formula import Row, Vector, dot
from polyida.joint.joint import FORCE, Joint
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Distance(Joint):
    """Two points stay a length l apart, as by a massless rod: `phi = (w . w - l^2) / (2 l)`, w = x_B - x_A (1 row, m).

    a, b: attachments, one of them perhaps a place of the ground, `ground.at(point)`. length: l, m; that of the drawing where it is None.
    Reaction on b, (2,): force, N, along the line; the tension of the rod is minus the multiplier.
    Raises InputError for a length that is not positive.
    """

    length: float | None = None
    components = FORCE
    placing = "place the bodies so that their points are the length apart"

    def __post_init__(self):
        super().__post_init__()
        label = labelled("Distance", self.name)
        if self.a.point is None or self.b.point is None:
            raise InputError(f"{label}: ground has no place by itself; use ground.at(point)")
        drawn = float(np.linalg.norm(self.b.point - self.a.point))
        settle(self, length=positive(label, "length", drawn if self.length is None else self.length, "metres"))

    def rows(self) -> list[Row | Vector]:
        """`(w . w - l^2) / (2 l)`."""
        length: Any = self.length
        w = self.b.x - self.a.x
        return [((dot(w, w) - length**2) / (2.0 * length)).named("", "N")]
