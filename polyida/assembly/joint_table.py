"""From joints to the rows of phi: the table that the joint kernels read."""

import numpy as np

from polyida.assembly.joints import LINEAR, MOTOR
from polyida.errors import InputError
from polyida.joint.attachment import ground
from polyida.joint.rows import LinearRows


class JointTable:
    """Collects constraint rows; `labels` says for every row of phi what to call it, `rows` which rows are whose."""

    def __init__(self, points, drives, size):
        self._points, self._drives, self._size = points, drives, size
        self._entries = []
        self.labels, self.rows, self.sides = [], {}, {}

    def add(self, name, joint):
        """Append the rows of a joint. Raises InputError where its sides are apart in the reference configuration."""
        first = len(self.labels)
        for row in joint.rows():
            linear = isinstance(row, LinearRows)
            entry = self._linear(name, row) if linear else self._motor(row)
            self._entries.append((LINEAR if linear else MOTOR, len(self.labels), *entry))
            self.labels += [f"{name} {axis}" for axis in ("x", "y")] if linear else [f"{name} angle"]
        self.rows[name] = slice(first, len(self.labels))
        self.sides[name] = joint

    def _linear(self, name, row):
        a, b = (-1 if side is ground else self._points.add(side, row.part) for side in (row.a, row.b))
        matrix = np.eye(2)
        if a >= 0 and b >= 0:
            if row.part == "direction":
                matrix = _rotation(row.b.direction, row.a.direction)
            else:
                gap = np.linalg.norm(row.a.point - row.b.point)
                if gap > 1e-6 * self._size:
                    raise InputError(f"{name}: its sides are {gap:.3g} m apart at rest, {row.a!r} at {_place(row.a)} and "
                                     f"{row.b!r} at {_place(row.b)}; place the bodies so that they meet")
        return a, b, -1, matrix, np.zeros((2, 2))

    def _motor(self, row):
        a, b = (-1 if side is ground else self._points.add(side, "direction") for side in (row.a, row.b))
        rest = row.b.direction if a < 0 else row.a.direction
        turn = _rotation(rest, rest if b < 0 else row.b.direction)
        return a, b, self._drives.add(row.angle), turn, (rest, _turned(turn, rest))

    def arrays(self):
        """The fields of SceneArrays that describe the joints."""
        kind, row, a, b, drive, matrix, rest = zip(*self._entries) if self._entries else [()] * 7
        return {
            "joint_kind": np.array(kind, np.int64), "joint_row": np.array(row, np.int64),
            "joint_a": np.array(a, np.int64), "joint_b": np.array(b, np.int64), "joint_drive": np.array(drive, np.int64),
            "joint_matrix": np.array(matrix, float).reshape(-1, 2, 2), "joint_rest": np.array(rest, float).reshape(-1, 2, 2),
        }


class Drives:
    """The profiles of a scene, each once."""

    def __init__(self):
        self.profiles = []

    def add(self, profile):
        """Number of the profile."""
        for number, known in enumerate(self.profiles):
            if known is profile:
                return number
        self.profiles.append(profile)
        return len(self.profiles) - 1


def _rotation(start, end):
    """The rotation matrix that turns direction `start` into direction `end`."""
    c, s = start @ end, start[0] * end[1] - start[1] * end[0]
    return np.array([[c, -s], [s, c]]) / np.hypot(c, s)


def _turned(matrix, d):
    """The rotation of a direction, each product rounded as the kernels do: a motor's phi at rest is zero, not of round-off."""
    (c, _), (s, _) = matrix.tolist()
    return np.array([c * d[0] - s * d[1], s * d[0] + c * d[1]])


def _place(attachment):
    x, y = attachment.point
    return f"({x:.6g}, {y:.6g})"
