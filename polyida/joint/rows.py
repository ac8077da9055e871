"""What a joint tells the assembly: constraint rows as data on the points and directions of attachments."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LinearRows:
    """`phi = z_A - Q z_B` (2 rows), z the point or the direction of an attachment; for ground z is that of the other side at rest.

    Q is the identity for points and the rotation between the reference directions for directions.
    """

    a: object
    b: object
    part: str


@dataclass(frozen=True)
class MotorRow:
    """`phi = (R(theta + theta0) d_A)^T J d_B` (1 row) with theta a profile."""

    a: object
    b: object
    angle: object
