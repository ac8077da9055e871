"""The model of polyhedra in space (studies/polyhedra): identities of the mesh, the elements, the step matrix and the runs, with few cells.

The rows of the study itself, with the patch test, orders and gradients, are in test_studies.py.
"""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

import polyida as pi
from polyhedra import cases
from polyhedra.mesh import Mesh, box, read_vtu, triangulated, write_vtu
from polyhedra.model import Pin, Point, Polyhedra

CELLS = 8


@pytest.fixture(scope="module")
def bars():
    return cases.bars(CELLS)


def volume(mesh):
    return sum(np.linalg.det(triangulated(mesh.points[face])[0]).sum() for cell in mesh.cells for face in cell) / 6.0


@pytest.mark.parametrize("lloyd", [0, 5])
def test_cells_fill_the_box(lloyd):
    mesh = box((1.0, 0.5, 0.3), 30, seed=3, lloyd=lloyd)
    assert len(mesh.cells) == 30 and abs(volume(mesh) - 0.15) < 1e-14
    assert abs(sum(mesh.side(0, 1.0).values()) - 1.0) < 1e-14
    edges = np.array([(a, b) for cell in mesh.cells for face in cell for a, b in zip(face, np.roll(face, -1))])
    bare = box((1.0, 0.5, 0.3), 30, seed=3, lloyd=lloyd, short=0.0)
    assert len(bare.points) > len(mesh.points) and abs(volume(bare) - 0.15) < 1e-14
    assert np.linalg.norm(mesh.points[edges[:, 0]] - mesh.points[edges[:, 1]], axis=1).min() > 1e-3


def test_a_mesh_goes_through_a_vtu_file_whatever_the_orientation_of_its_faces(tmp_path):
    mesh = box((1.0, 1.0, 1.0), 12, seed=2)
    write_vtu(
        tmp_path / "mesh.vtu", Mesh(mesh.points, [[face[::-1] if k % 2 else face for k, face in enumerate(cell)] for cell in mesh.cells])
    )
    again = read_vtu(tmp_path / "mesh.vtu")
    assert np.array_equal(again.points, mesh.points)
    assert all(np.array_equal(a, b) for one, two in zip(again.cells, mesh.cells) for a, b in zip(one, two))


def test_a_vtu_file_of_new_versions_of_vtk_is_read(tmp_path):
    mesh = box((1.0, 1.0, 1.0), 12, seed=2)
    faces = [face for cell in mesh.cells for face in cell]
    lists = {"face_connectivity": np.concatenate(faces), "face_offsets": np.cumsum([len(face) for face in faces])}
    lists |= {"polyhedron_to_faces": np.arange(len(faces)), "polyhedron_offsets": np.cumsum([len(cell) for cell in mesh.cells])}
    arrays = {"Points": mesh.points.ravel()} | lists
    text = {k: f'<DataArray Name="{k}" format="ascii">{" ".join(map(repr, x.tolist()))}</DataArray>' for k, x in arrays.items()}
    (tmp_path / "new.vtu").write_text(f"<VTKFile><Points>{text.pop('Points')}</Points><Cells>{''.join(text.values())}</Cells></VTKFile>")
    again = read_vtu(tmp_path / "new.vtu")
    assert np.array_equal(again.points, mesh.points)
    assert all(np.array_equal(a, b) for one, two in zip(again.cells, mesh.cells, strict=True) for a, b in zip(one, two, strict=True))


def test_a_vtu_file_that_cannot_be_read_is_refused(tmp_path):
    appended = '<VTKFile><Points><DataArray format="appended"/></Points><DataArray Name="faces"/></VTKFile>'
    for text in ("<VTKFile><UnstructuredGrid/></VTKFile>", appended):
        (tmp_path / "other.vtu").write_text(text)
        with pytest.raises(pi.InputError, match="polyhedra with faces, in text or base64, neither compressed nor appended"):
            read_vtu(tmp_path / "other.vtu")


def test_rigid_motions_have_no_force_and_masses_are_those_of_the_body(bars):
    mesh, R = box(cases.BAR, CELLS), Rotation.from_rotvec((0.5, 1.5, -1.0)).as_matrix()
    for lumped in (True, False):
        model = Polyhedra([mesh], cases.RUBBER, lumped=lumped)
        f, energy = model.elastic((model.places @ (R - np.eye(3)).T).ravel())
        assert np.abs(f).max() < 1e-6 and energy < 1e-12  # E times an area is 5e5 N
        assert np.abs(model.rotations((model.places @ (R - np.eye(3)).T).ravel()) - R).max() < 1e-12
        x, one = model.places, np.ones((model.count, 1))
        M = model.mass(None)[::3, ::3]
        assert abs((one.T @ (M @ one)).item() - 11.0) < 1e-12
        assert np.abs(one.T @ (M @ x) - 11.0 * np.array([0.5, 0.05, 0.05])).max() < 1e-12
    assert max(pi.check_derivatives(bars[0]).values()) < 1e-6


def test_a_pin_takes_free_nodes(bars):
    mesh = box(cases.BAR, CELLS)
    left = mesh.side(0, 0.0)
    with pytest.raises(pi.InputError, match="held nodes"):
        Polyhedra([mesh], cases.RUBBER, pins=[Pin(Point(0, left), cases.MIDDLE)], held=[(0, k, np.zeros(3)) for k in left])


