"""The MBB half beam: the published compliance, what the element makes of it, and slopes."""

import numpy as np
import pytest

from mbb_beam import beam, criteria

SQUARES = beam.mesh_of("squares")


def test_optimality_criteria_find_the_published_design():
    rho, history = criteria.optimised(SQUARES, beam.bilinear(SQUARES), 300)
    assert history[0] == pytest.approx(1007.0221, abs=1e-4)
    assert criteria.compliance_at(beam.bilinear(SQUARES), rho)[0] == pytest.approx(233.71, abs=0.01)
    assert rho @ SQUARES.cell_areas == pytest.approx(0.5 * SQUARES.area, rel=1e-6)
    for element, share in (("wachspress", 0.0045), ("virtual", 0.0069)):
        assert criteria.compliance_at(beam.compliance_of(SQUARES, element), rho)[0] == pytest.approx((1.0 + share) * 233.71, rel=1e-4)


def test_wachspress_squares_are_bilinear_ones_with_a_point_a_triangle():
    stiffness = 0.5 + 0.5 * np.cos(SQUARES.cell_centroids @ [0.2, 0.3])
    value, slopes = beam.compliance_of(SQUARES, "wachspress")(stiffness)
    expected, rates = beam.bilinear(SQUARES, beam.FAN)(stiffness)
    assert value == pytest.approx(expected, rel=1e-9) and slopes == pytest.approx(rates, rel=1e-6, abs=1e-9 * np.abs(rates).max())


def test_slopes_on_polygons():
    mesh = beam.mesh_of("polygons", 120)
    compliance = beam.compliance_of(mesh, "virtual")
    rho = 0.5 + 0.3 * np.sin(mesh.cell_centroids @ [0.1, 0.2])
    way = np.cos(mesh.cell_centroids @ [0.3, -0.1])
    (ahead, _), (behind, _) = (criteria.compliance_at(compliance, rho + step * way) for step in (1e-4, -1e-4))
    assert criteria.compliance_at(compliance, rho)[1] @ way == pytest.approx((ahead - behind) / 2e-4, rel=1e-5)
