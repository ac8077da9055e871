import xml.etree.ElementTree as ET

import meshio
import numpy as np
import pytest

import polyida as pi
from polyida.errors import InputError


def frame(folder, k):
    return meshio.read(folder / f"frame-{k:05d}.vtu")


def test_frames_hold_places_displacements_and_velocities(run, tmp_path):
    pi.export.vtu(run, tmp_path / "frames")
    read = frame(tmp_path / "frames", len(run.t) - 1)
    assert read.points[:, :2] == pytest.approx(run.node_positions(-1), abs=1e-15)
    assert read.points[:, :2] - read.point_data["displacement"][:, :2] == pytest.approx(run.model.reference, abs=1e-14)
    assert read.point_data["velocity"][:, :2] == pytest.approx(run.v[-1].reshape(-1, 2))


def test_every_cell_keeps_its_corners_and_its_stress(run, tmp_path):
    pi.export.vtu(run, tmp_path, frames=[7])
    read, model = frame(tmp_path, 0), run.model
    expected = {}
    first = 0
    for number, body in enumerate(model.bodies):
        for i in range(body.mesh.n_cells):
            expected[tuple(body.mesh.cell(i) + body.nodes.start)] = (run.stress(7)[first + i], run.von_mises(7)[first + i], number)
        first += body.mesh.n_cells
    found = 0
    data = [read.cell_data[name] for name in ("stress", "von Mises", "plate")]
    for block, stress, mises, plate in zip(read.cells, *data):
        assert block.type == {3: "triangle", 4: "quad"}.get(block.data.shape[1], "polygon")
        for corners, s, value, number in zip(block.data, stress, mises, plate):
            right, size, owner = expected[tuple(corners)]
            assert s == pytest.approx(right) and number == owner and value == pytest.approx(size)
            found += 1
    assert found == len(expected)


def test_the_collection_names_every_frame_with_its_time(run, tmp_path):
    collection = pi.export.vtu(run, tmp_path, frames=4)
    sets = ET.parse(collection).findall(".//DataSet")
    assert len(sets) == 4
    assert [float(item.get("timestep")) for item in sets] == pytest.approx(np.linspace(0, 0.04, 4), abs=1.1e-3)
    assert all((tmp_path / item.get("file")).is_file() for item in sets)


def test_frames_are_replaced_only_when_told(run, tmp_path):
    pi.export.vtu(run, tmp_path, frames=5)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds frames already"):
        pi.export.vtu(run, tmp_path, frames=2)
    pi.export.vtu(run, tmp_path, frames=2, overwrite=True)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["frame-00000.vtu", "frame-00001.vtu", "notes.txt", "run.pvd"]
