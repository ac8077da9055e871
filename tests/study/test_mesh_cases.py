"""Meshes and elements against known answers, as the study uses them: coarse, with the error that coarse meshes have."""

import numpy as np
import pytest

from mesh_convergence import cases


@pytest.mark.parametrize("load, error", [(1, 1e-3), (10, 1e-3)])
def test_elastica_on_squares(load, error):
    assert cases.elastica("quads", "wachspress", 2, load)["deviation"] < error


@pytest.mark.parametrize("clamp", ["arc", "straight"])
def test_csm1_extrapolated(clamp):
    coarse, fine = (cases.csm1("quads", "wachspress", n, clamp) for n in (8, 16))
    assert cases.extrapolated(coarse["moved"], fine["moved"], clamp) < 1e-3
    assert fine["deviation"] < coarse["deviation"] / 3


def test_frequencies_of_a_slender_bar():
    found = cases.frequencies("quads", "wachspress", 2)
    assert abs(found["bending_errors"][0]) < 1e-3 and np.abs(found["axial_errors"]).max() < 2e-4


def test_a_section_is_as_stiff_as_the_bar_and_a_node_is_not():
    ratios = [cases.compliance("polygons", "wachspress", n, "node")["compliance"] for n in (2, 4, 8)]
    assert cases.compliance("polygons", "wachspress", 4, "section")["deviation"] < 1e-12
    assert 1.05 < ratios[0] < ratios[1] < ratios[2]


def test_cantilevers_of_all_elements_come_to_the_same():
    known = cases.fine_cantilever(16)
    for kind, element, error in (
        ("polygons", "wachspress", 6e-3),
        ("quads", "virtual", 2e-2),
        ("polygons", "virtual", 2e-2),
        ("triangles", "wachspress", 0.2),
    ):
        assert cases.cantilever(kind, element, 4, known)["deviation"] < error
