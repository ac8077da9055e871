"""Mesh files: round trips, repairs, sections, and every bad file as one message that names it."""

import warnings

import meshio
import numpy as np
import pytest

from polyida.errors import InputError
from polyida.mesh import MeshWarning, read, triangles, write

SQUARES = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]], dtype=float)


def flat(points):
    return np.column_stack([points, np.zeros(len(points))])


GMSH41 = """$MeshFormat
4.1 0 8
$EndMeshFormat
{names}$Entities
4 4 1 0
1 0 0 0 0
2 1 0 0 0
3 1 1 0 0
4 0 1 0 0
1 0 0 0 1 0 0 0 2 1 -2
2 1 0 0 1 1 0 0 2 2 -3
3 0 1 0 1 1 0 0 2 3 -4
4 0 0 0 0 1 0 {root} 2 4 -1
1 0 0 0 1 1 0 {body} 4 1 2 3 4
$EndEntities
$Nodes
1 5 1 5
2 1 0 5
1
2
3
4
5
0 0 0
1 0 0
1 1 0
0 1 0
0.5 0.5 0
$EndNodes
$Elements
2 5 1 5
1 4 1 1
1 4 1
2 1 2 4
2 1 2 5
3 2 3 5
4 3 4 5
5 4 1 5
$EndElements
"""  # a square of four triangles as gmsh writes it: lines 1 to 4 bound surface 1, line 4 is the left side


def gmsh(path, points, cells, **more):
    meshio.Mesh(points, cells, **more).write(path, file_format="gmsh22")
    return path


class TestRepair:
    @pytest.mark.parametrize("named", [True, False])
    def test_gmsh_4_1_with_and_without_named_groups(self, tmp_path, named):
        path, names = tmp_path / "square.msh", '$PhysicalNames\n2\n1 7 "root"\n2 8 "body"\n$EndPhysicalNames\n'
        path.write_text(GMSH41.format(names=names, root="1 7", body="1 8") if named else GMSH41.format(names="", root=0, body=0))
        mesh = read(path)
        assert mesh.n_cells == 4 and mesh.area == pytest.approx(1.0)
        assert set(mesh.sections) == {"left", "right", "top", "bottom"} | ({"root"} if named else set())
        assert np.array_equal(mesh.sections.get("root", mesh.sections["left"]), mesh.sections["left"])

    def test_mixed_gmsh_file(self, tmp_path):
        cells = [("quad", [[0, 1, 4, 3]]), ("triangle", [[1, 2, 5], [1, 5, 4]])]
        mesh = read(gmsh(tmp_path / "mixed.msh", flat(SQUARES), cells))
        assert mesh.n_cells == 3 and mesh.area == 2.0
        sizes = {name: len(nodes) for name, nodes in mesh.sections.items()}
        assert sizes == {"left": 2, "right": 2, "top": 3, "bottom": 3}

    def test_clockwise_cells_turn(self, tmp_path):
        cells = [("quad", [[3, 4, 1, 0]]), ("triangle", [[5, 2, 1], [1, 5, 4]])]
        with pytest.warns(MeshWarning, match="turned.msh: turned 2 clockwise cells of 3$"):
            mesh = read(gmsh(tmp_path / "turned.msh", flat(SQUARES), cells))
        assert (mesh.cell_areas > 0).all() and mesh.area == 2.0

    def test_duplicates_merge_and_unused_points_go(self, tmp_path):
        points = flat(np.vstack([SQUARES[[0, 1, 4, 3]], [[7.0, 7.0]], SQUARES[[1, 2, 5, 4]] + 1e-11]))
        with pytest.warns(
            MeshWarning, match=r"merged 2 points with others within 1e-09 .*left out 1 point of no cell, the first at \[7.0, 7.0\]"
        ):
            mesh = read(gmsh(tmp_path / "torn.msh", points, [("quad", [[0, 1, 2, 3], [5, 6, 7, 8]])]))
        assert mesh.n_nodes == 6 and mesh.quality().pieces == 1

    def test_physical_groups_become_sections(self, tmp_path):
        path = gmsh(
            tmp_path / "named.msh",
            flat(SQUARES),
            [("line", [[0, 3]]), ("vertex", [[5]]), ("quad", [[0, 1, 4, 3], [1, 2, 5, 4]])],
            field_data={"wall": np.array([1, 1]), "tip": np.array([2, 0]), "body": np.array([3, 2])},
            cell_data={
                "gmsh:physical": [np.array([1]), np.array([2]), np.array([3, 3])],
                "gmsh:geometrical": [np.array([1]), np.array([2]), np.array([3, 3])],
            },
        )
        mesh = read(path)
        assert (mesh.points[mesh.sections["wall"], 0] == 0.0).all() and len(mesh.sections["wall"]) == 2
        assert mesh.points[mesh.sections["tip"]].tolist() == [[2.0, 1.0]]
        assert "body" not in mesh.sections and "left" in mesh.sections

    def test_node_sets_of_abaqus(self, tmp_path):
        """meshio writes quads as CAX4P, triangles as R3D3 and lines as B31H: its types tell the shape alone."""
        cells = [("quad", [[0, 1, 4, 3]]), ("triangle", [[1, 2, 5], [1, 5, 4]]), ("line", [[0, 3]])]
        meshio.Mesh(flat(SQUARES), cells, point_sets={"grip": np.array([0, 3])}).write(tmp_path / "sets.inp")
        with warnings.catch_warnings():
            warnings.simplefilter("error", MeshWarning)
            mesh = read(tmp_path / "sets.inp")
        assert mesh.n_cells == 3
        assert (mesh.points[mesh.sections["grip"], 0] == 0.0).all() and len(mesh.sections["grip"]) == 2

    @pytest.mark.parametrize("file_format, suffix", [("gmsh22", ".msh"), ("gmsh", ".msh"), ("vtu", ".vtu"), ("vtk", ".vtk")])
    @pytest.mark.parametrize("kind", ["triangle6", "quad8", "quad9"])
    def test_quadratic_elements_keep_their_middle_nodes(self, tmp_path, file_format, suffix, kind):
        corners, count = (3, 6) if kind == "triangle6" else (4, int(kind[-1]))
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])[:corners]
        points = np.concatenate([square, 0.5 * (square + np.roll(square, -1, axis=0)) + 0.01, [[0.5, 0.5]]])[:count]
        meshio.Mesh(flat(points), [(kind, [list(range(count))])]).write(tmp_path / f"curved{suffix}", file_format=file_format)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore" if kind == "quad9" else "error", MeshWarning)  # of the node in the middle of the cell
            mesh = read(tmp_path / f"curved{suffix}")
        assert mesh.order == 2 and mesh.n_nodes == 2 * corners
        assert np.array(sorted(mesh.points.tolist())) == pytest.approx(np.array(sorted(points[: 2 * corners].tolist())))


