"""Whatever an objective is asked of, as a run: an equilibrium, and the state of modes, is one of a single frame."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.integrate.statics.loading import Equilibrium


class Still(NamedTuple):
    """A state of a model as a run of one frame; modes: about it, or None."""

    model: Any
    t: NDArray
    q: NDArray
    v: NDArray
    a: NDArray
    lam: NDArray
    modes: Any = None


def run_of(part: str, subject: Any) -> Any:
    """What has model, t, q, v, a and lam. Raises InputError, in the name of `part`, for anything else."""
    if isinstance(subject, Still):
        return subject
    if isinstance(subject, Equilibrium):
        return _still(subject.model, subject)
    if hasattr(subject, "roots") and hasattr(subject, "shapes"):
        return _still(subject.model, subject.state, subject)
    if not all(hasattr(subject, name) for name in Still._fields[:-1]) or not len(subject.t):
        raise InputError(f"{part}: {subject!r:.100} is no run with frames, no equilibrium of pi.static and no pi.modes")
    if subject.model is None and hasattr(subject, "known_model"):
        subject.known_model(part)
    return subject


def _still(model, state, modes=None):
    frames = (np.asarray(x, float)[None] for x in (state.t, state.q, state.v, state.a, state.lam))
    return Still(model, *frames, modes)
