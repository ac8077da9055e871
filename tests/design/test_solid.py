"""From densities to a solid mesh: which cells stay, which sections, and what hangs."""

import numpy as np
import pytest

import polyida as pi
from polyida.errors import InputError
from polyida.mesh import MeshWarning

MESH = pi.mesh.quads(4.0, 3.0, 4, 3, origin=(0.0, 1.5))


def pattern(*lines):
    """Densities of MESH from a picture, the top line first: # is solid."""
    picture = np.array([[letter == "#" for letter in line] for line in reversed(lines)], float)
    column, row = np.floor(MESH.cell_centroids).astype(int).T
    return picture[row, column]


def test_solid_cells_stay_and_sections_are_what_is_left_of_them():
    solid = pi.design.threshold(MESH, 0.4 + 0.2 * pattern("####", "#..#", "#..."))
    assert solid.n_cells == 7 and solid.area == pytest.approx(7.0) and solid.quality().pieces == 1
    assert {name: len(nodes) for name, nodes in solid.sections.items()} == {"left": 4, "right": 3, "top": 5, "bottom": 2}
    assert np.array_equal(solid.points[solid.section("left").nodes], [[0, 0], [0, 1], [0, 2], [0, 3]])


def test_all_solid_is_the_same_mesh():
    mesh = pi.mesh.rectangle(1.0, 0.25, cells=60, seed=1)
    solid = pi.design.threshold(mesh, np.ones(mesh.n_cells))
    assert solid.n_nodes == mesh.n_nodes and solid.area == pytest.approx(mesh.area, rel=1e-14)
    for name in mesh.sections:
        assert solid.points[solid.section(name).nodes].tolist() == mesh.points[mesh.section(name).nodes].tolist()


def test_a_section_that_is_kept_is_whole():
    rho = pattern("###.", "#...", "###.")
    solid = pi.design.threshold(MESH, rho, keep=["right"])
    assert solid.section("right").length == pytest.approx(3.0) and solid.n_cells == 10
    assert "right" not in pi.design.threshold(MESH, rho).sections


def test_supports_and_loads_move_with_their_nodes():
    corner = int(np.argmin(MESH.points @ [1.0, 1.0]))
    mesh = pi.mesh.PolygonMesh(MESH.points, MESH.nodes, MESH.offsets, {}, {corner: (True, False)}, {corner: (0.0, -1.0)})
    solid = pi.design.threshold(mesh, pattern("#...", "#...", "#..."))
    ((node, support),), (load,) = solid.supports.items(), solid.loads.values()
    assert solid.points[node].tolist() == [0.0, 0.0] and support == (True, False) and load == (0.0, -1.0)
    assert not pi.design.threshold(mesh, pattern("####", "....", "....")).supports


@pytest.mark.parametrize(
    "lines, place", [(("##..", "....", "...#"), "1 cell around \\(3.5, 0.5\\)"), (("###.", "...#", "...."), "1 cell around \\(3.5, 1.5\\)")]
)
def test_what_hangs_is_named(lines, place):
    with pytest.raises(InputError, match=f"1 hanging piece, {place}"):
        pi.design.threshold(MESH, pattern(*lines))
    with pytest.warns(MeshWarning, match=f"left out: 1 hanging piece, {place}"):
        solid = pi.design.threshold(MESH, pattern(*lines), hanging="leave out")
    assert solid.n_cells == sum(line.count("#") for line in lines) - 1


def test_a_kept_section_never_goes():
    with pytest.raises(InputError, match="section 'right', which is to be kept, is not connected"):
        pi.design.threshold(MESH, pattern("##..", "##..", "##.."), keep=["right"], hanging="leave out")


def test_what_is_left_moves_under_its_load():
    mesh = pi.mesh.rectangle(1.0, 0.25, cells=200, seed=1)
    rho = 1.0 * (np.abs(mesh.cell_centroids[:, 1]) > 0.06) + 1.0 * (mesh.cell_centroids[:, 0] > 0.8)
    solid, scene = pi.design.threshold(mesh, rho, keep=["left", "right"]), pi.Scene()
    arm = scene.add(pi.Plate(solid, pi.Material(E=300e6, nu=0.3, rho=1100.0), thickness=0.01, name="arm"))
    scene.add(pi.Clamp(arm.section("left")))
    scene.add(pi.PointLoad(arm.section("right"), (0.0, -1.0), name="load"))
    found = pi.static(scene.build())
    assert found.stable