def gmsh_binary(path, version):
    meshio.Mesh(flat(SQUARES), [("triangle", [[0, 1, 4], [0, 4, 3]])]).write(path, file_format="gmsh", binary=True)
    if version == "4.0":
        from meshio.gmsh import _gmsh40

        mesh = meshio.Mesh(flat(SQUARES), [("triangle", np.array([[0, 1, 4], [0, 4, 3]]))])
        _gmsh40.write(path, mesh, float_fmt=".16e", binary=True)
    return path


class TestBadFiles:
    @pytest.mark.parametrize(
        "name, content, message",
        [
            ("empty.msh", b"", "cannot be read"),
            ("parts.vtu", b"<VTKFile><UnstructuredGrid><Piece></Piece><Piece></Piece>", "divided among processes; write it as one piece"),
            (
                "parts.msh",
                b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$PartitionedEntities\n2\n",
                "divided among processes; write it as one piece",
            ),
            ("noise.msh", bytes(range(256)) * 8, "cannot be read"),
            ("noise.vtu", bytes(range(256)) * 8, "cannot be read"),
            ("page.vtu", b"<html></html>", "cannot be read"),
            ("huge.msh", b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n999999999999999\n1 0 0 0\n$EndNodes\n", "cannot"),
            ("loop.inp", b"*INCLUDE, INPUT=loop.inp\n", "cannot be read"),
            ("code.pkl", b"cos\nsystem\n", "suffix '.pkl'"),
            ("range.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 9\n", "cell 0 names point 8; there are points 0..2"),
            ("nan.obj", b"v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "finite"),
            ("off.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 1\nf 1 2 3\n", "not plane"),
            ("points.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\n", "no triangles"),
            ("flat.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "area"),
            ("point.obj", b"v 1 1 0\nv 1 1 0\nv 1 1 0\nf 1 2 3\n", "area|corners|offsets|cell"),
        ],
    )
    def test_one_message_with_the_name(self, tmp_path, capfd, name, content, message):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=message) as caught:
            read(path)
        assert name in str(caught.value)
        assert capfd.readouterr() == ("", "")

    def test_a_huge_node_number_does_not_eat_the_memory(self, tmp_path):
        path = tmp_path / "sparse.msh"
        meshio.Mesh(flat(SQUARES), [("quad", [[0, 1, 4, 3]])]).write(path, file_format="gmsh", binary=False)
        lines = path.read_text().splitlines()
        lines[lines.index("$Nodes") + 3] = "9000000000"
        path.write_text("\n".join(lines))
        with pytest.raises(InputError, match="sparse.msh"):
            read(path)

    def test_huge_counts_end_before_they_take_memory_or_time(self, tmp_path):
        for name, content in (
            ("pass.mesh", b"MeshVersionFormatted 2\nDimension 2\nOther\n99999999999\n1\n"),
            ("tags.msh", b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$NodeData\n99999999999\n"),
            ("grid.vtk", b"# vtk DataFile Version 4.2\nx\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 99999999 9999999 1\n"),
        ):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(InputError, match="has the number 99999999+, too large for a file of"):
                read(tmp_path / name)

    @pytest.mark.parametrize("version", ["4.0", "4.1"])
    def test_a_huge_node_number_in_a_binary_file(self, tmp_path, version):
        path = gmsh_binary(tmp_path / "plate.msh", version)
        assert read(path).n_cells == 2
        content = path.read_bytes()
        place = content.index(b"$Nodes\n") + 7 + (32 + 20 if version == "4.1" else 16 + 20)
        path.write_bytes(content[: place + 3] + b"\x7f" + content[place + 4 :])
        with pytest.raises(InputError, match="names node 21307064.*, too large a number"):
            read(path)

    def test_other_threads_keep_their_output_and_limits(self, tmp_path, capfd, monkeypatch):
        import sys
        import threading

        from meshio import _common

        out = sys.stdout

        def of_another_thread():
            print("step 7")
            _common.warn("of another")

        def loud(path):
            assert sys.stdout is out
            _common.warn("of this")
            other = threading.Thread(target=of_another_thread)
            other.start()
            other.join()
            raise SystemExit(1)

        monkeypatch.setattr(meshio.vtk, "read", loud)
        path = tmp_path / "plate.vtk"
        path.write_text("# vtk DataFile\n")
        with pytest.raises(InputError, match="cannot be read as vtk: SystemExit: 1"):
            read(path)
        printed = capfd.readouterr()
        assert printed.out == "step 7\n" and "of another" in printed.err and "of this" not in printed.err
        _common.warn("of the user")
        assert "of the user" in capfd.readouterr().err

    def test_solids_are_refused(self, tmp_path):
        path = gmsh(tmp_path / "solid.msh", np.random.default_rng(0).random((4, 3)), [("tetra", [[0, 1, 2, 3]])])
        with pytest.raises(InputError, match="solid.msh: holds cells of type tetra"):
            read(path)

    @pytest.mark.parametrize("suffix", [".vtu", ".msh", ".msh4", ".obj", ".vtk", ".inp", ".mesh", ".mat"])
    @pytest.mark.filterwarnings("ignore::polyida.mesh.MeshWarning")
    def test_truncated_and_damaged(self, tmp_path, suffix):
        whole, part = tmp_path / f"whole{suffix}", tmp_path / f"part{suffix}"
        write(triangles(1.0, 0.2, 6, 2), whole)
        data, rng = whole.read_bytes(), np.random.default_rng(1)
        for size in rng.integers(0, len(data), 8):
            damaged = bytearray(data)
            damaged[size] = int(rng.integers(256))
            for content in (data[:size], bytes(damaged)):
                part.write_bytes(content)
                try:
                    read(part)
                except InputError as error:
                    assert part.name in str(error)


def test_parametric_nodes_of_gmsh_are_refused_by_name(tmp_path):
    nodes = "3\n1 0 0 0 2 1 0 0\n2 1 0 0 2 1 1 0\n3 0 1 0 2 1 0 1"
    path = tmp_path / "plate.msh"
    path.write_text(
        f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$ParametricNodes\n{nodes}\n$EndParametricNodes\n$Elements\n1\n1 2 2 0 1 1 2 3\n$EndElements\n"
    )
    with pytest.raises(InputError, match=r"\$ParametricNodes are not known; save with Mesh.SaveParametric = 0"):
        read(path)
