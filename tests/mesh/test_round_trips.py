"""What is written is read as it was, in each format: points and cells to the bit, sections, supports and loads."""

import warnings

import meshio
import numpy as np
import pytest

import polyida as pi
from polyida.errors import InputError
from polyida.mesh import FORMATS, Format, Link, MeshWarning, PolygonMesh, RawMesh, polygonize, quads, read, rectangle, triangles, write

POLYGONS = [".mat", ".vtu", ".vtk", ".obj"]
NAMED = [".mat", ".vtu", ".vtk", ".msh", ".msh2", ".msh4", ".inp"]
FORCES = [".mat", ".inp"]


def sets(named):
    return {name: sorted(nodes.tolist()) for name, nodes in named.items()}


def assert_same(one, two):
    assert np.array_equal(one.points, two.points) and one.points.dtype == two.points.dtype
    assert np.array_equal(one.nodes, two.nodes) and np.array_equal(one.offsets, two.offsets)
    assert sets(one.sections) == sets(two.sections)
    assert dict(one.supports) == dict(two.supports) and dict(one.loads) == dict(two.loads)


def with_sections(mesh, **more):
    """The mesh with a section of edges, one of single nodes and one that holds a corner of each side."""
    named = {"grip (left), 1": [0, 1], "a node": [4], "corners": mesh.boundary_nodes[::3]}
    return PolygonMesh(mesh.points, mesh.nodes, mesh.offsets, dict(mesh.sections) | named, **more)


class TestIdentity:
    @pytest.mark.parametrize("suffix", POLYGONS)
    def test_polygons(self, tmp_path, suffix):
        for mesh in (rectangle(1.0, 0.1, 60, seed=2), polygonize(Link(1.0, 0.3, 0.08), 80)):
            assert_same(read(write(mesh, tmp_path / f"plate{suffix}", overwrite=True)), mesh)

    @pytest.mark.parametrize("suffix", [*FORMATS])
    @pytest.mark.parametrize("make", [triangles, quads])
    def test_triangles_and_quads(self, tmp_path, suffix, make):
        mesh = make(1.0, 0.2, 6, 2)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert_same(read(write(mesh, tmp_path / f"plate{suffix}")), mesh)

    @pytest.mark.parametrize("suffix", [*FORMATS])
    def test_triangles_and_quads_mixed(self, tmp_path, suffix):
        points = [[0, 0], [0, 1], [1, 0], [1, 1], [2, 0], [2, 1 / 3], [2, 1]]
        mesh = pi.mesh.from_lists(points, [[0, 2, 3, 1], [2, 4, 5], [2, 5, 3], [3, 5, 6]])
        assert_same(read(write(mesh, tmp_path / f"plate{suffix}")), mesh)

    @pytest.mark.parametrize("suffix", NAMED)
    def test_named_sections(self, tmp_path, suffix):
        mesh = with_sections(triangles(1.0, 0.2, 6, 2))
        assert_same(read(write(mesh, tmp_path / f"plate{suffix}")), mesh)

    @pytest.mark.parametrize("suffix", FORCES)
    def test_supports_and_loads(self, tmp_path, suffix):
        nodes = {"support": [0, 3], "support x": [0, 3], "support y": [0], "load": [7]}
        mesh = triangles(1.0, 0.2, 6, 2)
        mesh = PolygonMesh(
            mesh.points, mesh.nodes, mesh.offsets, dict(mesh.sections) | nodes, {0: (True, True), 3: (True, False)}, {7: (0.1, -0.5)}
        )
        assert_same(read(write(mesh, tmp_path / f"plate{suffix}")), mesh)

    def test_they_survive_in_the_file_of_a_run(self, tmp_path):
        mesh = quads(1.0, 0.1, 4, 1)
        mesh = PolygonMesh(mesh.points, mesh.nodes, mesh.offsets, dict(mesh.sections), {0: (True, True)}, {3: (0.1, -0.5)})
        scene = pi.Scene()
        plate = scene.add(pi.Plate(mesh, pi.Material(5e7, 0.3, 1100.0), 0.01, name="plate"))
        scene.add(pi.Clamp(pi.ground, plate.section("left")))
        pi.solve(scene.build(), 1e-3, pi.GeneralizedAlpha(h=1e-3)).save(tmp_path / "run.h5")
        again = pi.load(tmp_path / "run.h5").model.parts["plate"].mesh
        assert_same(again, mesh)

    @pytest.mark.parametrize("suffix", [".mat", ".msh4", ".inp", ".vtu"])
    def test_units(self, tmp_path, suffix):
        mesh = quads(0.4, 0.1, 4, 2)
        path = write(mesh, tmp_path / f"plate{suffix}", unit="mm")
        assert np.allclose(read(path, unit="mm").points, mesh.points, rtol=1e-15, atol=0)
        assert np.allclose(read(path, unit=1e-3).points, mesh.points, rtol=1e-15, atol=0)
        with pytest.warns(MeshWarning, match="it is 400 m wide; if its numbers are millimetres pass unit='mm'"):
            assert read(path).area == pytest.approx(0.04e6)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read(path, unit="m")


