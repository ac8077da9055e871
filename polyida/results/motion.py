"""A run as what is derived from it sees it."""

from typing import Any, NamedTuple

from numpy.typing import NDArray


class Motion(NamedTuple):
    """A guarded model, t (frames,), and frames of q, v, a, lam, which may lie in a file."""

    model: Any
    t: NDArray
    q: NDArray
    v: NDArray
    a: NDArray
    lam: NDArray
