"""Abaqus files as its users have them: parts, sets, supports and loads, quadratic elements, and errors by the line."""

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import MeshWarning, read

PART = """*Heading
** made by hand
*Part, name=PLATE
*Node
1, 0., 0.
2, 1., 0.
3, 2., 0.
11, 0., 1.
12, 1., 1.
13, 2., 1.
*Element, type=CPS4R, elset=ALL
1, 1, 2, 12, 11
*Element, type=CPE3
2, 2, 3,
13
3, 2, 13, 12
*Nset, nset=Root, generate
1, 11, 10
*Nset, nset="Free End"
3, 13
*Nset, nset=BOTH
Root, "Free End"
*End Part
"""
ASSEMBLY = """*Assembly, name=A
*Instance, name=PLATE-1, part=PLATE
*End Instance
*Node
1, 9., 9.
*Nset, nset=REFERENCE
1
*Nset, nset=Tip, instance=PLATE-1
13,
*End Assembly
*Material, name=Steel
*Elastic
210000., 0.3
*Boundary
Root, ENCASTRE
PLATE-1.Tip, 2, 2
*Step
*Static
0.1, 1.
*Cload
Tip, 1, 3.
13, 2, -0.5
REFERENCE, 1, 7.
3, 6, 1.
*End Step
"""


@pytest.fixture
def inp(tmp_path):
    def written(text):
        (tmp_path / "plate.inp").write_text(text)
        return tmp_path / "plate.inp"

    return written


def places(mesh, name):
    return sorted(mesh.points[mesh.sections[name]].tolist())


def test_a_part_with_its_sets(inp):
    mesh = read(inp(PART))
    assert mesh.n_cells == 3 and mesh.area == 2.0 and mesh.n_nodes == 6
    assert places(mesh, "Root") == [[0, 0], [0, 1]] and places(mesh, "Free End") == [[2, 0], [2, 1]]
    assert places(mesh, "BOTH") == [[0, 0], [0, 1], [2, 0], [2, 1]]


def test_an_assembly_with_supports_and_loads(inp):
    left = "'REFERENCE', which no .NSET before it gives; the load on '3' in direction 6 was left out"
    with pytest.warns(MeshWarning, match=left):
        mesh = read(inp(PART + ASSEMBLY))
    assert places(mesh, "Tip") == places(mesh, "load") == [[2, 1]] and mesh.n_nodes == 6
    supports = {tuple(mesh.points[node]): fixed for node, fixed in mesh.supports.items()}
    assert supports == {(0, 0): (True, True), (0, 1): (True, True), (2, 1): (False, True)}
    assert list(mesh.loads.values()) == [(3.0, -0.5)]


def test_a_node_in_two_sets_is_loaded_once_by_their_union(inp):
    union = '*Nset, nset=Both\nRoot, "Free End"\n*Nset, nset=Low\n1, 3\n*Nset, nset=Both\nLow\n*Cload\nBoth, 1, 2.\n3, 1, 1.\n'
    mesh = read(inp(PART.replace('*Nset, nset=BOTH\nRoot, "Free End"\n', union)))
    assert {tuple(mesh.points[node]): force[0] for node, force in mesh.loads.items()} == {
        (0, 0): 2.0,
        (0, 1): 2.0,
        (2, 0): 3.0,
        (2, 1): 2.0,
    }


def test_a_load_on_a_middle_node_is_refused_with_its_place(inp):
    """Numbers of a file are not those of its points in their order."""
    loaded = "*Node\n20, 0.5, 0.\n*Cload\n20, 2, -1.\n*End Part"
    with pytest.raises(InputError, match=r"loads name point 6 at \[0.5, 0.0\], which is no corner of a cell"):
        read(inp(PART.replace("*End Part", loaded)))


def test_a_section_of_middle_nodes_is_said_to_be_left_out(inp):
    with pytest.warns(MeshWarning, match="left out section 'Middle', of which no point is a corner of a cell"):
        mesh = read(inp(PART.replace("*End Part", "*Node\n20, 0.5, 0.\n*Nset, nset=Middle\n20\n*End Part")))
    assert "Middle" not in mesh.sections


