"""Abaqus files with instances: where they are placed, how their sets are called, and what is refused rather than read wrong."""

import warnings

import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import MeshWarning, read

BEAM = """*Part, name=Beam
*Node
1, 0., 0.
2, 2., 0.
3, 2., 1.
4, 0., 1.
*Element, type=CPS4, elset=All
1, 1, 2, 3, 4
*Nset, nset=Root
1, 4
*End Part
"""
WEDGE = """*Part, name=Wedge
*Node
1, 0., 0.
2, 1., 0.
3, 0., 1.
*Element, type=CPE3
1, 1, 2, 3
*Nset, nset=Root
1, 3
*End Part
"""
TWO = "*Instance, name=A, part=Beam\n*End Instance\n*Instance, name=B, part=Beam\n0., 5.\n*End Instance\n"
CORNERS = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])


@pytest.fixture
def deck(tmp_path):
    """Read a file's text; a warning is an error unless one is wanted."""

    def made(text, warns=None):
        path = tmp_path / "deck.inp"
        path.write_text(text)
        if warns is not None:
            with pytest.warns(MeshWarning, match=warns):
                return read(path)
        with warnings.catch_warnings():
            warnings.simplefilter("error", MeshWarning)
            return read(path)

    return made


def assembly(inside, parts=BEAM, after=""):
    return f"*Heading\n{parts}*Assembly, name=Assembly\n{inside}*End Assembly\n{after}"


def same_places(points, wanted):
    """Points as a set, to round-off of their size."""
    points, wanted = np.asarray(points), np.asarray(wanted)
    distance = np.linalg.norm(points[:, None] - wanted[None], axis=2)
    return len(points) == len(wanted) and max(distance.min(axis=0).max(), distance.min(axis=1).max()) < 1e-13 * (1 + np.abs(wanted).max())


def at(mesh, name):
    return mesh.points[mesh.sections[name]]


def turned(points, angle, about):
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.asarray(about) + (points - about) @ np.array([[c, s], [-s, c]])


@pytest.mark.parametrize(
    "rows, wanted",
    [
        ("", CORNERS),
        ("3., -1.\n", CORNERS + (3.0, -1.0)),
        ("3., -1., 0.\n3., -1., 0., 3., -1., 1., 30.\n", turned(CORNERS + (3.0, -1.0), 30.0, (3.0, -1.0))),
        ("3., -1.\n0., 0., 0., 0., 0., 2., 90.\n", turned(CORNERS + (3.0, -1.0), 90.0, (0.0, 0.0))),
        ("0., 0.\n1., 2., 5., 1., 2., 4., 50.\n", turned(CORNERS, -50.0, (1.0, 2.0))),
        ("\n1., 2., 0., 1., 2., 1., 50.\n", turned(CORNERS, 50.0, (1.0, 2.0))),
        ("0., 0.\n1., 0., 0., 1., 1., 0., 180.\n", CORNERS * (-1, 1) + (2.0, 0.0)),
    ],
    ids=["as drawn", "moved", "moved and turned", "about the origin", "about -z", "blank first line", "turned over"],
)
def test_an_instance_is_moved_and_then_turned(deck, rows, wanted):
    over = "clockwise cell" if "180" in rows else None
    mesh = deck(assembly(f"*Instance, name=A, part=beam\n{rows}*End Instance\n"), over)
    assert same_places(mesh.points, wanted) and mesh.area == pytest.approx(2.0, rel=1e-13)
    assert same_places(at(mesh, "Root"), wanted[[0, 3]])


def test_a_part_used_twice_and_another_one_with_their_sets(deck):
    inside = (
        TWO
        + "*Instance, name=C, part=Wedge\n10., 0.\n*End Instance\n*Nset, nset=Ends, instance=A\n2, 3\n*Nset, nset=Ends, instance=B\nRoot\n"
    )
    after = "*Nset, nset=Mix\nB.2, C.Root, Ends\n*Boundary\nA.Root, 1, 2\nC.2, 2\n*Cload\nEnds, 2, -3.\n"
    text = assembly(inside + after.split("*Boundary")[0], BEAM + WEDGE, "*Boundary" + after.split("*Boundary")[1])
    mesh = deck(text, "the instances 'A', 'B', 'C' are one mesh, joined where their nodes are in the same place")
    assert mesh.n_cells == 3 and mesh.area == 4.5
    shift = (0.0, 5.0)
    assert same_places(at(mesh, "A.Root"), [[0, 0], [0, 1]]) and same_places(at(mesh, "B.Root"), [[0, 5], [0, 6]])
    assert same_places(at(mesh, "C.Root"), [[10, 0], [10, 1]]) and "Root" not in mesh.sections
    ends = [[2, 0], [2, 1], [0, 5], [0, 6]]
    assert same_places(at(mesh, "Ends"), ends) and same_places(at(mesh, "load"), ends)
    assert same_places(at(mesh, "Mix"), [*ends, CORNERS[1] + shift, [10, 0], [10, 1]])
    assert {tuple(mesh.points[node]): fixed for node, fixed in mesh.supports.items()} == {
        (0, 0): (True, True),
        (0, 1): (True, True),
        (11, 0): (False, True),
    }


