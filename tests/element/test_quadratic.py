"""Quadratic polygons: exact fields, orders, and a plate of order 2 in everything that takes a plate."""

import numpy as np
import pytest
from scipy.sparse import eye_array, kron
from scipy.sparse.linalg import eigsh, spsolve

import polyida as pi
from polyida.body.plate_modes import PlateMatrices

E, NU, THICKNESS = 5e6, 0.3, 0.01
SOFT = pi.Material(E, NU, 1100.0)


def plate(mesh, material=SOFT, **options):
    """A plate of order 2."""
    return pi.Plate(mesh, material, THICKNESS, order=2, name="arm", **options)


def polygon(n, seed=0):
    """One strictly convex polygon of n corners on an ellipse, as a mesh."""
    angles = 2 * np.pi * (np.arange(n) + 0.6 * np.random.default_rng(seed).random(n)) / n
    return pi.mesh.PolygonMesh(np.c_[1.3 * np.cos(angles), 0.8 * np.sin(angles)], np.arange(n), [0, n])


def tractions(mesh, stress):
    """Forces of a stress field (xx, yy, xy) of places on the nodes of one cell, per thickness, by Simpson's rule."""
    nodes, forces = mesh.cell(0), np.zeros((mesh.n_nodes, 2))
    for begin, middle, end in zip(nodes[::2], nodes[1::2], np.roll(nodes[::2], -1)):
        dx, dy = mesh.points[end] - mesh.points[begin]
        for node, share in ((begin, 1 / 6), (middle, 4 / 6), (end, 1 / 6)):
            xx, yy, xy = stress(*mesh.points[node])
            forces[node] += share * np.array([xx * dy - xy * dx, xy * dy - yy * dx])
    return forces


@pytest.mark.parametrize("n", range(3, 11))
def test_linear_and_quadratic_patch_test(n):
    mesh = plate(polygon(n, seed=n)).mesh
    x, y = mesh.points.T
    K = PlateMatrices(plate(mesh)).stiffness
    bending = np.stack([-x * y, x * x / 2 + NU * y * y / 2], axis=1), lambda x, y: (-E * y, 0.0, 0.0)
    c = E / (1 - NU**2)
    sxx, syy, sxy = c * (0.1 + NU * 0.05), c * (0.05 + NU * 0.1), c * (1 - NU) / 2 * 0.2
    stretch = np.stack([0.1 * x + 0.3 * y, -0.1 * x + 0.05 * y], axis=1), lambda x, y: (sxx, syy, sxy)
    for u, stress in (bending, stretch):
        forces = THICKNESS * tractions(mesh, stress)
        np.testing.assert_allclose((K @ u.ravel()).reshape(-1, 2), forces, atol=1e-11 * np.abs(forces).max(), rtol=0)
    sizes = np.linalg.eigvalsh(K.toarray())
    assert (sizes < 1e-11 * sizes[-1]).sum() == 3 and sizes[3] > 1e-4 * sizes[-1], "rigid motions alone have no energy"


def test_mass_is_exact_and_positive():
    mesh = pi.mesh.rectangle(1.0, 0.4, cells=20, seed=1)
    M = PlateMatrices(plate(mesh)).mass / (SOFT.rho * THICKNESS)
    x, y = (plate(mesh).mesh.points - [0.5, 0.0]).T
    assert M.sum() == pytest.approx(0.4, rel=1e-13) and np.linalg.eigvalsh(M.toarray())[0] > 0
    assert x @ M @ x + y @ M @ y == pytest.approx(0.4 * (1.0 + 0.16) / 12, rel=1e-12)
    assert x**2 @ M @ x**2 == pytest.approx(0.4 / 80, rel=1e-12), "products of quadratic fields are integrated exactly"


def energy_error(cells):
    """Relative energy error of a cantilever whose end and root have the tractions and places of a smooth, cubic field (Timoshenko, Goodier)."""
    height = 0.5
    body = plate(pi.mesh.rectangle(1.0, height, cells=cells, seed=1))
    mesh = body.mesh
    x, y = mesh.points.T
    i = height**3 / 12
    ux = -1 / (6 * E * i) * y * ((6 - 3 * x) * x + (2 + NU) * (y * y - height * height / 4))
    uy = 1 / (6 * E * i) * (3 * NU * y * y * (1 - x) + (4 + 5 * NU) * height * height * x / 4 + (3 - x) * x * x)
    exact = np.stack([ux, uy], axis=1).ravel()
    K = PlateMatrices(body).stiffness
    rim = np.concatenate([2 * mesh.boundary_nodes, 2 * mesh.boundary_nodes + 1])
    inner = np.setdiff1d(np.arange(2 * mesh.n_nodes), rim)
    u = exact.copy()
    u[inner] = spsolve(K[inner][:, inner], -K[inner][:, rim] @ exact[rim])
    bent = 1 / (6 * E * i)  # M^2 / (2 E I) and the shear's 3 / (5 G A), with the load 1
    true = bent + 3 / (5 * E / (2 * (1 + NU)) * height)
    return abs(u @ K @ u / 2 / THICKNESS / true - 1.0)


