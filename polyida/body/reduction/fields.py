"""Fields of a run: what a plate's motion is made of beside its rigid motion, by proper orthogonal decomposition."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.given import complex_of_pairs, is_one_of, is_whole, pairs_of
from polyida.keywords import named_keywords

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory

FRAMES = 400  # of a run that are looked at, evenly spread
NOTHING = 1e-12  # of the largest singular value: a field of as little is round-off


@named_keywords
def fields_of(run: "Trajectory", name: str, count: int = 5) -> NDArray:
    """The `count` fields (count, N, 2), m, that hold most of a plate's deformation in a run, for `pi.Reduced(plate, fields=...)`.

    Of each frame x, complex, the rigid motion nearest in M is taken off, `w = exp(-i theta) (x - x_S) - (X - X_S)`; the fields are the left
    singular vectors of the frames w, of length one in M, most important first. 400 frames are looked at, evenly spread. Source: proper
    orthogonal decomposition by the method of snapshots (Sirovich 1987). Raises InputError where the run has no plate of that name, its
    model is not known, count is no whole number, or the motion has fewer fields.
    """
    if hasattr(run, "known_model"):
        run.known_model("fields_of")
    drawn = {} if getattr(run, "model", None) is None else {body.name: body for body in run.model.drawn}
    if not is_one_of(name, drawn):
        raise InputError(f"fields_of: the run has no plate {name!r}; known: {', '.join(map(repr, drawn)) or 'none'}")
    if not is_whole(count):
        raise InputError(f"fields_of: count = {count!r} must be a whole number of at least 1")
    body, moved = drawn[name], []
    weights = np.add.reduceat(body.operator.mass, body.operator.indptr[:-1])
    weights = weights / weights.sum()
    rest = complex_of_pairs(body.points)
    rest = rest - weights @ rest
    for k in np.unique(np.linspace(0, len(run) - 1, FRAMES).astype(int)):
        x = complex_of_pairs(run.node_positions(int(k))[body.nodes])
        x = x - weights @ x
        turn = np.vdot(x, weights * rest)
        moved.append(x * turn / abs(turn) - rest)
    shares = np.sqrt(weights)
    fields, sizes, _ = np.linalg.svd(shares[:, None] * np.array(moved).T, full_matrices=False)
    if (found := int((sizes > NOTHING * np.abs(rest).max()).sum())) < count:
        raise InputError(f"fields_of: {name!r} has {found} fields in this run, not {count}; keep more frames, or take fewer")
    return pairs_of((fields[:, :count] / shares[:, None]).T)
