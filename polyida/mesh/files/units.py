"""Lengths in files: how many metres one unit of a file is, and a word where numbers look like millimetres."""

import numpy as np

from polyida.errors import InputError
from polyida.given import is_number, is_one_of

METRES = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
WIDE = 20.0  # metres: a plate of a mechanism is hardly wider, one drawn in millimetres mostly is


class MeshWarning(UserWarning):
    """What was changed in a mesh from elsewhere, or looks wrong in it."""


def metres(unit):
    """Metres of one unit, given by its name or as that number; InputError for anything else."""
    if is_one_of(unit, METRES):
        return METRES[unit]
    if is_number(unit) and unit > 0:
        return float(unit)
    raise InputError(f"unit is {unit!r}; it must be one of {', '.join(METRES)}, or the metres in one unit of the file")


def scale_of(unit, said):
    """Metres of one unit: as the user says, else as the file does (`said`), else one."""
    return metres(unit) if unit is not None else said or 1.0


def hint(points, unit, said):
    """[what to ask the user] where nobody said the unit and the points span so much that they may be millimetres."""
    width = float(np.ptp(points, axis=0).max())
    if unit is not None or said is not None or width <= WIDE:
        return []
    return [f"it is {width:.6g} m wide; if its numbers are millimetres pass unit='mm', if they are metres unit='m'"]