def test_a_set_of_the_assembly_called_like_one_of_the_part_is_another_one(deck):
    one = "*Instance, name=A, part=Beam\n*End Instance\n*Nset, nset=ROOT, instance=A\n2, 3\n"
    mesh = deck(assembly(one, after="*Boundary\nRoot, 1, 2\n"))
    assert same_places(at(mesh, "ROOT"), [[2, 0], [2, 1]]) and same_places(at(mesh, "A.Root"), [[0, 0], [0, 1]])
    assert same_places(at(mesh, "support"), [[2, 0], [2, 1]])


def test_nodes_and_sets_within_an_instance_are_its_own(deck):
    """Abaqus/CAE writes the mesh of an independent instance there, in the coordinates of the part."""
    mesh_lines = BEAM.split("\n", 1)[1].replace("*End Part\n", "")
    mesh = deck(assembly(f"*Instance, name=A, part=Empty\n1., 1.\n{mesh_lines}*End Instance\n", "*Part, name=Empty\n*End Part\n"))
    assert same_places(mesh.points, CORNERS + 1.0) and same_places(at(mesh, "Root"), [[1, 1], [1, 2]])


def test_an_instance_without_cells_changes_no_names(deck):
    point = "*Part, name=Punch\n*Node, nset=Root\n1, 1., 2.\n*End Part\n"
    inside = "*Instance, name=A, part=Beam\n*End Instance\n*Instance, name=B, part=Punch\n*End Instance\n"
    mesh = deck(assembly(inside, BEAM + point), "left out section 'B.Root', of which no point is a corner of a cell")
    assert same_places(at(mesh, "Root"), [[0, 0], [0, 1]]) and mesh.n_nodes == 4


def test_touching_instances_are_said_to_be_joined(deck):
    inside = TWO.replace("0., 5.", "2., 0.")
    mesh = deck(assembly(inside), "are one mesh, joined .*; merged 2 points")
    assert mesh.n_nodes == 6 and mesh.n_cells == 2


def test_sets_of_lines_of_an_instance_are_its_sections(deck):
    part = BEAM.replace("*End Part", "*Element, type=T3D2, elset=Rim\n7, 1, 2\n*End Part")
    mesh = deck(assembly(TWO + "*Elset, elset=Low, instance=B\nRim\n", part), "are one mesh")
    assert same_places(at(mesh, "A.Rim"), [[0, 0], [2, 0]]) and same_places(at(mesh, "Low"), [[0, 5], [2, 5]])


