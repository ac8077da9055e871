"""Linear and angular momentum of a run."""

import numpy as np

from polyida.errors import InputError
from polyida.io.frames import each


def momenta_of(motion):
    """(frames, 3): linear momentum x and y, N s, and angular momentum about the origin, N m s. Raises InputError where the model says none."""
    found = [motion.model.momenta(q, v) for q, v in zip(each(motion.q), each(motion.v))]
    if any(values is None for values in found):
        raise InputError(f"momentum: {motion.model.name} does not say it; let its class write momenta(q, v), giving (px, py, L)")
    return np.array(found, float).reshape(-1, 3)
