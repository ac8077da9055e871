import numpy as np
import pytest

from polyida.element.elements import wachspress
from polyida.errors import InputError


def cell_gradients(op):
    """Gradients and weights of every cell, unpacked: lists of (p, n, 2) and (p,), the last corner's restored."""
    from polyida.jit.intrinsics import LANES

    gradients, weights = [None] * op.n_cells, [None] * op.n_cells
    for b, (n, p, corner, g, w, _) in enumerate(op.layout):
        block = op.gradients[g : g + p * (n - 1) * 2 * LANES].reshape(p, n - 1, 2, LANES)
        for k in range(LANES):
            cell = op.lane_cells[b * LANES + k]
            area = op.weights[w : w + p * LANES].reshape(p, LANES)[:, k]
            assert (
                op.corners[corner : corner + n * LANES].reshape(n, LANES)[:, k] == op.nodes[op.offsets[cell] : op.offsets[cell + 1]]
            ).all()
            if area.any():
                own = block[..., k]
                gradients[cell] = np.concatenate([own, -own.sum(axis=1, keepdims=True)], axis=1)
                weights[cell] = area
    return gradients, weights


def test_gradients_reproduce_linear_fields_at_every_point(meshes):
    shape = meshes.mixed()
    op = wachspress(shape)
    assert {3, 4, 5, 6, 7, 8} <= set(np.diff(op.offsets))
    for cell, (gradients, weights) in enumerate(zip(*cell_gradients(op))):
        corners = shape.points[op.nodes[op.offsets[cell] : op.offsets[cell + 1]]]
        assert len(weights) == (1 if len(corners) == 3 else len(corners))
        identity = np.einsum("nd,pne->pde", corners - corners[0], gradients)
        assert abs(identity - np.eye(2)).max() < 1e-13
        assert weights.sum() == pytest.approx(op.areas[cell], rel=1e-14)
        mean = np.einsum("p,pnd->nd", weights, gradients) / op.areas[cell]
        exact = op.mean_gradients[op.offsets[cell] : op.offsets[cell + 1]]
        assert abs(mean - exact).max() < 1e-13 * abs(exact).max()


def test_square_gradients_are_those_of_the_bilinear_element(meshes):
    square = meshes.mesh([[0, 0], [2, 0], [2, 2], [0, 2]], [[0, 1, 2, 3]])
    gradients, _ = cell_gradients(wachspress(square))
    x, y = 1.0, 1 / 3
    bilinear = np.array([[y - 2, x - 2], [2 - y, -x], [y, x], [-y, 2 - x]]) / 4
    assert abs(gradients[0][0] - bilinear).max() < 1e-14


def dense_mass(op):
    dense = np.zeros((op.n_nodes, op.n_nodes))
    dense[np.repeat(np.arange(op.n_nodes), np.diff(op.indptr)), op.indices] = op.mass
    return dense


def test_mass_is_exact_for_rigid_bodies_and_positive(meshes):
    length, height = 1.0, 0.7
    shape = meshes.mixed(length, height, seed=9)
    mass = dense_mass(wachspress(shape))
    x, y = (shape.points - [length / 2, height / 2]).T
    assert mass.sum() == pytest.approx(length * height, rel=1e-13)
    assert abs(mass @ x).sum() > 0 and abs(x @ mass.sum(axis=0)) < 1e-15
    assert x @ mass @ x + y @ mass @ y == pytest.approx(length * height * (length**2 + height**2) / 12, rel=1e-12)
    assert abs(mass - mass.T).max() < 1e-17
    assert np.linalg.eigvalsh(mass)[0] > 0


def test_triangle_mass_is_the_textbook_one(meshes):
    mass = dense_mass(wachspress(meshes.polygon(3)))
    area = wachspress(meshes.polygon(3)).areas[0]
    assert abs(mass - area / 12 * (np.ones((3, 3)) + np.eye(3))).max() < 1e-15


def test_reentrant_corner_is_named(meshes):
    arrow = meshes.mesh([[0, 0], [2, 0], [1, 0.5], [1, 2], [3, 0], [4, 1]], [[1, 4, 5], [0, 1, 2, 3]])
    with pytest.raises(InputError, match=r"cell 1: corner 2 \(node 2\).*convex"):
        wachspress(arrow)
