"""Sections: nodes of a mesh ordered along its boundary, with their tributary lengths."""

from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.mesh import checks, topology
from polyida.validation import as_array

ON_CIRCLE = 4  # corners that determine that a rim is a circle: three always lie on one
ROUND = 1e-6  # distance of corners from their circle, relative to the radius: files may be in single precision


@dataclass(frozen=True, eq=False)
class Section:
    """Nodes ordered along the boundary, with tributary lengths and weights.

    Open chains run towards growing x or y, whichever they span more; closed ones (rims) counter-clockwise around their own middle.

    Parameters
    ----------
    nodes : (k,) int
    lengths : (k,) float, m
        Half of each adjacent boundary edge with both ends in the section; 0 without such an edge. Of order 2: one sixth of a side at its
        corners, four sixths at its middle node.
    name : str
    weights : (k,) float, sum 1
        Of the section's mean: proportional to the lengths, equal if all lengths are 0. For the rim of a hole they are changed as little as
        possible, relative to themselves, so that the mean is the hole's centre (the circle's if four or more corners lie on one, else the
        centroid of its area).
    """

    nodes: np.ndarray
    lengths: np.ndarray
    name: str
    weights: np.ndarray

    @property
    def length(self) -> float:
        """Length of the section, m; 0 for single nodes."""
        return float(self.lengths.sum())


def select(mesh, selector):
    """Return the Section of a mesh by name, mask function or node indices (see PolygonMesh.section)."""
    nodes, name = _selected(mesh, selector)
    nodes = of_whole_sides(mesh, nodes)
    parts = _chains(nodes, edges_within(mesh, nodes))
    order = _ordered(mesh.points, nodes, parts)
    lengths = _tributary_lengths(mesh, nodes)[order]
    if not lengths.sum() > 0.0:
        return Section(order, lengths, name, np.full(len(order), 1.0 / len(order)))
    weights = lengths / lengths.sum()
    if len(parts) == 1 and _is_rim(mesh.points, *parts[0]):
        arms = mesh.points[order] - mesh.points[order[0]]
        arms = arms - weights @ arms
        weights = weights * (1.0 + arms @ np.linalg.solve((weights[:, None] * arms).T @ arms, centre(arms, mesh.middle_nodes[order])))
    return Section(order, lengths, name, weights)


def _selected(mesh, selector):
    """(nodes, name) of a user's selector. Raises InputError for an unknown name, another type, and if no node is selected."""
    known = "the mesh's sections are " + (", ".join(map(repr, mesh.sections)) or "none")
    if isinstance(selector, Section):
        selector = selector.nodes
    if isinstance(selector, str):
        if selector not in mesh.sections:
            raise InputError(f"mesh has no section {selector!r}; {known}")
        return mesh.sections[selector], selector
    if callable(selector):
        mask = np.asarray(selector(mesh.points))
        if mask.shape != (mesh.n_nodes,) or mask.dtype != bool:
            raise InputError(
                f"section function must return a boolean mask of shape ({mesh.n_nodes},), not {mask.dtype} of shape {mask.shape}"
            )
        nodes = mesh.boundary_nodes[mask[mesh.boundary_nodes]]
        if nodes.size == 0:
            raise InputError(f"section function {getattr(selector, '__name__', selector)!r} selects no boundary node; {known}")
        return nodes, getattr(selector, "__name__", "function")
    chosen = as_array(selector)
    if chosen is None:
        raise InputError(f"section {selector!r:.100} must be a name, a function or node indices")
    chosen = np.atleast_1d(chosen)
    if chosen.size == 0:
        raise InputError(f"section by index selects no node; {known}")
    return checks.section_nodes("by index", chosen, mesh.n_nodes), "nodes"


def _ordered(points, nodes, parts):
    """The nodes chain by chain: each chain in its direction, and chains by their least x or y, whichever the nodes span more."""
    axis, ordered = int(np.argmax(np.ptp(points[nodes], axis=0))), []
    for chain, closed in parts:
        span = points[chain[-1]] - points[chain[0]]
        reverse = signed_area(points[chain]) < 0 if closed else span[np.argmax(np.abs(span))] < 0
        ordered.append(chain[::-1] if reverse else chain)
    ordered.sort(key=lambda chain: points[chain, axis].min())
    return np.array([node for chain in ordered for node in chain], dtype=np.int32)


def _tributary_lengths(mesh, nodes):
    """(n_nodes,) shares of the boundary edges, or sides of order 2, with all nodes among `nodes`, m."""
    if mesh.order == 2:
        edges = sides_within(mesh, nodes)
        shares = side_shares(mesh.points[edges])
    else:
        edges = edges_within(mesh, nodes)
        shares = np.repeat(0.5 * np.linalg.norm(mesh.points[edges[:, 1]] - mesh.points[edges[:, 0]], axis=1), 2)
    return np.bincount(edges.ravel(), weights=shares.ravel(), minlength=mesh.n_nodes)


