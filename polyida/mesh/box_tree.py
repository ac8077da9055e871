"""A tree of boxes over pieces of curves in the plane: pieces that may meet, and the nearest piece to each point, without loops over pieces.

Pieces are sorted along Morton's curve, so that neighbours in the tree are neighbours in the plane. All pairs of one level of the tree are
handled at once.
"""

import numpy as np

from polyida.mesh.topology import cross

AT_ONCE = 500_000  # pairs in memory
FEW = 64  # pieces that are compared with all points
ROUND_OFF = 1e-12  # of the size, by which boxes are enlarged
ON_CIRCLE = 64  # places on a circle
CORNERS = np.array([(0, 0), (0, 1), (1, 0), (1, 1)])


class BoxTree:
    """Boxes low, high (n, 2) of n pieces."""

    def __init__(self, low, high):
        """Sort the boxes along Morton's curve and join them in pairs, level by level, up to one box of all."""
        self.count = len(low)
        margin = ROUND_OFF * float(np.max(high.max(axis=0) - low.min(axis=0)))
        self.order = np.argsort(_morton(0.5 * (low + high)), kind="stable")
        leaves = 1 << max(0, int(self.count - 1).bit_length())
        lows, highs = np.full((leaves, 2), np.inf), np.full((leaves, 2), -np.inf)  # empty boxes meet nothing
        lows[: self.count], highs[: self.count] = low[self.order] - margin, high[self.order] + margin
        self.levels = [(lows, highs)]
        while len(lows) > 1:
            lows, highs = np.minimum(lows[::2], lows[1::2]), np.maximum(highs[::2], highs[1::2])
            self.levels.append((lows, highs))
        self.levels.reverse()

    def meeting(self):
        """Yield arrays (i, j) of pieces whose boxes meet, each pair once."""
        waiting = [(0, np.zeros(1, int), np.zeros(1, int))]
        while waiting:
            level, first, second = waiting.pop()
            if level + 1 == len(self.levels):
                different = first != second
                yield self.order[first[different]], self.order[second[different]]
                continue
            low, high = self.levels[level + 1]
            i = (2 * first[:, None] + CORNERS[:, 0]).ravel()
            j = (2 * second[:, None] + CORNERS[:, 1]).ravel()
            kept = (i <= j) & (low[i] <= high[j]).all(axis=1) & (low[j] <= high[i]).all(axis=1)
            waiting += _parts(level + 1, i[kept], j[kept])

    def nearest(self, points, bound, distance):
        """(n,) nearest piece to each point, the first of several.

        bound (n,): a distance within which there is a piece; distance(numbers of points, pieces): of pairs, never below that of the boxes.
        """
        best, away = np.zeros(len(points), int), np.full(len(points), np.inf)
        waiting = _parts(0, np.arange(len(points)), np.zeros(len(points), int))
        reach = bound + ROUND_OFF * np.abs(points).max(initial=0.0)
        while waiting:
            level, point, node = waiting.pop()
            if level + 1 < len(self.levels):
                low, high = self.levels[level + 1]
                point, node = np.repeat(point, 2), (2 * node[:, None] + [0, 1]).ravel()
                outside = np.maximum(np.maximum(low[node] - points[point], points[point] - high[node]), 0.0)
                kept = np.hypot(*outside.T) <= reach[point]
                waiting += _parts(level + 1, point[kept], node[kept])
                continue
            piece = self.order[node]
            found = distance(point, piece)
            first = np.flatnonzero(np.diff(point, prepend=-1))  # pairs are sorted by their points
            size, least = np.diff(np.append(first, len(point))), np.minimum.reduceat(found, first)
            chosen = np.minimum.reduceat(np.where(found == np.repeat(least, size), piece, self.count), first)
            at = point[first]
            better = (least < away[at]) | ((least == away[at]) & (chosen < best[at]))
            best[at[better]], away[at[better]] = chosen[better], least[better]
        return best