class TestOthersReadIt:
    """meshio reads the text that is written here, as programs do that take the formats by the book."""

    @pytest.mark.parametrize("suffix", [".msh2", ".msh4"])
    def test_groups_of_gmsh(self, tmp_path, suffix):
        mesh = with_sections(quads(1.0, 0.2, 4, 2))
        data = meshio.read(write(mesh, tmp_path / f"plate{suffix}"), "gmsh")
        assert data.field_data["plate"].tolist() == [1, 2] and data.field_data["left"].tolist()[1] == 1
        assert data.field_data["a node"].tolist()[1] == 0
        lines = np.concatenate([block.data for block in data.cells if block.type == "line"])
        tags = np.concatenate([tag for block, tag in zip(data.cells, data.cell_data["gmsh:physical"]) if block.type == "line"])
        assert sorted(np.unique(lines[tags == data.field_data["top"][0]])) == sorted(mesh.sections["top"])


class TestRefusals:
    @pytest.mark.parametrize("suffix", sorted({*FORMATS} - {*POLYGONS}))
    def test_polygons_that_a_format_does_not_hold(self, tmp_path, suffix):
        with pytest.raises(InputError, match=r"triangles and quads only; cell \d+ has [5-9] corners. Polygons go into .mat, .vtu"):
            write(polygonize(pi.mesh.Circle(1.0), 40), tmp_path / f"plate{suffix}")
        assert list(tmp_path.iterdir()) == []

    def test_what_a_format_leaves_out_is_said(self, tmp_path):
        mesh = with_sections(triangles(1.0, 0.2, 6, 2), loads={0: (1.0, 0.0)})
        with pytest.warns(MeshWarning, match="does not hold the sections 'grip .left., 1', 'a node', 'corners' and supports and loads"):
            write(mesh, tmp_path / "plate.mesh")

    def test_other_wrong_ones(self, tmp_path):
        with pytest.raises(InputError, match="suffix '.png'; known are .mat, .vtu"):
            write(quads(1.0, 1.0, 1, 1), tmp_path / "plate.png")
        with pytest.raises(InputError, match="format 'nastran'; known are"):
            write(quads(1.0, 1.0, 1, 1), tmp_path / "plate.vtu", format="nastran")
        for suffix in FORMATS:
            with pytest.raises(InputError, match="written"):
                write(quads(1.0, 1.0, 1, 1), tmp_path / "nowhere" / f"plate{suffix}")
        for suffix, name in ((".msh", 'a "b"'), (".inp", "a\nb")):
            mesh = PolygonMesh(*(getattr(quads(1.0, 0.2, 4, 2), part) for part in ("points", "nodes", "offsets")), {name: [0, 1]})
            with pytest.raises(InputError, match="its name must be one line"):
                write(mesh, tmp_path / f"plate{suffix}")
        assert list(tmp_path.iterdir()) == []

    def test_overwrite_only_when_told(self, tmp_path):
        for suffix in FORMATS:
            path = write(quads(1.0, 1.0, 1, 1), tmp_path / f"plate{suffix}")
            before = path.read_bytes()
            with pytest.raises(InputError, match="exists.*overwrite"):
                write(quads(1.0, 1.0, 2, 2), path)
            assert path.read_bytes() == before
            write(quads(1.0, 1.0, 2, 2), path, overwrite=True)
            assert read(path).n_cells == 4
        assert len(list(tmp_path.iterdir())) == len(FORMATS)


def test_a_format_of_ones_own(tmp_path, monkeypatch):
    def read_own(path):
        rows = [line.split() for line in path.read_text().splitlines()]
        points = [[float(x) for x in row[1:]] for row in rows if row[0] == "p"]
        return RawMesh(points, [[int(node) for node in row[1:]] for row in rows if row[0] == "c"], first=1)

    def write_own(mesh, path):
        points = [f"p {x!r} {y!r}" for x, y in mesh.points.tolist()]
        path.write_text("\n".join(points + [f"c {' '.join(str(node + 1) for node in mesh.cell(i))}" for i in range(mesh.n_cells)]))

    monkeypatch.setitem(FORMATS, ".cells", Format(read_own, write_own, names=False))
    mesh = rectangle(1.0, 0.1, 20)
    assert_same(read(write(mesh, tmp_path / "plate.cells")), mesh)
    (tmp_path / "plate.cells").write_text("p 0 0\np 1 0\np 1 1\nc 1 2 4")
    with pytest.raises(InputError, match="plate.cells: cell 0 names point 4; there are points 1..3"):
        read(tmp_path / "plate.cells")
    (tmp_path / "plate.cells").write_text("p 0 zero")
    with pytest.raises(InputError, match="plate.cells holds inconsistent data: ValueError: could not convert"):
        read(tmp_path / "plate.cells")
