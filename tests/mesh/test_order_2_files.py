"""Abaqus and Gmsh files of order 2 keep their middle nodes, with sets, supports and loads."""

import warnings

import numpy as np
import pytest

import polyida as pi

ABAQUS = """*NODE
1, 0, 0
2, 2, 0
3, 2, 2
4, 0, 2
5, 1, -0.2
6, 2, 1
7, 1, 2
8, 0, 1
9, 4, 1
10, 3, 0.5
11, 3, 1.5
*ELEMENT, TYPE=CPS8R
1, 1, 2, 3, 4, 5, 6, 7, 8
*ELEMENT, TYPE=CPE6
2, 2, 9, 3, 10, 11, 6
*NSET, NSET=bottom edge
1, 5, 2
*BOUNDARY
8, 1, 2
*CLOAD
5, 2, -3.0
"""

GMSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
1 7 "curve"
$EndPhysicalNames
$Nodes
6
1 0 0 0
2 1 0 0
3 0 1 0
4 0.5 0 0
5 0.7071067811865476 0.7071067811865476 0
6 0 0.5 0
$EndNodes
$Elements
2
1 8 2 7 1 2 3 5
2 9 2 1 1 1 2 3 4 5 6
$EndElements
"""


def read(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return pi.mesh.read(tmp_path / name)


def at(mesh, place):
    return int(np.flatnonzero(np.isclose(mesh.points, place).all(axis=1))[0])


def test_abaqus_keeps_middle_nodes_with_sets_supports_and_loads(tmp_path):
    mesh = read(tmp_path, "a.inp", ABAQUS)
    assert mesh.order == 2 and mesh.n_nodes == 11 and sorted(np.diff(mesh.offsets)) == [6, 8]
    assert mesh.area == pytest.approx(6.0 + 2.0 / 3.0 * 0.2 * 2.0)  # the triangle, the square and the segment of a parabola
    low = at(mesh, [1.0, -0.2])
    assert mesh.middle_nodes[low] and low in mesh.sections["bottom edge"]
    assert mesh.loads == {low: (0.0, -3.0)} and mesh.supports == {at(mesh, [0.0, 1.0]): (True, True)}
    assert pi.Plate(mesh, pi.Material(E=1.0, nu=0.3, rho=1.0), thickness=1.0).order == 2


def test_clockwise_cells_are_turned_with_their_middle_nodes(tmp_path):
    text = ABAQUS.replace("1, 1, 2, 3, 4, 5, 6, 7, 8\n*ELEMENT", "1, 1, 4, 3, 2, 8, 7, 6, 5\n*ELEMENT")
    (tmp_path / "a.inp").write_text(text)
    with pytest.warns(pi.mesh.MeshWarning, match="clockwise"):
        mesh = pi.mesh.read(tmp_path / "a.inp")
    assert mesh.order == 2 and mesh.area == pytest.approx(6.0 + 0.8 / 3.0)


def test_gmsh_keeps_curved_sides(tmp_path):
    mesh = read(tmp_path, "a.msh", GMSH)
    assert mesh.order == 2 and mesh.n_nodes == 6 and len(mesh.sections["curve"]) == 3
    assert abs(mesh.area - np.pi / 4) < 0.04 * abs(mesh.linear.area - np.pi / 4)


def test_a_file_of_both_orders_gives_corners_and_says_so(tmp_path):
    mixed = ABAQUS.replace("*ELEMENT, TYPE=CPE6\n2, 2, 9, 3, 10, 11, 6", "*ELEMENT, TYPE=CPS3\n2, 2, 9, 3").split("*BOUNDARY")[0]
    (tmp_path / "a.inp").write_text(mixed)
    with pytest.warns(pi.mesh.MeshWarning, match="became their corners"):
        mesh = pi.mesh.read(tmp_path / "a.inp")
    assert mesh.order == 1 and mesh.n_nodes == 5