@pytest.mark.parametrize(
    "inside, after, message",
    [
        ("*Instance, name=A, part=Bean\n*End Instance\n", "", r"\*INSTANCE in line 14: instance 'A' is of part 'Bean'; there are 'Beam'"),
        (TWO.replace("=B,", "=a,"), "", "there are two instances 'a'"),
        ("*Instance, library=old, instance=A\n*End Instance\n", "", "is of another file"),
        ("*Instance, name=A, part=Beam\n1., 0.\n0, 0, 0, 1, 0, 0, 30.\n*End Instance\n", "", "'A' is turned out of the plane z = constant"),
        ("*Instance, name=A, part=Beam\n1., 0.\n0, 0, 1, 0, 0, 1, 30.\n*End Instance\n", "", "the points must differ"),
        (TWO.replace("0., 5.", "0., 5., 1."), "", "is not plane: point 0 is .*, z runs from 0 to 1"),
        (TWO, "*Boundary\nRoot, 1\n", r"\*BOUNDARY in line 20: support names 'Root', which the instances 'A' and 'B' have; say A.Root"),
        (TWO, "*Cload\n3, 1, 1.\n", "load names '3', which the instances 'A' and 'B' have; say A.3"),
        (TWO, "*Cload\nC.3, 1, 1.\n", "there is no instance 'C'; there are 'A', 'B'"),
        (TWO + "*Nset, nset=Far, instance=C\n1\n", "", "there is no instance 'C'; there are 'A', 'B'"),
        (TWO + "*Nset, nset=Far, instance=A\n9\n", "", "set 'Far' names node 9, which no .NODE before it gives"),
        (TWO + "*Nset, nset=Far\nA.Tip\n", "", "set 'Far' names the set 'A.Tip'"),
        (TWO + '*Nset, nset="A.Root", instance=A\n2\n', "", "the set 'A.Root' of the assembly is called like a set of an instance"),
        (TWO + "*Element, type=CPS3\n1, A.1, A.2, A.3\n", "", "elements of type CPS3 belong to the assembly"),
        ("", "", "its .ASSEMBLY has no .INSTANCE"),
        (TWO.replace("*End Instance\n", "", 1), "", r"\*INSTANCE in line 15: it stands within .*'A', which must end before it"),
        ("*Instance, name=A, part=Beam\n", "", "INSTANCE 'A' has no .END INSTANCE"),
        (WEDGE, "", r"\*PART in line 14: it stands within .ASSEMBLY, which must end before it"),
        ("*Assembly\n", "", "there are two; a file has one"),
    ],
)
def test_what_cannot_be_placed_is_refused_by_name(deck, inside, after, message):
    with pytest.raises(InputError, match=message):
        deck(assembly(inside, after=after))


@pytest.mark.parametrize(
    "text, message",
    [
        (BEAM + WEDGE, "it has the parts 'Beam', 'Wedge' and no .ASSEMBLY that places them"),
        (BEAM + BEAM, "there are two parts 'Beam'"),
        (BEAM.replace("*End Part\n", "") + WEDGE, r"\*PART in line 11: it stands within .*'Beam', which must end before it"),
        (BEAM + "*Instance, name=A, part=Beam\n", "it stands outside of .ASSEMBLY"),
        (BEAM.replace("*Part, name=Beam\n", "").replace("*End Part\n", "") + WEDGE, "it has nodes outside of its parts"),
        ("*Node, input=nodes.txt\n", r"\*NODE in line 1: .*other files are not followed"),
        (BEAM.replace("1, 1, 2, 3, 4", "1, 1, 2, 3, 4\n1, 1, 2, 3, 4"), "element 1 is given twice"),
        *[
            (BEAM.replace("CPS4", kind), f"line 7: holds elements of type {kind}, which are axisymmetric")
            for kind in ("CAX4", "CAX4R", "CGAX4", "DCAX4")
        ],
        *[(BEAM.replace("CPS4", kind), f"holds cells of type {kind}") for kind in ("C3D4", "SC8R", "COH2D4", "CIN3D8")],
        *[
            (BEAM.replace("*Nset", f"*{keyword}\n1\n*Nset", 1), rf"\*{keyword.upper()} in line 9: it makes or moves nodes or elements")
            for keyword in ("Nmap", "Ncopy", "Elcopy", "Imperfection")
        ],
        (BEAM.replace("*Node", "*Node, system=S"), "SYSTEM is S; it must be R .rectangular. or C"),
        (BEAM.replace("*Node", "*System\n0, 0, 0, 0, 0, 1\n1, 0, 0\n*Node"), r"\*SYSTEM in line 2: it turns nodes out of the plane"),
        (BEAM.replace("*Node", "*System\n0, 0, 0, 1, 0, 0\n2, 0, 0\n*Node"), "its points lie on one line"),
        (BEAM + "*Transform, nset=Root\n1, 1, 0, -1, 1, 0\n", "it names the set|names the set"),
        (
            BEAM.replace("*End Part", "*Transform, nset=Root\n1, 1, 0\n*End Part\n*Boundary\nRoot, 1\n"),
            r"TRANSFORM turns .* at \[0.0, 0.0\]",
        ),
    ],
)
def test_what_would_be_read_wrong_is_refused_by_name(deck, text, message):
    with pytest.raises(InputError, match=message):
        deck(text)


