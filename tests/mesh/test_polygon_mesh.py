"""PolygonMesh: geometry of small meshes known by hand, sections, and every bad input as one clear message."""

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import Link, PolygonMesh, polygonize, quads, triangles
from polyida.mesh.sections import automatic

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
RING = np.array([[0, 0], [3, 0], [3, 3], [0, 3], [1, 1], [2, 1], [2, 2], [1, 2]], dtype=float)
LINK = polygonize(Link(1.0, 0.2, 0.05), cells=60, seed=2)
RING_NODES = [0, 1, 5, 4, 1, 2, 6, 5, 2, 3, 7, 6, 3, 0, 4, 7]


def ring():
    return PolygonMesh(RING, RING_NODES, [0, 4, 8, 12, 16], {"rim": [4, 5, 6, 7]})


def around(inner, outer):
    """A mesh of quadrilaterals between two rings of as many corners."""
    n = len(inner)
    ahead = np.roll(np.arange(n), -1)
    cells = np.stack([np.arange(n), n + np.arange(n), n + ahead, ahead], axis=1)
    mesh = PolygonMesh(np.vstack([inner, outer]), cells.ravel(), 4 * np.arange(n + 1))
    return PolygonMesh(mesh.points, mesh.nodes, mesh.offsets, automatic(mesh.points, mesh.boundary_edges))


class TestGeometry:
    def test_one_square(self):
        mesh = PolygonMesh(SQUARE, [0, 1, 2, 3], [0, 4])
        assert mesh.area == 1.0 and mesh.n_nodes == 4 and mesh.n_cells == 1
        assert np.allclose(mesh.cell_centroids, 0.5, atol=1e-15)
        assert len(mesh.edges) == len(mesh.boundary_edges) == 4

    def test_boundary_has_the_domain_on_its_left(self):
        mesh = ring()
        a, b = mesh.points[mesh.boundary_edges].transpose(1, 0, 2)
        enclosed = 0.5 * np.sum(a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1])
        assert enclosed == pytest.approx(mesh.area) == pytest.approx(8.0)

    def test_ring_has_one_hole_and_is_convex(self):
        quality = ring().quality()
        assert (quality.holes, quality.pieces, quality.convex) == (1, 1, True)
        assert quality.min_angle == pytest.approx(45.0) and quality.max_angle == pytest.approx(135.0)


class TestStructured:
    @pytest.mark.parametrize("make, corners", [(quads, 4), (triangles, 3)])
    @pytest.mark.parametrize("nx, ny", [(1, 1), (6, 2), (2, 5)])
    def test_count_area_and_sections(self, make, corners, nx, ny):
        mesh = make(2.0, 0.5, nx, ny)
        assert mesh.n_cells == nx * ny * (1 if corners == 4 else 2)
        assert mesh.area == pytest.approx(1.0, rel=1e-14)
        assert {name: len(nodes) for name, nodes in mesh.sections.items()} == {
            "left": ny + 1,
            "right": ny + 1,
            "top": nx + 1,
            "bottom": nx + 1,
        }
        assert mesh.quality().half_bandwidth <= min(nx, ny) + 2
        mesh.require_convex()

    def test_even_ny_has_exact_mid_nodes(self):
        mesh = quads(0.3, 0.1, 7, 6)
        for x in (0.0, 0.3):
            assert (mesh.points == [x, 0.0]).all(axis=1).sum() == 1


class TestSections:
    def test_open_section_runs_upwards_with_tributary_lengths(self):
        section = quads(1.0, 0.4, 4, 4).section("left")
        mesh = quads(1.0, 0.4, 4, 4)
        assert (np.diff(mesh.points[section.nodes, 1]) > 0).all()
        assert np.allclose(section.lengths, [0.05, 0.1, 0.1, 0.1, 0.05]) and section.name == "left"
        assert section.weights.sum() == pytest.approx(1.0, rel=1e-15)

    def test_closed_section_runs_counter_clockwise(self):
        section = ring().section("rim")
        corner = RING[section.nodes]
        x, y = corner.T
        assert 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) == pytest.approx(1.0)
        assert section.length == pytest.approx(4.0)

    @pytest.mark.parametrize("corners", [4, 5, 12])
    def test_the_rim_of_a_hole_has_the_centre_of_its_circle(self, corners):
        angles = np.sort(np.random.default_rng(corners).uniform(0.0, 2 * np.pi, corners))
        inner = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        mesh = around(0.2 * inner + [3.0, -2.0], 0.5 * inner + [3.0, -2.0])
        section = mesh.section("hole 0")
        places = mesh.points[section.nodes]
        assert section.weights.sum() == pytest.approx(1.0, abs=1e-14)
        assert np.allclose(section.weights @ places, [3.0, -2.0], atol=1e-14)
        assert np.abs(section.lengths @ places / section.length - [3.0, -2.0]).max() > 1e-4

    def test_the_change_of_its_weights_is_the_least_in_parts_of_themselves(self):
        section = LINK.section("hole 0")
        parts, places = section.weights / section.lengths, LINK.points[section.nodes]
        linear = np.column_stack([places, np.ones(len(places))])  # of all changes with this sum and mean: the stationary one
        assert np.allclose(linear @ np.linalg.lstsq(linear, parts, rcond=None)[0], parts, rtol=1e-12)

    def test_the_rim_of_any_other_hole_has_the_centroid_of_its_area(self):
        ell = np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 2], [0, 2]], float)
        mesh = around(ell, 3 * ell - 1.0)
        section = mesh.section("hole 0")
        assert np.allclose(section.weights @ mesh.points[section.nodes], [(3 * 1.5 + 0.5) / 4, (3 * 0.5 + 1.5) / 4], atol=1e-14)

    def test_open_sections_and_outer_boundaries_keep_their_lengths(self):
        for selector in ("left", np.unique(quads(2.0, 1.0, 3, 2).boundary_edges)):
            section = quads(2.0, 1.0, 3, 2).section(selector)
            assert np.array_equal(section.weights, section.lengths / section.length)

    def test_two_chains_follow_each_other(self):
        mesh = quads(3.0, 1.0, 3, 1)
        section = mesh.section(lambda p: (p[:, 1] > 0) & (np.abs(p[:, 0] - 1.5) > 0.2))
        assert (np.diff(mesh.points[section.nodes, 0]) > 0).all()


