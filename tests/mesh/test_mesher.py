"""The mesher: areas, topology, convexity, exact boundary, reproducibility."""

import warnings

import numpy as np
import pytest
from scipy.spatial import cKDTree

from polyida.errors import InputError
from polyida.mesh import Circle, Difference, Intersection, Link, Outline, Rectangle, Union, mesher, polygonize, rectangle

SIZES = [(1.0, 0.1, 160), (1.0, 0.1, 2), (1.0, 1.0, 40), (0.1, 1.0, 60), (1.0, 0.005, 80), (2e-3, 1e-3, 30), (3.0, 1.0, 700)]


@pytest.fixture(scope="module", params=SIZES, ids=str)
def plate(request):
    length, height, cells = request.param
    return length, height, cells, rectangle(length, height, cells, seed=3)


class TestRectangle:
    def test_boundary_is_the_rectangle(self, plate):
        length, height, _, mesh = plate
        ends = mesh.points[mesh.boundary_edges]
        assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(2 * (length + height), rel=1e-13)
        assert mesh.points.min(axis=0).tolist() == [0.0, -0.5 * height]
        assert mesh.points.max(axis=0).tolist() == [length, 0.5 * height]

    def test_mirror_image(self, plate):
        points = plate[3].points
        upper, lower = points[points[:, 1] > 0], points[points[:, 1] < 0] * [1, -1]
        assert np.array_equal(upper[np.lexsort(upper.T)], lower[np.lexsort(lower.T)])

    @pytest.mark.parametrize("seed", range(3))
    def test_no_short_edges(self, seed):
        quality = rectangle(1.0, 0.2, 120, seed=seed).quality()
        assert quality.shortest_edge > 0.095 and quality.min_angle > 30.0 and quality.area_ratio > 0.2

    def test_odd_count_is_raised_and_origin_moves(self):
        mesh = rectangle(1.0, 0.1, 7, origin=(2.0, -3.0))
        assert mesh.n_cells == 8
        assert mesh.points.min(axis=0) == pytest.approx([2.0, -3.05]) and "left" in mesh.sections


def square_ring():
    return Difference(Rectangle(3, 3), Rectangle(1, 1, (1, 1)))


def corner_piece():
    return Rectangle(2, 2) - Rectangle(1, 1, (1, 1))


def flag():
    return Union(Rectangle(0.45, 0.02, (-0.05, -0.01)), Circle(0.05, (-0.05, 0.0)))


def link_area(length, height, radius):
    return length * height + np.pi * height**2 / 4 - 2 * np.pi * radius**2


DOMAINS = {  # domain, cells, area, tolerance of the chords, holes
    "circle": (Circle(1.0, (3.0, 1.0)), 150, np.pi, 5e-3, 0),
    "link": (Link(1.0, 0.3, 0.08, (0.5, 0.5)), 200, link_area(1.0, 0.3, 0.08), 5e-3, 2),
    "slender link": (Link(1.0, 0.1, 0.03), 250, link_area(1.0, 0.1, 0.03), 1e-2, 2),
    "plate with a hole": (Rectangle(2, 1) - Circle(0.2, (1, 0.5)), 150, 2 - np.pi * 0.04, 5e-3, 1),
    "square ring": (square_ring(), 150, 8.0, 1e-13, 1),
    "corner piece": (corner_piece(), 100, 3.0, 1e-13, 0),
    "half disc": (Intersection(Rectangle(2, 2, (0, -1)), Circle(1.0)), 100, np.pi / 2, 1e-2, 0),
    "notch": (Rectangle(2, 1) - Circle(0.2, (1, 1)), 100, 2 - np.pi * 0.02, 5e-3, 0),
    "flag": (flag(), 150, None, None, 0),
}


