"""Drawings and VTU files of cells of order 2: sides are parabolas through their three nodes."""

import numpy as np
import pytest

import polyida as pi
from polyida.show import plates

RUBBER = pi.Material(E=50e6, nu=0.3, rho=1100.0)


@pytest.fixture(scope="module")
def model():
    """A quadratic plate of polygons and quads beside a linear one of triangles."""
    scene = pi.Scene()
    scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.3, cells=8), RUBBER, thickness=0.01, order=2, name="curved"))
    scene.add(pi.Plate(pi.mesh.triangles(1.0, 0.1, 3, 1, origin=(0.0, 2.0)), RUBBER, thickness=0.01, name="straight"))
    scene.add(pi.Plate(pi.mesh.quads(1.0, 0.1, 3, 1, origin=(0.0, 3.0)), RUBBER, thickness=0.01, order=2, name="quads"))
    return scene.build()


def bent(places):
    """A quadratic map: it takes straight sides to parabolas."""
    x, y = places.T
    return np.column_stack([x - 0.4 * x * y, y + x**2])


def test_drawn_sides_are_the_images_of_straight_ones(model):
    lines, nodes = plates.curves(model), model.drawn_points
    assert lines.places(bent(nodes)) == pytest.approx(bent(lines.places(nodes)), abs=1e-14)
    ends = lines.outlines(nodes)
    lengths = [2.6, 2.2, 2.2]  # of the boundaries: every line once
    assert np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum() == pytest.approx(sum(lengths), rel=1e-12)
    cells, meshes = lines.polygons(nodes), [body.mesh for body in model.drawn]
    assert sum(pi.mesh.sections.signed_area(cell) for cell in cells) == pytest.approx(sum(mesh.area for mesh in meshes), rel=1e-12)
    assert [len(cell) for cell in cells[-3:]] == [16, 16, 16] and len(cells[8]) == 3


def test_mesh_and_scene_are_drawn(model):
    assert "3 to" in plates_title(model)
    assert model.drawn[0].mesh.plot() is not None


def plates_title(model):
    from polyida.show import plots

    return plots.mesh(model).axes[0].get_title()


def test_vtu_has_quadratic_cells_of_vtk_and_polygons_through_all_nodes(model, tmp_path):
    meshio = pytest.importorskip("meshio")
    scene = pi.Scene()
    scene.add(pi.Plate(pi.mesh.quads(1.0, 0.1, 2, 1), RUBBER, thickness=0.01, order=2, name="quads", spin=1.0))
    scene.add(pi.Plate(pi.mesh.triangles(1.0, 0.1, 1, 1), RUBBER, thickness=0.01, order=2, origin=(0, 1), name="triangles"))
    six = [[0, 0], [1, 0], [1.5, 1], [1, 2], [0, 2], [-0.5, 1]]
    scene.add(pi.Plate(pi.mesh.from_lists(six, [range(6)]), RUBBER, thickness=0.01, origin=(0, 3), name="hexagon", order=1))
    scene.add(pi.Plate(pi.mesh.from_lists(six, [range(6)]), RUBBER, thickness=0.01, origin=(0, 6), name="quadratic hexagon", order=2))
    run = pi.solve(scene.build(), t_end=1e-3, integrator=pi.GeneralizedAlpha(h=1e-3))
    pi.export.vtu(run, tmp_path / "frames")
    data = meshio.read(tmp_path / "frames" / "frame-00001.vtu")
    kinds = {block.type: block.data.shape for block in data.cells}
    assert kinds["triangle6"] == (2, 6) and kinds["quad8"] == (2, 8)
    assert sorted(block.data.shape[1] for block in data.cells if block.type.startswith("polygon")) == [6, 12]
    for kind in ("triangle6", "quad8"):  # middle nodes follow the corners and lie between them
        points = data.points[dict((block.type, block.data) for block in data.cells)[kind]]
        n = points.shape[1] // 2
        assert points[:, n:] == pytest.approx((points[:, :n] + np.roll(points[:, :n], -1, axis=1)) / 2, abs=1e-6)
