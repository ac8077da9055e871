"""Angles of joints."""

import numpy as np

from polyida.errors import InputError
from polyida.io.frames import blocks
from polyida.joint.joint import Joint


def angle_of(motion, joint):
    """The turn of a joint's side b against side a, (frames,), rad, unwrapped over the frames."""
    model = motion.model
    joints = {name: model.parts[name] for name in model.joints if isinstance(model.parts[name], Joint)}
    name = next((name for name, part in joints.items() if part is joint), joint)
    if not isinstance(name, str) or name not in joints:
        raise InputError(f"angle: no joint is called {joint!r:.100}; known: {', '.join(map(repr, joints))}")
    return np.unwrap(np.concatenate([model.turn(name, q) for q in blocks(motion.q)]))
