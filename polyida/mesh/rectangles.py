"""Meshes of a plate 0 <= x <= length, |y| <= height/2: mirrored polygons, structured quads and triangles."""

import numpy as np
from numpy.typing import ArrayLike

from polyida.mesh import mesher
from polyida.mesh.domains import Rectangle, place, positive
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.topology import renumber, sorted_cells
from polyida.validation import named_keywords


@named_keywords
def rectangle(length: float, height: float, cells: int, seed: int = 0, iterations: int = 40, origin: ArrayLike = (0.0, 0.0)) -> PolygonMesh:
    """Polygon mesh of 0 <= x <= length, -height/2 <= y <= height/2 (m), moved by origin.

    Half the plate is meshed and mirrored about y = 0: the corners and the mid nodes (0, 0) and (length, 0) are exact.
    cells: number of polygons, an odd number is raised by one; seed: the same seed gives the same mesh, bit by bit;
    iterations: at most so many Lloyd sweeps. Sections left, right, top, bottom. Raises InputError for bad values.
    """
    length, height = positive(length, "rectangle length"), positive(height, "rectangle height")
    cells, seed = mesher.whole(cells, "rectangle cells", 1), mesher.whole(seed, "rectangle seed", 0)
    iterations, origin = mesher.whole(iterations, "rectangle iterations", 1), place(origin, "rectangle origin")
    half = mesher.raw_polygons(Rectangle(length, 0.5 * height), (cells + 1) // 2, seed, iterations)
    points, nodes, offsets, _ = renumber(*mirrored(half.points, half.nodes, half.offsets))
    return PolygonMesh(points + origin, nodes, offsets, sides(points, length, height))


def mirrored(points, nodes, offsets):
    """(points, nodes, offsets) with the image about y = 0 added; nodes on y = 0 are shared by both halves."""
    off_axis = np.flatnonzero(points[:, 1] != 0.0)
    image = np.arange(len(points))
    image[off_axis] = len(points) + np.arange(len(off_axis))
    points = np.concatenate([points, points[off_axis] * [1.0, -1.0]])
    back = image[nodes[::-1]]
    sizes = np.diff(offsets)
    return points, np.concatenate([nodes, back]), np.concatenate([[0], np.cumsum(np.r_[sizes, sizes[::-1]])])


def sides(points, length, height):
    """Sections left, right, top, bottom of a plate on 0 <= x <= length, |y| <= height/2; coordinates are exact."""
    x, y = points.T
    masks = {"left": x == 0.0, "right": x == length, "top": y == 0.5 * height, "bottom": y == -0.5 * height}
    return {name: np.flatnonzero(mask) for name, mask in masks.items()}


@named_keywords
def quads(length: float, height: float, nx: int, ny: int, origin: ArrayLike = (0.0, 0.0)) -> PolygonMesh:
    """nx by ny equal quadrilaterals on the plate of rectangle(), with the same sections."""
    points, lower_left, step_x, step_y = _grid(length, height, nx, ny)
    corners = np.stack([lower_left, lower_left + step_x, lower_left + step_x + step_y, lower_left + step_y], axis=1)
    return _structured(points, corners, length, height, origin)


@named_keywords
def triangles(length: float, height: float, nx: int, ny: int, origin: ArrayLike = (0.0, 0.0)) -> PolygonMesh:
    """nx by ny equal rectangles on the plate of rectangle(), each cut in two by alternating diagonals."""
    points, a, step_x, step_y = _grid(length, height, nx, ny)
    b, c, d = a + step_x, a + step_x + step_y, a + step_y
    i, j = np.divmod(np.arange(len(a)), ny) if step_x >= step_y else np.divmod(np.arange(len(a)), nx)
    even = ((i + j) % 2 == 0)[:, None, None]
    up, down = np.stack([a, b, c, a, c, d], axis=1), np.stack([a, b, d, b, c, d], axis=1)
    corners = np.where(even, up.reshape(-1, 2, 3), down.reshape(-1, 2, 3)).reshape(-1, 3)
    return _structured(points, corners, length, height, origin)


def _grid(length, height, nx, ny):
    """Points numbered across the shorter direction first, lower left node of each cell, node steps in x and y."""
    length, height = positive(length, "plate length"), positive(height, "plate height")
    nx, ny = mesher.whole(nx, "plate nx", 1), mesher.whole(ny, "plate ny", 1)
    x, y = np.meshgrid(length * (np.arange(nx + 1) / nx), height * (np.arange(ny + 1) / ny - 0.5), indexing="ij")
    number = np.arange(x.size).reshape(x.shape)
    if ny > nx:
        x, y, number = x.T, y.T, np.arange(x.size).reshape(ny + 1, nx + 1).T
    cells = number[:-1, :-1] if ny <= nx else number[:-1, :-1].T
    return np.stack([x.ravel(), y.ravel()], axis=1), cells.ravel(), int(number[1, 0]), int(number[0, 1])


def _structured(points, corners, length, height, origin):
    offsets = np.arange(0, corners.size + 1, corners.shape[1])
    section = sides(points, float(length), float(height))
    nodes, offsets = sorted_cells(corners.ravel(), offsets)
    return PolygonMesh(points + place(origin, "plate origin"), nodes, offsets, section)
