"""Stress in one number."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.given import floats
from polyida.keywords import named_keywords


@named_keywords
def von_mises(stress: ArrayLike, zz: ArrayLike = 0.0) -> NDArray:
    """Von Mises stress of Cauchy components (..., 3), xx, yy, xy, and zz (...), same unit:

        sqrt(((xx - yy)^2 + (yy - zz)^2 + (zz - xx)^2) / 2 + 3 xy^2)

    zz is 0 in plane stress; in plane strain it is not, `run.von_mises(frame)` knows it.
    """
    given, out = floats(stress), floats(zz)
    if given is None or not given.ndim or given.shape[-1] != 3:
        raise InputError(f"von_mises: stress = {stress!r} must be finite numbers (..., 3): xx, yy, xy")
    if out is None or out.shape not in ((), given.shape[:-1]):
        raise InputError(f"von_mises: zz = {zz!r} must be a finite number, or one for each of the stresses {given.shape[:-1]}")
    xx, yy, xy = np.moveaxis(given, -1, 0)
    return np.sqrt(((xx - yy) ** 2 + (yy - out) ** 2 + (out - xx) ** 2) / 2 + 3 * xy * xy)