@pytest.mark.parametrize(
    "more, said",
    [
        ("*Element, type=B21, elset=Rod\n7, 1, 2\n", "left out the elements of type B21"),
        ("*Element, type=T2D2\n7, 1, 2\n", "left out the elements of type T2D2"),
        (
            "*Element, type=T3D2, elset=Rod\n7, 1, 2\n*Solid Section, elset=Rod, material=steel\n",
            "left out the bars of the element set 'Rod'",
        ),
        ("*Dsload\nTop, P, 3.\n*Tie, name=t\na, b\n", "left out .DSLOAD; left out .TIE"),
    ],
)
def test_what_is_no_part_of_a_mesh_is_said_to_be_left_out(deck, more, said):
    assert deck(BEAM.replace("*End Part", more + "*End Part"), said).n_cells == 1


@pytest.mark.parametrize("kind", ["S4R", "M3D4", "DC2D4", "R3D4"])
def test_of_other_flat_elements_the_shape_is_used_with_a_note(deck, kind):
    assert deck(BEAM.replace("CPS4", kind), f"of elements of type {kind}, which are not plane stress or strain").area == 2.0


def test_an_unused_part_is_said_to_be_left_out(deck):
    mesh = deck(
        assembly("*Instance, name=A, part=Beam\n*End Instance\n", BEAM + WEDGE), "left out the part 'Wedge', of which there is no .INSTANCE"
    )
    assert mesh.n_cells == 1


def test_supports_and_loads_are_those_as_far_as_the_first_step(deck):
    """A later step replaces loads, it does not add to them; OP=NEW replaces what was before."""
    steps = "*Boundary\n1, 1, 2\n*Step\n*Boundary, op=new\n4, 1\n*Boundary, op=new\n3, 2\n*Cload\n2, 1, 1.\n2, 1, 2.\n*End Step\n*Step\n*Cload\n2, 1, 4.\n*End Step\n"
    mesh = deck(BEAM + steps, "left out .CLOAD of step 2; supports and loads are those of the first")
    assert list(mesh.loads.values()) == [(3.0, 0.0)]
    assert {tuple(mesh.points[node]): fixed for node, fixed in mesh.supports.items()} == {(0, 1): (True, False), (2, 1): (False, True)}


def test_a_node_set_of_an_element_set_has_its_nodes(deck):
    mesh = deck(BEAM.replace("*End Part", "*Nset, nset=Body, elset=all\n*End Part"))
    assert same_places(at(mesh, "Body"), CORNERS)


@pytest.mark.parametrize(
    "system, wanted",
    [
        ("1., 2.", CORNERS + (1.0, 2.0)),
        ("1., 2., 0., 1., 5., 0.", turned(CORNERS, 90.0, (0.0, 0.0)) + (1.0, 2.0)),
        ("1., 2., 0., 1., 5., 7.", turned(CORNERS, 90.0, (0.0, 0.0)) + (1.0, 2.0)),
        ("0., 0., 0., 2., 0., 0.\n1., 1., 0.", CORNERS),
        ("0., 0., 0., 2., 0., 0.\n1., -1., 0.", CORNERS * (1, -1)),
    ],
)
def test_nodes_in_a_local_system(deck, system, wanted):
    mesh = deck(BEAM.replace("*Node", f"*System\n{system}\n*Node"), "clockwise" if "-1." in system else None)
    assert same_places(mesh.points, wanted)


def test_a_system_ends_with_an_empty_one_and_nodes_may_be_cylindrical(deck):
    nodes = "*System\n7., 7.\n*System\n*Node, system=C\n1, 0., 0.\n2, 2., 0.\n3, 2., 45.\n4, 3., 90.\n"
    mesh = deck(BEAM.replace(BEAM[BEAM.index("*Node") : BEAM.index("*Element")], nodes))
    assert same_places(mesh.points, [[0, 0], [2, 0], [np.sqrt(2), np.sqrt(2)], [0, 3]])


GRID = """*Node
1, 0., 0.
5, 2., 0.
31, 0., 3.
35, 2., 3.
*Ngen, nset=Low
1, 5
*Ngen, nset=High
31, 35, 1
*Nfill, nset=Grid
Low, High, 3, 10
*Element, type=CPS4
1, 1, 2, 12, 11
*Elgen, elset=Body
1, 4, 1, 1, 3, 10, 10
"""