def test_energy_converges_with_order_four():
    coarse, fine = energy_error(160), energy_error(1280)
    assert 2 * np.log(coarse / fine) / np.log(8) == pytest.approx(4.0, abs=0.3)


def frequencies(mesh):
    """The first elastic ones of a free plate, rad/s."""
    matrices = PlateMatrices(plate(mesh))
    squares = eigsh(matrices.stiffness, 6, kron(matrices.mass, eye_array(2)).tocsc(), sigma=-1e2, return_eigenvectors=False)
    return np.sqrt(np.sort(squares)[3:6:2])


def test_frequencies_converge_with_order_four():
    exact = frequencies(pi.mesh.quads(1.0, 0.5, 40, 20))
    coarse, fine = (frequencies(pi.mesh.rectangle(1.0, 0.5, cells=k, seed=1)) / exact - 1.0 for k in (40, 320))
    np.testing.assert_allclose(2 * np.log(coarse / fine) / np.log(8), 4.0, atol=0.4)


def deflection(mesh, height, **options):
    """Deflection of a cantilever of length 1 under an end load over that of Timoshenko's beam, in the material's plane."""
    body = plate(mesh, pi.Material(E, **options))
    (modulus, _), nodes = body.material.in_plane, body.mesh.section("right")
    held = np.repeat(2 * body.mesh.section("left").nodes, 2) + np.tile([0, 1], len(body.mesh.section("left").nodes))
    free, load = np.setdiff1d(np.arange(2 * body.mesh.n_nodes), held), np.zeros((body.mesh.n_nodes, 2))
    load[nodes.nodes, 1] = nodes.weights
    K, u = PlateMatrices(body).stiffness, np.zeros(2 * body.mesh.n_nodes)
    u[free] = spsolve(K[free][:, free], load.ravel()[free])
    beam = 4 / (modulus * THICKNESS * height**3) + 6 / (5 * E / (2 * (1 + body.material.nu)) * height * THICKNESS)
    return load.ravel() @ u / beam


@pytest.mark.parametrize(
    "mesh, height, within",
    [
        (pi.mesh.rectangle(1.0, 0.1, cells=40, seed=1), 0.1, 0.005),
        (pi.mesh.rectangle(1.0, 0.02, cells=40, seed=1), 0.02, 0.002),
        (pi.mesh.quads(1.0, 0.02, 10, 1), 0.02, 0.003),
    ],
)
def test_thin_plates_bend_as_beams(mesh, height, within):
    assert deflection(mesh, height, nu=NU, rho=1e3) == pytest.approx(1.0, abs=within)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_volume_does_not_lock(seed):
    mesh = pi.mesh.rectangle(1.0, 0.1, cells=40, seed=seed)
    assert deflection(mesh, 0.1, nu=0.4999, rho=1e3, plane="strain") == pytest.approx(1.0, abs=0.02)


def test_sections_have_simpson_weights_whatever_selects_them():
    mesh = pi.mesh.rectangle(1.0, 0.2, cells=20, seed=1)
    body = plate(mesh, angle=0.3)
    corners = mesh.sections["top"]
    by_name, by_function, by_corners = (body.section(which) for which in ("top", lambda x: x[:, 1] > 0.1 - 1e-9, corners))
    for one in (by_function, by_corners):
        assert set(one.nodes) == set(by_name.nodes) and len(one.nodes) == 2 * len(corners) - 1
    top = body.mesh.section("top")
    x = body.mesh.points[top.nodes, 0]
    assert top.weights @ x**3 == pytest.approx(0.25, rel=1e-12) and top.length == pytest.approx(1.0, rel=1e-14)
    assert by_name.turn_weights @ (x - 0.5) == pytest.approx(1.0, rel=1e-12)
    assert by_name.turn_weights @ (x - 0.5) ** 3 == pytest.approx((1 / 80) / (1 / 12), rel=2e-2), "int eta x ds / int eta^2 ds"
    traction = pi.EdgeTraction(by_name, (0.0, 2.0))
    assert traction.nodal().sum(axis=0) == pytest.approx([0.0, 2.0 * THICKNESS], rel=1e-13)


def test_meshes_of_both_orders():
    mesh = pi.mesh.rectangle(1.0, 0.2, cells=12, seed=1)
    body = plate(mesh)
    assert body.order == body.mesh.order == 2 and body.mesh is mesh.quadratic and plate(mesh).mesh is body.mesh
    np.testing.assert_array_equal(body.mesh.points[: mesh.n_nodes], mesh.points)
    back = body.mesh.linear
    np.testing.assert_array_equal(back.nodes, mesh.nodes)
    assert pi.Plate(body.mesh, SOFT, THICKNESS).order == 2 and pi.Plate(body.mesh, SOFT, THICKNESS, order=1).mesh.n_nodes == mesh.n_nodes
    assert pi.mesh.refine(body.mesh, [0]).order == pi.design.threshold(body.mesh, np.ones(12)).order == 2
    assert body.mesh.area == pytest.approx(0.2, rel=1e-14) and body.mesh.quality() == back.quality()


