"""Outlines of meshes: closed rings with holes, and drawings that read as the same domain."""

import numpy as np
import pytest

import polyida as pi
from polyida.mesh.sections import signed_area


def plate_with_holes():
    """Cells of a grid without some of them."""
    mesh = pi.mesh.quads(5.0, 4.0, 5, 4, origin=(0.0, 2.0))
    x, y = np.floor(mesh.cell_centroids).astype(int).T
    rho = 1.0 - ((x == 1) & (y == 1)) - ((x == 3) & ((y == 1) | (y == 2)))
    return pi.design.threshold(mesh, rho)


def test_rings_are_closed_and_have_the_mesh_on_their_left():
    mesh = plate_with_holes()
    rings = pi.mesh.outline_of(mesh)
    assert [round(signed_area(ring), 12) for ring in rings] == [20.0, -2.0, -1.0]
    assert sum(signed_area(ring) for ring in rings) == pytest.approx(mesh.area, rel=1e-13)
    assert [len(ring) for ring in rings] == [4, 4, 4]


def test_cells_that_meet_in_a_corner_have_rings_of_their_own():
    mesh = pi.mesh.PolygonMesh(
        np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 1], [2, 2], [1, 2]], float), [0, 1, 2, 3, 2, 4, 5, 6], [0, 4, 8]
    )
    assert [round(signed_area(ring), 12) for ring in pi.mesh.outline_of(mesh)] == [1.0, 1.0]


@pytest.mark.parametrize("ending", ["svg", "dxf"])
def test_drawings_read_as_the_same_outline(ending, tmp_path):
    mesh, path = plate_with_holes(), tmp_path / f"plate.{ending}"
    pi.mesh.write_outline(mesh, path)
    again = pi.mesh.read_outline(path)
    cells = pi.mesh.polygonize(again, 60)
    assert cells.area == pytest.approx(17.0, rel=1e-9)


@pytest.mark.parametrize("ending", ["svg", "dxf"])
def test_drawings_replace_no_file_unless_told(ending, tmp_path):
    path = tmp_path / f"plate.{ending}"
    path.write_text("mine")
    with pytest.raises(pi.InputError, match="exists; pass overwrite=True"):
        pi.mesh.write_outline(plate_with_holes(), path)
    assert path.read_text() == "mine"
    pi.mesh.write_outline(plate_with_holes(), path, overwrite=True)
    assert pi.mesh.read_outline(path) and list(tmp_path.iterdir()) == [path]
    with pytest.raises(pi.InputError, match="cannot be written: No such file"):
        pi.mesh.write_outline(plate_with_holes(), tmp_path / "absent" / path.name)


def test_wrong_endings_and_units(tmp_path):
    with pytest.raises(pi.InputError, match="must end in .svg or .dxf"):
        pi.mesh.write_outline(plate_with_holes(), tmp_path / "plate.stl")
    with pytest.raises(pi.InputError, match="unit = 'inch' must be one of m, cm, mm"):
        pi.mesh.write_outline(plate_with_holes(), tmp_path / "plate.svg", "inch")
