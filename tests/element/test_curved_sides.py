"""Quadratic cells with curved sides: measures converge with order 4, the linear patch test stays exact, bad sides are named."""

import warnings
from functools import partial

import numpy as np
import pytest

import polyida as pi
from polyida.element import quadratic as element
from polyida.element.operator import build
from polyida.mesh.mesher import polygonize

quadratic = partial(element.quadratic, tau=0.1)


def ring(cells):
    return polygonize(pi.mesh.Circle(1.0) - pi.mesh.Circle(0.4), cells, order=2)


def disc(cells):
    return polygonize(pi.mesh.Circle(1.0), cells, order=2)


def sector(count):
    """A quarter of a ring between the radii 0.4 and 1, of count x count quads."""
    flat = pi.mesh.quads(1.0, 1.0, count, count, order=2)
    radius, angle = 0.4 + 0.6 * flat.points[:, 0], (flat.points[:, 1] + 0.5) * np.pi / 2
    return pi.mesh.moved(flat, radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))


def test_area_and_mass_of_a_ring_converge_with_order_4():
    errors = []
    for count in (3, 6):
        mesh = sector(count)
        operator = build(mesh, quadratic)
        rows = np.repeat(np.arange(mesh.n_nodes), np.diff(operator.indptr))
        polar = (operator.mass[:, None] * mesh.points[rows] * mesh.points[operator.indices]).sum()
        errors.append([abs(mesh.area - np.pi * 0.21), abs(operator.mass.sum() - np.pi * 0.21), abs(polar - np.pi / 8 * (1.0 - 0.4**4))])
    assert np.log2(np.divide(*errors)) == pytest.approx([4.0, 4.0, 4.0], abs=0.3)


def test_area_of_a_disc_converges_with_order_4():
    meshes = [disc(cells) for cells in (24, 96)]
    sides = [
        np.linalg.norm(mesh.points[mesh.boundary_edges[:, 1]] - mesh.points[mesh.boundary_edges[:, 0]], axis=1).max() for mesh in meshes
    ]
    errors = [abs(mesh.area - np.pi) for mesh in meshes]
    assert errors[1] < abs(meshes[1].linear.area - np.pi) / 100
    assert np.log(errors[0] / errors[1]) / np.log(sides[0] / sides[1]) > 3.5


@pytest.mark.parametrize("mesh_of", [disc, ring])
def test_operator_has_the_measures_of_the_curved_cells(mesh_of):
    mesh = mesh_of(40)
    operator = build(mesh, quadratic)
    assert operator.areas == pytest.approx(mesh.cell_areas, rel=1e-12)
    assert operator.mass.sum() == pytest.approx(mesh.area, rel=1e-13)
    rows = np.repeat(np.arange(mesh.n_nodes), np.diff(operator.indptr))
    first = np.bincount(rows, operator.mass) @ mesh.points
    assert first == pytest.approx(mesh.cell_areas @ mesh.cell_centroids, abs=1e-13)
    x = mesh.points
    polar = (operator.mass[:, None] * x[rows] * x[operator.indices]).sum()
    assert polar == pytest.approx(np.pi / 2 * (1.0 - (0.4**4 if mesh_of is ring else 0.0)), rel=3e-4)


@pytest.mark.parametrize("mesh_of", [disc, ring])
def test_linear_patch_test_is_exact_with_curved_sides(mesh_of):
    mesh = mesh_of(30)
    cells = np.split(mesh.nodes, mesh.offsets[1:-1])
    forces = np.zeros_like(mesh.points)
    for number, cell in enumerate(cells):
        _, _, gradients, weights, *_ = quadratic(mesh.points[cell][:, :, None], np.array([number]), cell[:, None])
        slope = np.einsum("nd,pne->pde", mesh.points[cell], gradients[..., 0])
        assert slope == pytest.approx(np.broadcast_to(np.eye(2), slope.shape), abs=1e-11)
        forces[cell] += np.einsum("p,pnd->nd", weights[:, 0], gradients[..., 0])
    inner = np.setdiff1d(np.arange(mesh.n_nodes), mesh.boundary_nodes)
    assert np.abs(forces[inner]).max() < 1e-12


def test_the_mean_of_a_rim_is_the_centre_of_its_hole():
    hole = pi.mesh.Circle(0.3, center=(0.1, 0.05))
    mesh = polygonize(pi.mesh.Rectangle(2.0, 2.0, origin=(-1.0, -1.0)) - hole, 60, order=2)
    section = mesh.section("hole 0")
    assert section.weights @ mesh.points[section.nodes] == pytest.approx([0.1, 0.05], abs=1e-12)
    assert section.length == pytest.approx(2 * np.pi * 0.3, rel=1e-3)
    assert np.hypot(*(mesh.points[section.nodes] - [0.1, 0.05]).T) == pytest.approx(np.full(len(section.nodes), 0.3), rel=1e-12)


@pytest.mark.parametrize("bump", [0.9, -1.4])
def test_a_side_that_is_curved_too_strongly_names_its_cell(bump):
    mesh = pi.mesh.quads(2.0, 1.0, 2, 1, order=2)
    points = np.array(mesh.points)
    middle = int(np.flatnonzero(np.all(np.isclose(points, [1.5, -0.5]), axis=1))[0])
    points[middle, 1] += bump if bump > 0 else 0.0
    points[middle, 0] += 0.45 if bump < 0 else 0.0
    with pytest.raises(pi.InputError, match="cell"):
        build(pi.mesh.moved(mesh, points), quadratic)


@pytest.mark.parametrize("count, told", [(3, True), (6, False)])
def test_a_thin_arc_of_long_curved_cells_is_said_to_be_too_soft(count, told):
    straight = pi.mesh.quads(3.0, 0.04, count, 1, order=2)
    angle, radius = straight.points[:, 0], 1.0 + straight.points[:, 1]
    points = np.column_stack([radius * np.cos(angle), -radius * np.sin(angle)])
    mesh = pi.mesh.PolygonMesh(points, straight.nodes, straight.offsets, order=2)
    scene = pi.Scene()
    scene.add(pi.Plate(mesh, pi.Material(E=1e6, nu=0.3, rho=1e3), 0.01, name="arc"))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        scene.build()
    assert any(issubclass(one.category, pi.LockingWarning) and "curved sides" in str(one.message) for one in found) == told