@pytest.mark.parametrize(
    "wrong, said",
    [
        (lambda: plate(polygon(5), element="virtual"), "'virtual'"),
        (lambda: pi.Plate(polygon(5), SOFT, THICKNESS, order=3), "order = 3"),
        (lambda: plate(pi.mesh.PolygonMesh([[0, 0], [1, 0], [0.3, 0.3], [0, 1]], [0, 1, 2, 3], [0, 4])), "arm.*not strictly convex"),
        (lambda: pi.mesh.PolygonMesh([[0, 0], [1, 0], [1, 1], [0, 1]], [0, 1, 2, 3], [0, 4], order=2), "cell 0 has 4 nodes"),
    ],
)
def test_wrong_order_and_cells(wrong, said):
    with pytest.raises(pi.InputError, match=said):
        wrong()


def test_stress_at_nodes_of_pure_bending():
    body = plate(pi.mesh.rectangle(1.0, 0.1, cells=10, seed=1))
    scene = pi.Scene()
    scene.add(body)
    model = scene.build()
    x, y = body.mesh.points.T
    kappa = 1e-7
    q = kappa * np.stack([-x * y, x * x / 2 + NU * y * y / 2], axis=1).ravel()
    run = pi.solve(model, 1e-9, pi.GeneralizedAlpha(h=1e-9), q0=q)
    stress = run.stress(0, at="nodes")
    np.testing.assert_allclose(stress, np.outer(-E * kappa * y, [1.0, 0.0, 0.0]), atol=1e-5 * E * kappa * 0.05)
    np.testing.assert_allclose(run.von_mises(0, at="nodes"), np.abs(E * kappa * y), atol=1e-5 * E * kappa * 0.05)
    assert run.von_mises(0).min() > 0.1 * E * kappa * 0.05, "a cell across the whole height has a mean of zero, not this"


def arm(material=SOFT, **options):
    """A plate of order 2 that falls on a hinge, with a mass on its end."""
    scene = pi.Scene((0.0, -9.81))
    body = scene.add(plate(pi.mesh.rectangle(1.0, 0.1, cells=8, seed=1), material, **options))
    scene.add(pi.Revolute(pi.ground, body.section("left"), name="hub"))
    scene.add(pi.PointMass(body.section("right"), 0.05, name="tip"))
    return scene.build()


def test_a_run_its_file_and_its_gradient(tmp_path):
    run = pi.solve(arm(), 0.02, pi.GeneralizedAlpha(h=1e-3))
    run.save(tmp_path / "run.h5")
    back = pi.load(tmp_path / "run.h5")
    assert back.model.parts["arm"].order == 2
    np.testing.assert_array_equal(back.von_mises(-1), run.von_mises(-1))
    differences = pi.check_gradient(run, pi.objective.StrainEnergy("arm"), ["arm.E", "arm.nu", "arm.tau", "arm.stiffness"])
    assert max(differences.values()) < 1e-4
    bars = pi.error_of(run, pi.objective.StrainEnergy("arm"))
    assert bars.mesh is None and "quadratic" in repr(bars)
    with pytest.raises(pi.InputError, match="PeakStress.*'arm' has quadratic cells"):
        pi.objective.PeakStress("arm")(run)


def test_the_mass_of_nodes_in_contact_is_positive():
    body = plate(pi.mesh.rectangle(0.2, 0.1, cells=8, seed=1), origin=(0.0, 0.06))
    scene = pi.Scene((0.0, -9.81))
    scene.add(body)
    scene.add(pi.Contact(body.section("bottom"), pi.ground.at((0.0, 0.0)), contact_mass=0.1, name="floor"))
    M = scene.build().mass(np.zeros(2 * body.mesh.n_nodes)).toarray()
    assert np.linalg.eigvalsh(M)[0] > 0 and M.sum() / 2 == pytest.approx(SOFT.rho * THICKNESS * 0.02, rel=1e-12)


@pytest.mark.parametrize(
    "mesh, options, said",
    [
        (pi.mesh.quads(1.0, 0.02, 20, 2), {}, "bend.: this thin plate bends about 2.6 times as stiff .* order=2"),
        (pi.mesh.quads(1.0, 0.1, 100, 1), {"element": "virtual"}, "times as soft"),
        (pi.mesh.quads(1.0, 0.1, 100, 1), {}, "times as soft"),
        (pi.mesh.triangles(1.0, 0.1, 40, 1), {}, "times as stiff"),
        (pi.mesh.rectangle(1.0, 0.02, cells=40, seed=1), {}, "times as stiff"),
    ],
)
def test_thin_plates_of_linear_cells_are_said_to_bend_wrongly(mesh, options, said):
    scene = pi.Scene()
    scene.add(pi.Plate(mesh, SOFT, THICKNESS, name="bend", **options))
    with pytest.warns(pi.LockingWarning, match=said.replace("bend.", "bend")):
        scene.build()


@pytest.mark.parametrize("name", ["double-plate", "plate-chain"])
def test_no_false_alarm(name, recwarn):
    pi.problems.get(name, cells=40)
    pi.problems.get(name, cells=10, order=2)
    assert not [one for one in recwarn if issubclass(one.category, pi.LockingWarning)]
