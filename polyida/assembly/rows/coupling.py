"""Which points of a scene are coupled beyond phi_z: by the curvature of rows, by force elements, and each with itself by its mass."""

from typing import NamedTuple

import numpy as np

from polyida.jit import pack


@pack
class Coupling(NamedTuple):
    """Blocks (2, 2) of pairs of points, by rows: those of point p are `start[p]` to `start[p + 1]`, with the points `columns`.

    mirror: the transposed block of each. mass: the block of each point with itself, -1 where it has no mass. products: the blocks (E, F) of
    the products whose vectors both have points, in the order of `joint_curvature`. laws: those of each force element's sides, row by row,
    -1 where a side stays with the ground, from `law_start` on.
    """

    start: np.ndarray
    columns: np.ndarray
    mirror: np.ndarray
    mass: np.ndarray
    products: np.ndarray
    laws: np.ndarray
    law_start: np.ndarray


def coupling_of(links, laws):
    """The Coupling of a scene's links, without their own one, and force elements, Laws or None."""
    vectors = np.split(links.vector_points, links.vector_start[1:-1])
    products = [(a, b) for e, f in zip(links.product_first, links.product_second) for a in vectors[e] for b in vectors[f]]
    sides = [] if laws is None else [laws.points[a:b] for a, b in zip(laws.parts[:-1, 1], laws.parts[1:, 1])]
    pushed = [(a, b) for group in sides for a in group for b in group]
    heavy = [(p, p) for p in np.flatnonzero(links.point_mass)]
    known = {pair for pair in products + pushed + heavy if min(pair) >= 0}
    blocks = sorted(known | {(b, a) for a, b in known})
    number = {pair: block for block, pair in enumerate(blocks)}
    rows, columns = np.array(blocks, np.int64).reshape(-1, 2).T
    count = len(links.point_mass)
    mass = np.full(count, -1, np.int64)
    mass[[p for p, _ in heavy]] = [number[pair] for pair in heavy]
    return Coupling(
        start=np.searchsorted(rows, np.arange(count + 1)).astype(np.int64),
        columns=columns.copy(),
        mirror=np.array([number[b, a] for a, b in blocks], np.int64),
        mass=mass,
        products=np.array([number[pair] for pair in products], np.int64),
        laws=np.array([number.get(pair, -1) for pair in pushed], np.int64),
        law_start=np.concatenate([[0], np.cumsum([len(group) ** 2 for group in sides])]).astype(np.int64),
    )