def test_a_mean_over_a_side_lies_where_it_is_wanted():
    mesh = box(cases.BAR, 30)
    for about in ((1.0, 0.02, 0.05), (1.0, 0.07, 0.03)):
        weights = mesh.side(0, 1.0, about)
        x, w = mesh.points[list(weights)], np.array(list(weights.values()))
        assert abs(w.sum() - 1.0) < 1e-14 and np.abs(w @ x - about).max() < 1e-14
        assert weights.keys() == mesh.side(0, 1.0).keys()
    for wrong in ((0, 0.5), (0, 1.0, (0.9, 0.05, 0.05))):
        with pytest.raises(pi.InputError, match="must be a plane with faces of the mesh"):
            mesh.side(*wrong)


def test_with_one_pin_a_bar_falls():
    """With two it turns about its axis: the row of the hinge in test_studies.py."""
    mesh = box(cases.BAR, CELLS)
    loose = Polyhedra([mesh], cases.RUBBER, (0.0, 0.0, -9.81), [Pin(Point(0, mesh.side(0, 0.0)), cases.MIDDLE)])
    run = pi.solve(loose, 0.2, pi.GeneralizedAlpha(h=1e-3))
    assert loose.place(Point(0, mesh.side(0, 1.0)), run.q[-1])[2] < -0.2


def test_a_hinge_between_bars_lets_one_turn_about_its_axis_only():
    model, v0, _ = cases.bars(CELLS, hinge=True)
    elbow = np.array([1.0, 0.05, 0.05])
    for axis, is_free in zip(np.eye(3), (False, True, False)):
        turn = Rotation.from_rotvec(0.8 * axis).as_matrix() - np.eye(3)
        q = np.where(np.arange(model.count)[:, None] < model.starts[1], 0.0, (model.places - elbow) @ turn.T).ravel()
        apart = np.abs(model.phi(0.0, q)).max()
        assert apart < 1e-15 if is_free else apart > 1e-2
    run = pi.solve(model, 0.02, pi.GeneralizedAlpha(h=1e-3), v0=v0)
    assert model.m == 9 and run.success and np.abs(run.drift).max() < 1e-14


def test_the_step_matrix_turns_with_the_bodies(bars):
    model, random = bars[0], np.random.default_rng(0)
    R, b, zero = Rotation.from_rotvec((0.0, 0.3, 2.0)).as_matrix(), random.standard_normal(model.n), np.zeros(model.n)
    q = (model.places @ (R - np.eye(3)).T).ravel()
    for c in (4e6, 4e6 + 1e6j):
        system = model.step_matrix()
        system.factor(0.0, zero, zero, zero, np.zeros(6), c, 0.0)
        S = model.tangent(0.0, q, zero, zero, np.zeros(6), c, 0.0, 1.0)
        assert np.abs(S @ system.solve(q, b) - b).max() < 1e-4
        assert np.abs(S @ system.columns(q, model.B) - model.B.T).max() < 1e-4 * abs(model.B).max()
        r, phi = 1e3 * b, random.standard_normal(6)
        dq, dlam = system.saddle(0.0, q, np.zeros(6), r, phi)
        assert np.abs(model.B @ dq + phi).max() < 1e-9
        assert np.abs(S @ dq + model.B.T @ dlam + r).max() < 1e-4 * np.abs(dlam).max()


def test_integrators_agree_and_energy_momentum_keeps_its_energy(bars):
    model, v0, tip = bars
    settings = pi.GeneralizedAlpha(h=2e-4, extrapolate=True), pi.EnergyMomentum(h=1e-3), pi.RadauIIA(rtol=1e-7), pi.IDA(rtol=1e-6)
    runs = [pi.solve(model, 0.03, one, v0=v0) for one in settings]
    places = np.array([model.place(tip, run.q[-1]) for run in runs])
    assert all(run.success for run in runs) and np.abs(places - places[2]).max() < 2e-5
    assert np.abs(places[0] - places[2]).max() < 1e-6
    assert np.ptp(runs[1].energy.total) < 1e-9 * np.ptp(runs[1].energy.kinetic)
    assert runs[1].counts.factorizations == 1  # the bars turn by 0.05 rad
    assert {run.counts.backend for run in runs} == {"multifrontal, numpy"}


def test_modes_take_the_step_matrix(monkeypatch):
    model = Polyhedra([box(cases.BAR, 40)], cases.RUBBER, lumped=False)
    K, M = model.force_q(0.0, np.zeros(model.n), None).toarray(), model.M.toarray()
    exact = np.sqrt(eigh(K, M, eigvals_only=True, subset_by_index=(6, 11))) / (2.0 * np.pi)
    for other in ("KKT", "_dense"):
        monkeypatch.setattr(f"polyida.modal.eigen.{other}", None)
    found = pi.modes(model, pi.State(0.0, *np.zeros((3, model.n)), np.zeros(0)), count=12).frequencies
    assert np.abs(found[:6]).max() < 1e-2 and np.abs(found[6:] / exact - 1.0).max() < 1e-9