class TestDomains:
    @pytest.mark.parametrize("seed, name", list(enumerate(DOMAINS)))
    def test_mesh_follows_its_domain(self, name, seed):
        domain, cells, area, chords, holes = DOMAINS[name]
        mesh = polygonize(domain, cells, seed=seed)
        mesh.require_convex(1e-4)
        quality = mesh.quality()
        assert (quality.holes, quality.pieces) == (holes, 1) and quality.shortest_edge > 0.05
        assert abs(mesh.n_cells - cells) <= 0.05 * cells
        assert np.abs(domain.distance(mesh.points[mesh.boundary_nodes])).max() < 1e-9
        assert area is None or mesh.area == pytest.approx(area, rel=chords)
        assert [name for name in mesh.sections if name.startswith("hole")] == [f"hole {i}" for i in range(holes)]

    def test_reentrant_corner_is_a_node(self):
        mesh = polygonize(corner_piece(), 80)
        for corner in ([1, 1], [2, 0], [1, 2], [0, 0]):
            assert np.linalg.norm(mesh.points - corner, axis=1).min() < 1e-12

    def test_pin_holes_are_closed_rims_around_the_pins(self):
        mesh = polygonize(Link(1.0, 0.3, 0.08), 200, seed=1)
        for name, center in (("hole 0", (0.0, 0.0)), ("hole 1", (1.0, 0.0))):
            section = mesh.section(name)
            assert np.allclose(np.linalg.norm(mesh.points[section.nodes] - center, axis=1), 0.08, rtol=1e-12)
            assert section.length == pytest.approx(2 * np.pi * 0.08, rel=0.03)

    def test_same_seed_same_mesh_bitwise(self):
        one, two = (polygonize(Link(1.0, 0.3, 0.08), 60, seed=4) for _ in range(2))
        assert one.points.tobytes() == two.points.tobytes()


@pytest.mark.parametrize(
    "make",
    [
        lambda at: Link(1.0, 0.2, 0.04, origin=at),
        lambda at: Rectangle(1.0, 1.0, at) - Circle(0.2, np.add(at, 0.5)),
        lambda at: Rectangle(1.0, 1.0, at) - Rectangle(0.5, 0.5, at),
    ],
)
def test_a_domain_far_away_gives_the_mesh_at_the_origin_moved(make):
    far = np.array([1e6, -1e6])
    near, moved = (polygonize(make(at), 40, seed=1) for at in (np.zeros(2), far))
    assert (moved.n_cells, moved.n_nodes, list(moved.sections)) == (near.n_cells, near.n_nodes, list(near.sections))
    away = cKDTree(near.points).query(moved.points - far)[0]  # numbers of nodes side by side may differ
    assert away.max() < 1e-6, "Lloyd's sweeps amplify the round-off of the walls"


def test_cells_that_are_far_too_few_are_told_by_their_number_and_the_narrowest_place_after_one_attempt(monkeypatch):
    attempts, attempt = [], mesher._require_resolved
    monkeypatch.setattr(mesher, "_require_resolved", lambda *args: attempts.append(args) or attempt(*args))
    teeth = [(x, 0.02 * k + y) for k in range(20) for x, y in ((1.0, 0.0), (1.0, 0.01), (0.95, 0.01), (0.95, 0.02))]
    comb = Outline([(0.0, 0.0), *teeth, (0.0, 0.4)])
    told = r"^polygonize: cells = 60 are too few .* the narrowest of \d+ places .* about 0.0\d* m wide, at \((1|0.95), 0.\d+\)$"
    with warnings.catch_warnings(action="error"), pytest.raises(InputError, match=told):
        polygonize(comb, 60, iterations=3)
    assert len(attempts) == 1


@pytest.mark.parametrize("cells", [30, 200])
def test_rectangles_that_share_a_whole_side_are_one(cells):
    """The side between them is a wall of both, and no part of the boundary."""
    mesh = polygonize(Union(Rectangle(1.0, 1.0), Rectangle(1.0, 1.0, (1.0, 0.0))), cells)
    assert mesh.area == pytest.approx(2.0, rel=1e-12) and mesh.quality().pieces == 1
    assert mesh.sections["right"].size and (mesh.points[mesh.sections["right"], 0] == 2.0).all()


def test_walls_that_continue_each_other_smoothly_need_no_corner():
    """A rounded end: no node lies where the straight sides touch the circle. A cusp is refused still."""
    rounded = Union(Rectangle(1.0, 1.0), Circle(0.5, (1.0, 0.5)))
    lacks = [1.0 + np.pi / 8 - polygonize(rounded, cells).area for cells in (50, 200, 800)]
    assert 0.0 < lacks[2] < 0.4 * lacks[1] < 0.16 * lacks[0] < 0.003
    with pytest.raises(InputError, match="too few"):
        polygonize(Rectangle(1.0, 1.0) - Circle(0.2, (0.5, 0.2)), 200)