class TestBadInput:
    @pytest.mark.parametrize(
        "points, nodes, offsets, message",
        [
            (SQUARE, [0, 3, 2, 1], [0, 4], "cell 0.*counter-clockwise"),
            (SQUARE, [0, 1, 2, 4], [0, 4], "cell 0 names node 4.*0..3"),
            (SQUARE, [0, 1, 2, -1], [0, 4], "names node -1"),
            (SQUARE, [0, 1], [0, 2], "cell 0 has 2 corners"),
            (SQUARE, [0, 1, 2], [0, 3], "node 3.*belongs to no cell"),
            (SQUARE, [0, 1, 2, 3, 0], [0, 5], "node 0 as two of its corners"),
            (SQUARE, [0, 1, 2, 3], [0, 3], "offsets"),
            (SQUARE, [0, 1, 2, 3], [], "offsets"),
            (SQUARE, [0.0, 1.0, 2.0, 3.0], [0, 4], "integers"),
            (SQUARE, [0, 1, 2, 2**40], [0, 4], "32 bit"),
            (SQUARE * [1, np.nan], [0, 1, 2, 3], [0, 4], "point 0 is"),
            (SQUARE + [0, np.inf], [0, 1, 2, 3], [0, 4], "finite"),
            (np.c_[SQUARE, SQUARE], [0, 1, 2, 3], [0, 4], "shape"),
            ("points", [0, 1, 2, 3], [0, 4], "points"),
            (SQUARE * 1e200, [0, 1, 2, 3], [0, 4], "up to 1e"),
            (SQUARE * [1, 0], [0, 1, 2, 3], [0, 4], "area"),
            (SQUARE, [0, 1, 2, 3, 0, 1, 2, 3], [0, 4, 8], "same side of the edge"),
            (np.array([[0, 0], [4, 0], [4, 3], [2, -1], [0, 3.0]]), [0, 1, 2, 3, 4], [0, 5], "crosses"),
        ],
    )
    def test_message_names_the_place(self, points, nodes, offsets, message):
        with pytest.raises(InputError, match=message):
            PolygonMesh(points, nodes, offsets)

    def test_non_convex_cell_is_a_mesh_but_not_convex(self):
        mesh = PolygonMesh([[0, 0], [2, 0], [2, 2], [1.5, 0.5]], [0, 1, 2, 3], [0, 4])
        with pytest.raises(InputError, match="cell 0 at .* not strictly convex.*node 3"):
            mesh.require_convex()
        assert not mesh.quality().convex

    @pytest.mark.parametrize("nodes, message", [([9], "0..3"), ([], "no nodes"), ([0, 0], "twice"), ("ab", "integers")])
    def test_bad_sections(self, nodes, message):
        with pytest.raises(InputError, match=message):
            PolygonMesh(SQUARE, [0, 1, 2, 3], [0, 4], {"grip": nodes})


def square(x=0.0, y=0.0, side=1.0):
    return np.add((x, y), side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))


def apart(*cells):
    """Cells that share no node."""
    return np.concatenate(cells), np.arange(4 * len(cells)), np.arange(0, 4 * len(cells) + 1, 4)


def winding_strip(turn, cells=16):
    """One row of cells around the origin by `turn` rad."""
    angle = np.linspace(0.0, turn, cells + 1)
    ray = np.column_stack([np.cos(angle), np.sin(angle)])
    k = np.arange(cells)
    corners = np.stack([k, k + cells + 1, k + cells + 2, k + 1], axis=1)
    return np.concatenate([ray, 2 * ray]), corners.ravel(), np.arange(0, 4 * cells + 1, 4)


@pytest.mark.parametrize("far", [0.0, 1e6])
class TestOverlap:
    @pytest.mark.parametrize(
        "given",
        [
            apart(square(), square(0.7, 0.4)),
            apart(square(), square()),
            apart(square(), square(0.25, 0.25, 0.5)),
            apart(square(), square(0.5, 0.0)),
            apart(square(), square(1.5), square(0.999, 0.5)),
            winding_strip(6.5),
            winding_strip(12.0),
        ],
        ids=["corner", "twice", "inside", "half", "a little", "around", "around twice"],
    )
    def test_cells_that_share_no_edge_but_lie_on_each_other_are_named(self, given, far):
        points, nodes, offsets = given
        with pytest.raises(InputError, match=r"cell \d+ at \(.*\) and cell \d+ at \(.*\) overlap") as error:
            PolygonMesh(points + [far, -far], nodes, offsets)
        first, second = (int(word.split()[0]) for word in str(error.value).split("cell ")[1:3])
        assert first != second

    @pytest.mark.parametrize(
        "given",
        [apart(square(), square(1.0), square(0.5, 1.0)), apart(square(), square(1.0, 1.0), square(-3.0, 0.3, 2.0)), winding_strip(6.2)],
        ids=["touching", "at a corner", "around"],
    )
    def test_parts_that_touch_are_welcome(self, given, far):
        points, nodes, offsets = given
        assert PolygonMesh(points + [far, -far], nodes, offsets).quality().pieces in (1, 3)