class EdgeTree:
    """The nearest of edges, start + share along with 0 <= share <= 1, and of circles, which count after the edges."""

    def __init__(self, start, along, middle=(), radius=()):
        """Edges start, along (k, 2), and circles middle (c, 2), radius (c,); few pieces need no tree."""
        self.start, self.along = start, along
        self.middle, self.radius = np.reshape(middle, (-1, 2)), np.array(radius, dtype=float)
        self.count = len(start) + len(self.middle)
        if self.count > FEW:
            self._build()

    def _build(self):
        """Make the tree of boxes, and places on all pieces whose nearest one bounds the distance of a point."""
        from scipy.spatial import cKDTree

        self.turn = main_directions(self.along) if len(self.along) else np.eye(2)
        a, b = self.start @ self.turn, (self.start + self.along) @ self.turn
        middle, radius = self.middle @ self.turn, self.radius[:, None]
        low = np.concatenate([np.minimum(a, b), middle - radius])
        self.boxes = BoxTree(low, np.concatenate([np.maximum(a, b), middle + radius]))
        # places on all pieces, of which the nearest gives a bound: at most twice as many as edges
        length = np.hypot(*self.along.T)
        parts = 1 + (length / length.mean()).astype(int) if len(length) else np.zeros(0, int)
        edge = np.repeat(np.arange(len(parts)), parts)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(parts) - parts, parts) + 0.5) / parts[edge]  # the ends are those of two edges
        angle = 2 * np.pi * np.arange(ON_CIRCLE) / ON_CIRCLE
        rims = self.middle[:, None] + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        self.owner = np.concatenate([edge, np.repeat(np.arange(len(self.start), self.count), ON_CIRCLE)])
        self.places = cKDTree(np.concatenate([self.start[edge] + share[:, None] * self.along[edge], rims.reshape(-1, 2)]))

    def nearest(self, points):
        """(n,) nearest edge or circle to each point, the first of several."""
        if self.count <= FEW:
            pairs = np.arange(len(points))[:, None], np.arange(self.count)
            parts = np.array_split(pairs[0], 1 + len(points) * self.count // AT_ONCE)
            return np.concatenate([self._away(points, *np.broadcast_arrays(part, pairs[1])).argmin(axis=1) for part in parts])
        bound = self._away(points, np.arange(len(points)), self.owner[self.places.query(points)[1]])
        return self.boxes.nearest(points @ self.turn, bound, lambda point, piece: self._away(points, point, piece))

    def shares(self, points, edge):
        """(n,) share of the nearest place on an edge for each point."""
        along, to = self.along[edge], points - self.start[edge]
        return np.clip(np.sum(to * along, axis=-1) / np.maximum(np.sum(along * along, axis=-1), 1e-300), 0.0, 1.0)

    def _away(self, points, point, piece):
        """Distances, m, between points and pieces (edges or circles), both given by their numbers."""
        if not len(self.start):
            return self._from_circles(points[point], piece)
        here, edge = points[point], np.minimum(piece, len(self.start) - 1)
        away = np.sqrt(np.sum((here - self.start[edge] - self.shares(here, edge)[..., None] * self.along[edge]) ** 2, axis=-1))
        round_ones = piece >= len(self.start)
        if round_ones.any():
            away[round_ones] = self._from_circles(here[round_ones], piece[round_ones] - len(self.start))
        return away

    def _from_circles(self, points, circle):
        """Distances, m, of points (..., 2) from the rims of circles, by the numbers of the circles."""
        return np.abs(np.sqrt(np.sum((points - self.middle[circle]) ** 2, axis=-1)) - self.radius[circle])


def _parts(level, first, second):
    """Split pairs of boxes of a level into [(level, first, second)] of at most AT_ONCE pairs each."""
    return [(level, first[a : a + AT_ONCE], second[a : a + AT_ONCE]) for a in range(0, len(first), AT_ONCE)]


def _morton(points):
    """(n,) place of each point along Morton's curve: the bits of x and y in turn."""
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max())
    bits = ((points - low) * (65535.0 / size if size > 0.0 else 0.0)).astype(np.uint64)
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits[:, 0] | (bits[:, 1] << np.uint64(1))


def main_directions(along):
    """Return the rotation (2, 2) that turns most of the length of segments along x or y, where boxes are thin."""
    turned = 4.0 * np.arctan2(along[:, 1], along[:, 0])
    length = np.hypot(*along.T)
    angle = np.arctan2(length @ np.sin(turned), length @ np.cos(turned)) / 4.0
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def first_crossing(start, end, after):
    """Return the lowest pair (i, j), i < j, of segments that meet or touch and do not follow each other, or None.

    start, end (n, 2): the ends of the segments. after (n,): number of the segment that follows each.
    """
    turn = main_directions(end - start)
    a, b = start @ turn, end @ turn
    found = None
    for i, j in BoxTree(np.minimum(a, b), np.maximum(a, b)).meeting():
        i, j = np.minimum(i, j), np.maximum(i, j)
        apart = (after[i] != j) & (after[j] != i)
        i, j = i[apart], j[apart]
        one = _side(start[i], end[i], start[j]) * _side(start[i], end[i], end[j]) <= 0
        i, j = i[one], j[one]
        low, high = np.minimum(start, end), np.maximum(start, end)
        both = (_side(start[j], end[j], start[i]) * _side(start[j], end[j], end[i]) <= 0) & (low[i] <= high[j]).all(axis=1)
        both &= (low[j] <= high[i]).all(axis=1)
        if both.any():
            pairs = np.column_stack([i[both], j[both]])
            first = tuple(pairs[np.lexsort(pairs.T[::-1])[0]].tolist())
            found = first if found is None else min(found, first)
    return found


def _side(p, q, r):
    """Side of the points r on which they lie of the lines from p to q, all (n, 2): 1 left, -1 right, 0 on the line."""
    return np.sign(cross(q - p, r - p))


def rings_around(points, start, end, ring):
    """Return the pairs (point, ring) of points within rings of segments; ring (n,): number of the ring of each segment."""
    order = np.argsort(points[:, 1], kind="stable")
    height = points[order, 1]
    first = np.searchsorted(height, np.minimum(start[:, 1], end[:, 1]), side="left")  # low <= y < high
    count = np.searchsorted(height, np.maximum(start[:, 1], end[:, 1]), side="left") - first
    rings, crossed = int(ring.max()) + 1, []
    edges, total = np.flatnonzero(count), np.cumsum(count[count > 0])
    for part in np.split(edges, np.searchsorted(total, np.arange(AT_ONCE, total[-1] if len(total) else 0, AT_ONCE))):
        edge = np.repeat(part, count[part])
        step = np.arange(len(edge)) - np.repeat(np.cumsum(count[part]) - count[part], count[part])
        point = order[first[edge] + step]
        left = cross(end[edge] - start[edge], points[point] - start[edge]) > 0
        right_of = left != (end[edge, 1] < start[edge, 1])  # the ray along x meets the edge
        crossed.append(point[right_of] * rings + ring[edge[right_of]])
    pair, times = np.unique(np.concatenate(crossed), return_counts=True)
    return np.column_stack(np.divmod(pair[times % 2 == 1], rings))