@pytest.mark.parametrize("kind, corners", [("CPS6M", 3), ("S8R", 4), ("M3D9", 4)])
@pytest.mark.filterwarnings("ignore::polyida.mesh.MeshWarning")
def test_quadratic_elements_keep_their_middle_nodes(inp, kind, corners):
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])[:corners]
    middle = 0.5 * (square + np.roll(square, -1, axis=0)) + 0.01
    points = np.concatenate([square, middle, [[0.5, 0.5]]])[: int(kind[-2] if kind[-1] in "MR" else kind[-1])]
    rows = [f"{i}, {x}, {y}, 0." for i, (x, y) in enumerate(points, 1)]
    element = "1, " + ", ".join(str(i + 1) for i in range(len(points)))
    mesh = read(inp("\n".join(["*NODE", *rows, f"*ELEMENT, TYPE={kind}", element])))
    assert mesh.order == 2 and mesh.n_nodes == 2 * corners and mesh.linear.area == pytest.approx(0.5 if corners == 3 else 1.0)
    assert mesh.points[mesh.middle_nodes] == pytest.approx(mesh.points[mesh.nodes[1::2]][np.argsort(mesh.nodes[1::2])])


def test_sets_of_lines_are_sections_and_those_of_cells_are_not(inp):
    extra = "*Element, type=T3D2, elset=Line4\n7, 1, 2\n*Element, type=MASS\n8, 3\n*Elset, elset=edge\n7, 8\n*Elset, elset=body\n1, 2\n*End Part"
    with pytest.warns(MeshWarning, match="left out the elements of type MASS"):
        mesh = read(inp(PART.replace("*End Part", extra)))
    assert mesh.n_cells == 3 and places(mesh, "Line4") == [[0, 0], [1, 0]] and places(mesh, "edge") == [[0, 0], [1, 0], [2, 0]]
    assert "body" not in mesh.sections and "ALL" not in mesh.sections


def test_a_keyword_goes_on_in_the_next_lines(inp):
    mesh = read(inp(PART.replace("*Nset, nset=Root, generate", "*Nset,\nnset=Root,\ngenerate")))
    assert places(mesh, "Root") == [[0, 0], [0, 1]]


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("1, 1, 2, 12, 11", "1, 1, 2, 12, 99", r"\*ELEMENT in line 11: element 1 names node 99, which no \*NODE"),
        ("1, 1, 2, 12, 11", "1, 1, 2, 12", r"line 11: elements of type CPS4R have a number and 4 nodes; 4 numbers"),
        ("CPS4R", "C3D4", "line 11: holds cells of type C3D4"),
        ("CPS4R", "", "cells of type none"),
        ("3, 2., 0.", "3, 2., zero", "line 4: could not convert string to float: 'zero'"),
        ("3, 2., 0.", "3, nan, 0.", r"point 2 is \[nan, 0.0, 0.0\]; all coordinates must be finite"),
        ("3, 2., 0.", "3, 2., 0., 5.", "is not plane: point 2"),
        ("3, 2., 0.", "2, 2., 0.", "node 2 is given twice"),
        ("3, 13\n", "3, 14\n", r"\*NSET in line 19: set 'Free End' names node 14"),
        ('Root, "Free End"', "Rot", r"set 'BOTH' names the set 'Rot', which no \*NSET"),
        ("*Heading", "*Include, input=more.inp", "line 1: it cannot be read as .inp: other files are not followed"),
        ("*Node", "*Nodes", "names node 1, which no"),
        ("1, 11, 10", "1, 999999999999, 1", "line 17: it generates 999999999999 numbers, more than a file can have"),
    ],
)
def test_wrong_ones_are_told_by_the_line(inp, old, new, message):
    with pytest.raises(InputError, match=message) as caught:
        read(inp(PART.replace(old, new, 1)))
    assert "plate.inp" in str(caught.value)