def of_whole_sides(mesh, nodes):
    """Return nodes of a section; of order 2 with the middle nodes of all sides with both corners in it, and without other ones beside them."""
    if mesh.order == 1:
        return nodes
    sides, inside = mesh.boundary_edges.reshape(-1, 4)[:, [0, 1, 3]], np.zeros(mesh.n_nodes, dtype=bool)
    inside[nodes] = True
    whole = inside[sides[:, [0, 2]]].all(axis=1)
    if not whole.any():
        return nodes
    inside[mesh.middle_nodes] = False
    inside[sides[whole, 1]] = True
    missing = np.setdiff1d(np.flatnonzero(inside), nodes)
    return np.concatenate([nodes[inside[nodes]], missing]).astype(np.int32)


def sides_within(mesh, nodes):
    """Return the boundary sides (n, 3) of a mesh of order 2, as corner, middle, corner, with all nodes among the nodes."""
    inside = np.zeros(mesh.n_nodes, dtype=bool)
    inside[nodes] = True
    sides = mesh.boundary_edges.reshape(-1, 4)[:, [0, 1, 3]]
    return sides[inside[sides].all(axis=1)]


def side_shares(sides):
    """Lengths (k, 3) of sides (k, 3, 2) of order 2 at their nodes: one sixth at a corner and four at the middle if the side is straight."""
    _, dx = topology.parabolas(sides)
    return np.einsum("gj,gk->kj", topology.SIDE, np.linalg.norm(dx, axis=2))


def edges_within(mesh, nodes):
    """Return the boundary edges (n, 2) with both ends among the nodes."""
    inside = np.zeros(mesh.n_nodes, dtype=bool)
    inside[nodes] = True
    return mesh.boundary_edges[inside[mesh.boundary_edges].all(axis=1)]


def _chains(nodes, edges):
    """[(nodes connected by the directed edges, True if closed)] of open and closed chains and single nodes."""
    ahead = {}
    for a, b in edges.tolist():
        ahead.setdefault(a, []).append(b)
    targets = set(edges[:, 1].tolist())
    starts = [node for node in nodes.tolist() if node not in targets] + nodes.tolist()
    seen, found = set(), []
    for node in starts:
        chain = []
        while node is not None and node not in seen:
            seen.add(node)
            chain.append(node)
            node = next((to for to in ahead.get(node, ()) if to not in seen), None)
        if chain:
            found.append((chain, len(chain) > 2 and chain[0] in ahead.get(chain[-1], ())))
    return found


def signed_area(corner):
    """Return the area of a closed polygon (n, 2), positive counter-clockwise."""
    x, y = (corner - corner.mean(axis=0)).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def centre(rim, middles=None):
    """Return the centre of a hole, (2,): of the circle through the corners of its rim if four or more lie on one, else of its area.

    middles (n,): True for the middle nodes of sides of order 2.
    """
    middle = rim.mean(axis=0)
    arms = rim - middle
    solution = np.linalg.lstsq(np.column_stack([2.0 * arms, np.ones(len(arms))]), (arms**2).sum(axis=1), rcond=None)[0]
    radii = np.hypot(*(arms - solution[:2]).T)
    if len(rim) >= ON_CIRCLE and np.ptp(radii) <= ROUND * radii.mean():
        return middle + solution[:2]
    cell = np.arange(len(rim)), np.array([0, len(rim)])
    if middles is None or not middles.any():
        return topology.centroids(rim, *cell)[0]
    return topology.curved_measures(np.roll(rim, -1, axis=0) if middles[0] else rim, *cell)[1][0]


def automatic(points, boundary):
    """Return the sections of any mesh: left, right, top, bottom if boundary edges lie on the bounding box, and the rims 'hole 0', ... .

    Rims are ordered by x, then y.
    """
    lower, upper = points.min(axis=0), points.max(axis=0)
    near = 1e-9 * float((upper - lower).max()) + 4 * np.finfo(float).eps * float(np.abs(points).max())
    named = {}
    for name, axis, value in (("left", 0, lower), ("right", 0, upper), ("top", 1, upper), ("bottom", 1, lower)):
        on_side = np.abs(points[:, axis] - value[axis]) <= near
        edges = boundary[on_side[boundary].all(axis=1)]
        if len(edges):
            named[name] = np.unique(edges)
    rims = [np.array(chain) for chain, closed in _chains(np.unique(boundary), boundary) if _is_rim(points, chain, closed)]
    rims.sort(key=lambda rim: tuple(np.round(points[rim].mean(axis=0), 9)))
    return named | {f"hole {i}": rim for i, rim in enumerate(rims)}


def _is_rim(points, chain, closed):
    """True for the rim of a hole: the boundary runs clockwise around it."""
    return closed and signed_area(points[chain]) < 0
