"""Sections: nodes of a mesh ordered along its boundary, with the boundary length that belongs to each."""

from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.mesh import checks, topology

ON_CIRCLE = 4  # corners that make a circle where they are on one: three always are
ROUND = 1e-6  # of the radius, by which corners may miss their circle, as those of meshes in single precision do


@dataclass(frozen=True, eq=False)
class Section:
    """Nodes ordered along the section; lengths: half of each adjacent boundary edge whose two ends are in it, m.

    Open chains run towards growing x or y, whichever they span more; closed ones (rims) counter-clockwise around
    their own middle. Nodes without such an edge have length 0. weights: of the section's mean, they sum to 1: its lengths over
    their sum, equal where it has no length. Of the rim of a hole they are changed by as little, in parts of themselves, as makes its
    mean the hole's centre, which the corners of a polygon do not have as theirs; see `centre`.
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
    """Section of a mesh by name, mask function or node indices (see PolygonMesh.section)."""
    if isinstance(selector, Section):
        selector = selector.nodes
    if isinstance(selector, str):
        if selector not in mesh.sections:
            raise InputError(f"mesh has no section {selector!r}; {_known(mesh)}")
        nodes, name = mesh.sections[selector], selector
    elif callable(selector):
        mask = np.asarray(selector(mesh.points))
        if mask.shape != (mesh.n_nodes,) or mask.dtype != bool:
            raise InputError(
                f"section function must return a boolean mask of shape ({mesh.n_nodes},), not {mask.dtype} of shape {mask.shape}"
            )
        kept = mesh.boundary_nodes[mask[mesh.boundary_nodes]]
        if kept.size == 0:
            called = getattr(selector, "__name__", selector)
            raise InputError(f"section function {called!r} selects no boundary node; {_known(mesh)}")
        nodes, name = kept, getattr(selector, "__name__", "function")
    else:
        try:
            chosen = np.atleast_1d(np.asarray(selector))
        except ValueError as error:
            raise InputError(f"section {selector!r} must be a name, a function or node indices: {error}") from None
        if chosen.size == 0:
            raise InputError(f"section by index selects no node; {_known(mesh)}")
        nodes, name = checks.section_nodes("by index", chosen, mesh.n_nodes), "nodes"
    edges = edges_within(mesh, nodes)
    found = chains(nodes, edges)
    order = ordered(mesh.points, nodes, found)
    half = 0.5 * np.linalg.norm(mesh.points[edges[:, 1]] - mesh.points[edges[:, 0]], axis=1)
    lengths = np.bincount(edges.ravel(), weights=np.repeat(half, 2), minlength=mesh.n_nodes)[order]
    return Section(order, lengths, name, _weights(mesh.points[order], lengths, len(found) == 1 and _is_rim(mesh.points, *found[0])))


def _known(mesh):
    return "the mesh's sections are " + (", ".join(map(repr, mesh.sections)) or "none")


def edges_within(mesh, nodes):
    """Boundary edges (n, 2) with both ends among the nodes."""
    inside = np.zeros(mesh.n_nodes, dtype=bool)
    inside[nodes] = True
    return mesh.boundary_edges[inside[mesh.boundary_edges].all(axis=1)]


def ordered(points, nodes, found):
    """The nodes along the chains of directed edges that were found, chain by chain; they follow each other along the longer axis."""
    axis = int(np.argmax(np.ptp(points[nodes], axis=0)))
    found = [_oriented(points, chain, closed) for chain, closed in found]
    found.sort(key=lambda chain: points[chain, axis].min())
    return np.array([node for chain in found for node in chain], dtype=np.int32)


def chains(nodes, edges):
    """(list of nodes connected by the directed edges, whether it closes) for open and closed chains and lone nodes."""
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
    """Area within a closed polygon (n, 2), positive counter-clockwise."""
    x, y = (corner - corner.mean(axis=0)).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _oriented(points, chain, closed):
    """An open chain towards its dominant axis, a closed one counter-clockwise."""
    if closed:
        return chain[::-1] if signed_area(points[chain]) < 0 else chain
    span = points[chain[-1]] - points[chain[0]]
    return chain[::-1] if span[np.argmax(np.abs(span))] < 0 else chain


def _weights(points, lengths, rim):
    """Weights of the section's mean; points in its order."""
    if not lengths.sum() > 0.0:
        return np.full(len(points), 1.0 / len(points))
    weights = lengths / lengths.sum()
    if not rim:
        return weights
    arms = points - points[0]
    arms = arms - weights @ arms
    share = np.linalg.solve((weights[:, None] * arms).T @ arms, centre(arms))
    return weights * (1.0 + arms @ share)


def centre(rim):
    """Centre of a hole, (2,), from the corners of its rim in order: of their circle where four or more are on one, else of its area."""
    middle = rim.mean(axis=0)
    arms = rim - middle
    solution = np.linalg.lstsq(np.column_stack([2.0 * arms, np.ones(len(arms))]), (arms**2).sum(axis=1), rcond=None)[0]
    radii = np.hypot(*(arms - solution[:2]).T)
    if len(rim) >= ON_CIRCLE and np.ptp(radii) <= ROUND * radii.mean():
        return middle + solution[:2]
    return topology.centroids(rim, np.arange(len(rim)), np.array([0, len(rim)]))[0]


def automatic(points, boundary):
    """Sections any mesh has: left, right, top, bottom where boundary edges lie on the bounding box; the rims
    'hole 0', 'hole 1', ... ordered by x, then y."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    near = 1e-9 * float((upper - lower).max()) + 4 * np.finfo(float).eps * float(np.abs(points).max())
    found = {}
    for name, axis, value in (("left", 0, lower), ("right", 0, upper), ("top", 1, upper), ("bottom", 1, lower)):
        on_side = np.abs(points[:, axis] - value[axis]) <= near
        edges = boundary[on_side[boundary].all(axis=1)]
        if len(edges):
            found[name] = np.unique(edges)
    return found | {f"hole {i}": rim for i, rim in enumerate(_rims(points, boundary))}


def _is_rim(points, chain, closed):
    """Whether it is the rim of a hole: around one the boundary runs clockwise."""
    return closed and signed_area(points[chain]) < 0


def _rims(points, boundary):
    """Nodes of the closed boundary chains that run clockwise."""
    rims = [np.array(chain) for chain, closed in chains(np.unique(boundary), boundary) if _is_rim(points, chain, closed)]
    return sorted(rims, key=lambda rim: tuple(np.round(points[rim].mean(axis=0), 9)))
