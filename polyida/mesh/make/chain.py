"""A wall that is a chain of straight pieces, bending little from one to the next: a side of an outline, or a curve of short chords."""

from dataclasses import dataclass, replace

import numpy as np


def nearest(points, start, along, low=0.0, high=1.0):
    """(edge (n,), share of it (n,)) of the place nearest to each point on the edges start + share along, low <= share <= high."""
    x, y = points[:, :1] - start[:, 0], points[:, 1:] - start[:, 1]
    share = np.clip((x * along[:, 0] + y * along[:, 1]) / np.sum(along**2, axis=1), low, high)
    x -= share * along[:, 0]
    y -= share * along[:, 1]
    edge = np.argmin(x * x + y * y, axis=1)
    return edge, share[np.arange(len(points)), edge]


@dataclass(frozen=True, eq=False)
class Chain:
    """vertices (k + 1, 2), the inside on the left of the way along them; closed ones end where they begin, others go on straight.

    outward: whether it leaves the domain by going on at its begin and at its end, as it does at corners that are not re-entrant.
    """

    vertices: np.ndarray
    closed: bool
    outward: tuple[bool, bool] = (True, True)
    sign: float = 1.0

    def _nearest(self, points):
        """(foot (n, 2), direction of the piece there (n, 2), of unit length; (n,) -1 before the begin, 1 beyond the end, 0)."""
        along = np.diff(self.vertices, axis=0)
        low, high = np.zeros(len(along)), np.ones(len(along))
        if not self.closed:
            low[0], high[-1] = -np.inf, np.inf
        piece, share = nearest(points, self.vertices[:-1], along, low, high)
        foot = self.vertices[piece] + share[:, None] * along[piece]
        return foot, (along / np.hypot(*along.T)[:, None])[piece], (share > 1.0).astype(int) - (share < 0.0)

    def distance(self, points):
        """(n,), m, negative inside."""
        foot, along, _ = self._nearest(points)
        away = points - foot
        right = along[:, 1] * away[:, 0] - along[:, 0] * away[:, 1]
        return self.sign * np.where(right < 0.0, -1.0, 1.0) * np.hypot(*away.T)

    def normal(self, points):
        """(n, 2), gradient of the distance; that of the piece for points on it."""
        foot, along, _ = self._nearest(points)
        away = points - foot
        outwards = np.column_stack([along[:, 1], -along[:, 0]])
        length = np.hypot(*away.T)
        near = length < 1e-9 * np.ptp(self.vertices, axis=0).max()
        side = np.where(np.einsum("nx,nx->n", outwards, away) < 0.0, -1.0, 1.0)
        return self.sign * np.where(near[:, None], outwards, side[:, None] * away / np.where(near, 1.0, length)[:, None])

    def faces(self, points):
        """(n,) mask: the foot of the point is on the chain, or where it goes on outside the domain."""
        where = np.zeros(len(points), int) if self.closed else self._nearest(points)[2]
        return (where == 0) | np.where(where < 0, *self.outward)

    def samples(self, lower, upper):
        """(200, 2) points of the wall, wherever they are."""
        ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.vertices, axis=0).T))])
        at = ends[-1] * (np.arange(200) + 0.5) / 200
        return np.column_stack([np.interp(at, ends, column) for column in self.vertices.T])

    def flipped(self):
        """The same wall with its inside outside."""
        return replace(self, sign=-self.sign, outward=tuple(not out for out in self.outward))

    def moved(self, offset):
        """The wall moved by (x, y), m."""
        return replace(self, vertices=self.vertices + offset)
