"""Meshes with smaller cells in chosen places."""

import numpy as np
import pytest

import polyida as pi

PLATE = pi.mesh.Difference(pi.mesh.Rectangle(1.0, 0.4), pi.mesh.Circle(0.08, center=(0.3, 0.2)))


def test_cells_are_small_where_they_are_asked_for():
    mesh = pi.mesh.rectangle(1.0, 0.25, cells=60, seed=1)
    before = mesh.cell_areas.mean()
    for _ in range(3):
        chosen = np.argsort(mesh.cell_centroids[:, 0])[:12]
        mesh = pi.mesh.refine(mesh, chosen)
    x = mesh.cell_centroids[:, 0]
    assert mesh.area == pytest.approx(0.25, rel=1e-12) and mesh.quality().convex
    assert mesh.cell_areas[x < 0.05].mean() < 0.25 * before < 0.8 * before < mesh.cell_areas[x > 0.6].mean()
    assert {"left", "right", "top", "bottom"} <= set(mesh.sections) and len(mesh.sections["left"]) > 12


def test_refined_meshes_do_not_depend_on_the_unit_of_length():
    meshes = [pi.mesh.rectangle(unit, 0.25 * unit, cells=60, seed=1) for unit in (2.0**10, 1.0)]
    large, small = (pi.mesh.refine(mesh, np.argsort(mesh.cell_centroids[:, 0])[:15]) for mesh in meshes)
    assert np.array_equal(large.nodes, small.nodes) and np.allclose(large.points / 2.0**10, small.points, rtol=0.0, atol=1e-9)
    assert large.n_cells == 105


def test_cells_next_to_refined_ones_are_as_regular_as_those_of_a_uniform_mesh():
    """Places of cells are their centroids, weighed by the wanted sizes, not where the seeds began."""
    mesh = pi.mesh.rectangle(1.0, 0.25, cells=120, seed=1)
    finer = pi.mesh.refine(mesh, mesh.cell_centroids[:, 0] < 0.3)
    assert roundness(finer) > 0.99 * roundness(mesh)


def roundness(mesh):
    """Mean of 4 pi area / perimeter^2 over the cells."""
    ends = np.split(mesh.points[mesh.nodes], mesh.offsets[1:-1])
    around = np.array([np.linalg.norm(x - np.roll(x, -1, axis=0), axis=1).sum() for x in ends])
    return float(np.mean(4.0 * np.pi * mesh.cell_areas / around**2))


def test_holes_and_own_sections_stay():
    mesh = pi.mesh.polygonize(PLATE, 100, seed=2)
    lower = np.flatnonzero((mesh.points[:, 1] == 0.0) & (mesh.points[:, 0] < 0.5))
    own = pi.mesh.PolygonMesh(mesh.points, mesh.nodes, mesh.offsets, {**mesh.sections, "foot": lower})
    finer = pi.mesh.refine(own, own.cell_centroids[:, 0] < 0.4)
    assert finer.n_cells > 150 and "hole 0" in finer.sections and finer.quality().holes == 1
    foot = finer.points[finer.sections["foot"]]
    assert np.abs(foot[:, 1]).max() < 1e-15 and foot[:, 0].max() <= own.points[lower, 0].max() + 1e-9 and len(foot) > len(lower)


