"""A wall that is a chain of straight pieces, bending little from one to the next: a side of an outline, or a curve of short chords."""

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class Chain:
    """vertices (k + 1, 2), the inside on the left of the way along them; closed ones end where they begin, others go on straight."""

    vertices: np.ndarray
    closed: bool
    sign: float = 1.0

    def _nearest(self, points):
        """(foot (n, 2), direction of the piece there (n, 2), of unit length)."""
        along = np.diff(self.vertices, axis=0)
        length = np.hypot(*along.T)
        low, high = np.zeros(len(along)), np.ones(len(along))
        if not self.closed:
            low[0], high[-1] = -np.inf, np.inf
        share = np.einsum("nkx,kx->nk", points[:, None] - self.vertices[:-1], along) / length**2
        foot = self.vertices[:-1] + np.clip(share, low, high)[..., None] * along
        piece = np.argmin(np.sum((points[:, None] - foot) ** 2, axis=2), axis=1)
        return foot[np.arange(len(points)), piece], (along / length[:, None])[piece]

    def distance(self, points):
        """(n,), m, negative inside."""
        foot, along = self._nearest(points)
        away = points - foot
        right = along[:, 1] * away[:, 0] - along[:, 0] * away[:, 1]
        return self.sign * np.where(right < 0.0, -1.0, 1.0) * np.hypot(*away.T)

    def normal(self, points):
        """(n, 2), gradient of the distance; that of the piece for points on it."""
        foot, along = self._nearest(points)
        away = points - foot
        outwards = np.column_stack([along[:, 1], -along[:, 0]])
        length = np.hypot(*away.T)
        near = length < 1e-9 * np.ptp(self.vertices, axis=0).max()
        side = np.where(np.einsum("nx,nx->n", outwards, away) < 0.0, -1.0, 1.0)
        return self.sign * np.where(near[:, None], outwards, side[:, None] * away / np.where(near, 1.0, length)[:, None])

    def samples(self, lower, upper):
        """(200, 2) points of the wall, wherever they are."""
        ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.vertices, axis=0).T))])
        at = ends[-1] * (np.arange(200) + 0.5) / 200
        return np.column_stack([np.interp(at, ends, column) for column in self.vertices.T])

    def flipped(self):
        """The same wall with its inside outside."""
        return replace(self, sign=-self.sign)

    def moved(self, offset):
        """The wall moved by (x, y), m."""
        return replace(self, vertices=self.vertices + offset)
