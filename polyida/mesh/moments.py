"""Area integrals of a mesh, exact for its polygons."""

from polyida.mesh import topology


def area_moments(mesh):
    """(area, m^2, centroid (2,), m, polar second moment about the centroid, m^4) of all cells.

    For a polygon of corners x_i, c_i = x_i cross x_(i + 1): `A = sum c_i / 2`, `A x_S = sum c_i (x_i + x_(i + 1)) / 6`,
    `J = sum c_i (x_i . x_i + x_i . x_(i + 1) + x_(i + 1) . x_(i + 1)) / 12`, each about the mesh's mean point, so that nothing cancels.
    """
    centre = mesh.points.mean(axis=0)
    x = mesh.points[mesh.nodes] - centre
    y = x[topology.following(mesh.offsets)]
    across = topology.cross(x, y)
    area = across.sum() / 2
    first = across @ (x + y) / 6
    second = across @ ((x * x).sum(axis=1) + (x * y).sum(axis=1) + (y * y).sum(axis=1)) / 12
    return float(area), centre + first / area, float(second - first @ first / area)