def test_generated_nodes_and_elements(deck):
    mesh = deck(GRID)
    assert mesh.n_nodes == 20 and mesh.n_cells == 12 and mesh.area == pytest.approx(6.0, rel=1e-14)
    x, y = np.meshgrid(np.linspace(0.0, 2.0, 5), np.linspace(0.0, 3.0, 4))
    assert same_places(mesh.points, np.column_stack([x.ravel(), y.ravel()])) and len(at(mesh, "Grid")) == 20
    assert same_places(at(mesh, "High"), [[i / 2, 3.0] for i in range(5)])


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("*Ngen, nset=Low", "*Ngen, line=C", r"\*NGEN in line 6: only straight lines"),
        ("31, 35, 1", "31, 35, 3", "its numbers are 4 apart, in steps of 3"),
        ("31, 35, 1", "31, 36, 1", "names node 36, which no .NODE"),
        ("31, 35, 1", "31, 35, 2", "have 5 and 3 nodes"),
        ("Low, High, 3, 10", "Low, High, 99999999, 10", "it generates 499999995 numbers"),
        ("*Nfill, nset=Grid", "*Nfill, bias=1.5", "BIAS cannot be read"),
        ("1, 4, 1, 1, 3, 10, 10", "1, 5, 1, 1, 3, 10, 10", "element 5 names node 6, which no .NODE"),
        ("1, 4, 1, 1, 3, 10, 10", "2, 4, 1, 1, 3, 10, 10", "it copies element 2, which no"),
        ("1, 4, 1, 1, 3, 10, 10", "1, 4, 1, 1, 3, 10, 10, 2", "it makes 2 layers of element 1"),
        ("1, 4, 1, 1, 3, 10, 10", "1, 4, 1, 1, 3, 10, 2", "element 3 is given twice"),
    ],
)
def test_wrong_generations_are_told(deck, old, new, message):
    with pytest.raises(InputError, match=message):
        deck(GRID.replace(old, new))


CAE = """*Heading
** Job name: Job-1 Model name: Model-1
*Preprint, echo=NO, model=NO, history=NO, contact=NO
**
** PARTS
**
*Part, name=Part-1
*Node
      1,           0.,           0.
      2,           2.,           0.
      3,           2.,           1.
      4,           0.,           1.
*Element, type=CPS4R
1, 1, 2, 3, 4
*Nset, nset=Set-1, generate
 1,  4,  1
*Elset, elset=Set-1
 1,
** Section: Section-1
*Solid Section, elset=Set-1, material=Steel
,
*End Part
**
** ASSEMBLY
**
*Assembly, name=Assembly
**
*Instance, name=Part-1-1, part=Part-1
*End Instance
**
*Instance, name=Part-1-2, part=Part-1
          4.,          0.,          0.
          4.,          0.,          0.,          4.,          0.,          1.,  90.
*End Instance
**
*Node
      1,   9., 9., 0.
*Nset, nset=Set-1, instance=Part-1-1
 1, 4
*Nset, nset=_PickedSet5, internal, instance=Part-1-2, generate
 1,  4,  3
*Elset, elset=_Surf-1_S2, internal, instance=Part-1-1
 1,
*Surface, type=ELEMENT, name=Surf-1
_Surf-1_S2, S2
*Nset, nset=Point
 1,
*End Assembly
*Material, name=Steel
*Elastic
210000., 0.3
**
*Step, name=Step-1, nlgeom=NO
*Static
1., 1., 1e-05, 1.
*Boundary
Set-1, 1, 1
Set-1, 2, 2
*Boundary
Point, 1, 1
*Cload
_PickedSet5, 2, -5.
*Restart, write, frequency=0
*Output, field, variable=PRESELECT
*Node Output
U,
*End Step
"""


def test_a_file_as_abaqus_cae_writes_it(deck):
    mesh = deck(CAE, "left out: support names the set 'Point'")
    assert mesh.n_cells == 2 and mesh.area == pytest.approx(4.0, rel=1e-14)
    second = np.array([[4, 0], [4, 2], [3, 2], [3, 0]])
    assert same_places(at(mesh, "Part-1-1.Set-1"), CORNERS) and same_places(at(mesh, "Part-1-2.Set-1"), second)
    assert same_places(at(mesh, "support"), [[0, 0], [0, 1]]) and same_places(at(mesh, "load"), second[[0, 3]])
    assert same_places(at(mesh, "Set-1"), [[0, 0], [0, 1]])
