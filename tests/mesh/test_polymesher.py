"""PolyMesher's MATLAB files: Node, Element, Supp and Load as MATLAB saves them, and what is wrong in them as MATLAB counts."""

import numpy as np
import pytest
from scipy.io import savemat

import polyida as pi
from polyida.errors import InputError
from polyida.mesh import read

NODE = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1.0]])


def cell_array(*rows):
    cells = np.empty((len(rows), 1), dtype=object)
    cells[:, 0] = [np.array([row], float) for row in rows]
    return cells


ELEMENT = cell_array([1, 2, 3, 4], [2, 5, 6, 3])


@pytest.fixture
def saved(tmp_path):
    def save(**variables):
        savemat(tmp_path / "mbb.mat", variables)
        return tmp_path / "mbb.mat"

    return save


class TestRead:
    def test_supports_and_loads_become_sections_and_numbers(self, saved):
        mesh = read(saved(Node=NODE, Element=ELEMENT, Supp=[[1, 1, 1], [4, 1, 0]], Load=[[6, 0, -0.5]], P=np.zeros((2, 2))))
        at = {name: mesh.points[nodes].tolist() for name, nodes in mesh.sections.items()}
        assert at["support"] == at["support x"] == [[0, 0], [0, 1]] and at["support y"] == [[0, 0]] and at["load"] == [[2, 1]]
        assert {tuple(mesh.points[node]): fixed for node, fixed in mesh.supports.items()} == {(0, 0): (True, True), (0, 1): (True, False)}
        assert {tuple(mesh.points[node]): force for node, force in mesh.loads.items()} == {(2, 1): (0.0, -0.5)}

    def test_they_hold_and_load_a_plate(self, saved):
        path = saved(Node=NODE, Element=ELEMENT, Supp=[[1, 1, 1], [4, 1, 1]], Load=[[6, 0, -0.5]])
        mesh, scene = read(path), pi.Scene()
        plate = scene.add(pi.Plate(mesh, pi.Material(5e7, 0.3, 1100.0), 0.01))
        scene.add(pi.Clamp(pi.ground, plate.section("support")))
        for node, force in mesh.loads.items():
            scene.add(pi.PointLoad(plate.node(node), force))
        found = pi.static(scene.build())
        bearing = found.lam.reshape(2, 2).sum(axis=0)
        assert found.stable and np.allclose(np.abs(bearing), [0.0, 0.5], atol=1e-9), "the clamp bears the load"

    def test_a_matrix_of_padded_rows(self, saved):
        for empty in (0, np.nan):
            mesh = read(saved(Node=NODE, Element=np.array([[1, 2, 3, 4], [2, 5, 6, 3], [5, 2, 6, empty]])[:2]))
            triangles = read(saved(Node=NODE, Element=np.array([[1, 2, 3, 4], [2, 5, 6, empty], [2, 6, 3, empty]])))
            assert mesh.n_cells == 2 and sorted(np.diff(triangles.offsets)) == [3, 3, 4]


class TestWrong:
    @pytest.mark.parametrize(
        "change, message",
        [
            (dict(Element=cell_array([0, 1, 2, 3], [1, 4, 5, 2])), r"Element\{1\} names node 0; Node has rows 1..6; MATLAB counts from 1"),
            (dict(Element=cell_array([1, 2, 3, 4], [2, 5, 9, 3])), r"Element\{2\} names node 9; Node has rows 1..6$"),
            (dict(Element=cell_array([1, 2, 3, 4], [2, 5, 2.5, 3])), r"Element\{2\} names node 2.5"),
            (dict(Element=cell_array([1, 2], [2, 5, 6, 3])), r"Element\{1\} has 2 nodes; it needs at least 3"),
            (dict(Element=cell_array([1, 3, 2, 4], [2, 5, 6, 3])), "cell 0 at .* area 0"),
            (dict(Element=np.empty((0, 1), dtype=object)), "no triangles, quads or polygons"),
            (dict(Element="many"), "Element is no array of numbers"),
            (dict(Node=np.where(NODE == 2, np.nan, NODE)), r"Node\(5,:\) is \[nan, 0.0\]; all coordinates must be finite"),
            (dict(Node=NODE.ravel()), "Node has shape"),
            (dict(Node=np.column_stack([NODE, [0, 0, 0, 0, 0, 1]])), r"is not plane: point 5 is \[2.0, 1.0, 1.0\]"),
            (dict(Supp=[[9, 1, 1]]), r"Supp\(1,1\) is 9; it must be a node, 1..6"),
            (dict(Supp=[[1, 0.5, 1]]), "Supp of node 1 is .*must be 1 .fixed. or 0 .free."),
            (dict(Supp=[[1, 1]]), "Supp has shape"),
            (dict(Load=[[1, np.nan, 1]]), r"Load\(1,:\) is \[1.0, nan, 1.0\]"),
            (dict(Load=[[1, 1, 1], [1, 2, 2]]), r"Load\(2,1\) is 1, which an earlier row has"),
        ],
    )
    def test_values(self, saved, change, message):
        with pytest.raises(InputError, match=message) as caught:
            read(saved(**(dict(Node=NODE, Element=ELEMENT) | change)))
        assert "mbb.mat" in str(caught.value)

    def test_files(self, saved, tmp_path):
        with pytest.raises(InputError, match="variables 'x'; PolyMesher's meshes have Node and Element"):
            read(saved(x=1.0))
        newer = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(512)
        for content, message in ((b"", "cannot be read"), (bytes(range(256)), "cannot be read"), (newer, "version 7.3; save it by save")):
            (tmp_path / "bad.mat").write_bytes(content)
            with pytest.raises(InputError, match=f"bad.mat: it .*{message}" if content == newer else message):
                read(tmp_path / "bad.mat")