@pytest.mark.parametrize(("width", "depth"), [(0.1, 0.25), (0.2, 0.3)])
def test_cells_around_the_tip_of_a_notch_are_refined_again_and_again(width, depth):
    """Cells at a corner have the sizes of their neighbours, not of the mean cell."""
    notch = [(0.5 + width / 2, 0.5), (0.5, 0.5 - depth), (0.5 - width / 2, 0.5)]
    mesh = pi.mesh.polygonize(pi.mesh.Outline([(0.0, 0.0), (1.0, 0.0), (1.0, 0.5), *notch, (0.0, 0.5)]), 60, seed=1)
    for _ in range(2):
        cells = mesh.n_cells
        mesh = pi.mesh.refine(mesh, np.argsort(np.linalg.norm(mesh.cell_centroids - notch[1], axis=1))[: cells // 4])
        assert mesh.area == pytest.approx(0.5 - width * depth / 2, rel=1e-12) and mesh.quality().convex
        assert all(np.linalg.norm(mesh.points - place, axis=1).min() < 1e-12 for place in notch)
        assert 1.5 * cells < mesh.n_cells < 2.1 * cells and {"left", "right", "bottom"} <= set(mesh.sections)


@pytest.mark.parametrize("height", [0.014, 0.018])
def test_a_corner_of_an_edge_that_is_nearly_straight_stays(height):
    corners = [(0.0, 0.0), (1.0, height), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0)]
    for cells in (20, 40):
        mesh = pi.mesh.polygonize(pi.mesh.Outline(corners), cells, seed=1)
        for _ in range(2):
            mesh = pi.mesh.refine(mesh, np.arange(0, mesh.n_cells, 4))
            assert mesh.area == pytest.approx(2.0 - height, rel=1e-12)
            assert all(np.linalg.norm(mesh.points - place, axis=1).min() < 1e-12 for place in corners)


def cracked():
    """A square with a crack of no width from its middle to the right."""
    mesh = pi.mesh.quads(1.0, 1.0, 8, 8)
    lips = np.flatnonzero((mesh.points[:, 1] == 0.0) & (mesh.points[:, 0] > 0.5))
    upper = np.arange(mesh.n_nodes)
    upper[lips] = mesh.n_nodes + np.arange(len(lips))
    above = np.repeat(mesh.cell_centroids[:, 1] > 0.0, 4)
    return np.concatenate([mesh.points, mesh.points[lips]]), np.where(above, upper[mesh.nodes], mesh.nodes), mesh.offsets


def in_pieces():
    """Two squares that touch in a corner, and one apart."""
    mesh = pi.mesh.quads(1.0, 1.0, 4, 4)
    kept = [mesh.cell(k) for k, (x, y) in enumerate(mesh.cell_centroids) if (x < 0.5) == (y < 0.0)]
    used, nodes = np.unique(np.concatenate([*kept, mesh.nodes + mesh.n_nodes]), return_inverse=True)
    return np.concatenate([mesh.points, mesh.points + [2.0, 0.0]])[used], nodes, np.arange(0, len(nodes) + 1, 4)


def comb():
    """One cell with teeth."""
    points = [(0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1), (3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)]
    return np.array(points, float), np.arange(12), [0, 12]


@pytest.mark.parametrize("drawn", [cracked, in_pieces, comb])
def test_outlines_that_no_domain_has_are_refined_in_place(drawn):
    points, nodes, offsets = drawn()
    mesh = pi.mesh.PolygonMesh(points, nodes, offsets, {"wall": np.flatnonzero(points[:, 0] == 0.0)})
    area, wall = mesh.area, np.ptp(points[mesh.sections["wall"]], axis=0)
    for _ in range(3):
        cells, pieces = mesh.n_cells, mesh.quality().pieces
        mesh = pi.mesh.refine(mesh, np.arange(0, cells, 3))
        assert mesh.area == pytest.approx(area, rel=1e-12) and mesh.quality().convex and mesh.quality().pieces == pieces
        assert np.allclose(np.ptp(mesh.points[mesh.sections["wall"]], axis=0), wall, atol=1e-12) and mesh.n_cells > 1.3 * cells


def test_a_cracked_mesh_of_which_no_cell_is_chosen_stays():
    mesh = pi.mesh.PolygonMesh(*cracked())
    same = pi.mesh.refine(mesh, np.zeros(mesh.n_cells, bool))
    assert (same.n_cells, same.n_nodes) == (mesh.n_cells, mesh.n_nodes) and same.area == pytest.approx(mesh.area, rel=1e-12)


@pytest.mark.parametrize("cells", [[200], [-1], [0.5], np.zeros(3, bool), "left"])
def test_wrong_cells_are_refused(cells):
    with pytest.raises(pi.InputError, match="refine: cells"):
        pi.mesh.refine(pi.mesh.rectangle(1.0, 0.25, cells=20), cells)
