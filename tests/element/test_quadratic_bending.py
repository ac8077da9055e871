"""How quadratic cells bend that are long and curved, or a single layer: figures of the guide and of `Plate.tau`."""

import warnings

import numpy as np
import pytest

import polyida as pi
from polyida.element.locking import bending_stiffness

STEEL = pi.Material(E=2e11, nu=0.3, rho=7800.0)
HEIGHT = 0.04  # m, of a ring of radius 1 m


def ring(count):
    """One layer of curved quadrilaterals around a circle."""
    strip = pi.mesh.quads(2.0 * np.pi, HEIGHT, count, 1, order=2)
    angle, radius = strip.points[:, 0], 1.0 - strip.points[:, 1]
    points = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    _, first, same = np.unique(points.round(9), axis=0, return_index=True, return_inverse=True)
    return pi.mesh.PolygonMesh(points[first], same.ravel()[strip.nodes], strip.offsets, order=2)


def frequencies(plate, count):
    """Those of the free plate without its rigid motions, Hz."""
    scene = pi.Scene(gravity=(0.0, 0.0))
    scene.add(plate)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pi.LockingWarning)
        return pi.modes(scene.build(), count=3 + count).frequencies[3:]


@pytest.mark.parametrize(
    "count, curved, straight", [(6, 0.80, 1.28), (8, 0.93, 1.11), (10, 0.99, 1.06), (16, 1.00, 1.02), (48, 0.99, 1.00)]
)
def test_lowest_frequency_of_a_thin_ring(count, curved, straight):
    thin = np.sqrt(36.0 / 5.0 * STEEL.E * HEIGHT**2 / 12.0 / STEEL.rho) / (2.0 * np.pi)
    mesh = ring(count)
    plate = pi.Plate(mesh, STEEL, 0.01, name="ring")
    found = frequencies(plate, 1)[0] / thin
    assert found == pytest.approx(curved, abs=0.01)
    assert frequencies(pi.Plate(mesh.linear, STEEL, 0.01, order=2, name="ring"), 1)[0] / thin == pytest.approx(straight, abs=0.01)
    assert bending_stiffness(plate) == pytest.approx(found**2, abs=0.15)


@pytest.mark.parametrize("height", [0.04, 0.01])
@pytest.mark.parametrize("count, within", [(3, 0.08), (4, 0.03), (8, 0.01)])
def test_a_quarter_of_a_thin_ring_bends_by_an_end_force(count, within, height):
    """Castigliano: a radial force F moves the end of a clamped quarter by pi F R^3 / (4 E I) in its direction."""
    strip = pi.mesh.quads(np.pi / 2.0, height, count, 1, order=2)
    angle, radius = strip.points[:, 0], 1.0 - strip.points[:, 1]
    mesh = pi.mesh.moved(strip, radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
    scene = pi.Scene(gravity=(0.0, 0.0))
    plate = scene.add(pi.Plate(mesh, STEEL, 0.01, name="quarter"))
    scene.add(pi.Clamp(plate.section("left"), name="clamp"))
    end = plate.section("right")
    force = 1e-6 * STEEL.E * 0.01 * height**3
    scene.add(pi.PointLoad(end, (0.0, force), name="force"))
    moved = end.weights @ pi.static(scene.build()).q.reshape(-1, 2)[end.nodes][:, 1]
    assert moved / (np.pi / 4.0 * force / (STEEL.E * 0.01 * height**3 / 12.0)) == pytest.approx(1.0, abs=within)


@pytest.mark.parametrize("tau, lower", [(0.05, 0.115), (0.1, 0.045), (0.2, 0.003)])
def test_third_frequency_of_a_free_beam_of_one_layer(tau, lower):
    fine = frequencies(pi.Plate(pi.mesh.quads(1.0, 0.05, 40, 4), STEEL, 0.01, order=2, name="beam"), 3)[2]
    coarse = frequencies(pi.Plate(pi.mesh.quads(1.0, 0.05, 10, 1), STEEL, 0.01, order=2, tau=tau, name="beam"), 3)[2]
    assert 1.0 - coarse / fine == pytest.approx(lower, abs=0.003)
    polygons = frequencies(pi.Plate(pi.mesh.rectangle(1.0, 0.05, cells=30, seed=1), STEEL, 0.01, order=2, tau=tau, name="beam"), 3)[2]
    assert polygons == pytest.approx(fine, rel=0.005)
