"""Reduced plates against the full plates that they are made of: forces, energies, modes, stress, files, and what is wrong with one."""

import numpy as np
import pytest
from scipy.linalg import eigh

import polyida as pi
from polyida.body.plate_modes import rows_of

G = 9.81
MESHES = {"wachspress": lambda: pi.mesh.rectangle(1.0, 0.1, cells=16, seed=2), "virtual": lambda: pi.mesh.quads(1.0, 0.1, 8, 2)}
FULL, FEW = (lambda plate: plate), (lambda plate: pi.Reduced(plate, modes=4))


def rubber(**options):
    return pi.Material(E=50e6, nu=0.3, rho=1100.0, **options)


def driven(body, element="wachspress", material=None, gravity=(0.4, -G)):
    """Two plates, turned and bent at their joint, with every kind of part on them; body: what each is made into."""
    mesh, material = MESHES[element](), material or rubber(viscosity=2e-3, mass_damping=0.3)
    scene = pi.Scene(gravity=gravity)
    upper = scene.add(body(pi.Plate(mesh, material, 0.01, origin=(0.3, 0.2), angle=0.5, name="upper", element=element)))
    end = upper.section("right").point
    lower = scene.add(body(pi.Plate(mesh, material, 0.02, origin=end, angle=-0.4, name="lower", element=element)))
    scene.add(pi.Revolute(pi.ground, upper.section("left"), name="hinge"))
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), pi.profile.sine(0.4, 1.0), name="drive"))
    scene.add(pi.Revolute(upper.section("right"), lower.section("left"), name="elbow"))
    scene.add(pi.PointMass(lower.section("right"), 0.3, name="tip"))
    scene.add(pi.PointLoad(lower.section("right"), (3.0, -1.0), pi.profile.polynomial([1.0, 2.0]), name="pull"))
    scene.add(pi.EdgeTraction(upper.section("top"), (0.0, -30.0), name="wind"))
    scene.add(pi.SpringDamper(pi.ground.at((0.0, -1.0)), lower.section("bottom"), stiffness=40.0, damping=0.5, length=0.5, name="spring"))
    return scene


def free(element="wachspress", body=FEW, **options):
    """The model of one reduced plate without joints or gravity."""
    scene = pi.Scene()
    scene.add(body(pi.Plate(MESHES[element](), rubber(), 0.01, name="plate", element=element, **options)))
    return scene.build()


def draws(model, *sizes):
    """Random vectors of these sizes."""
    random = np.random.default_rng(7)
    return [size * random.standard_normal(model.n) for size in sizes]


def turned(model, angle, shift):
    """Coordinates of a rigid motion of a scene whose pairs are a place and vectors: about the origin, then by the shift."""
    z = model.reference @ (1, 1j)
    moved = z * np.exp(1j * angle) - z
    moved[0] += complex(*shift)
    return np.stack([moved.real, moved.imag], axis=1).ravel()


each_element = pytest.mark.parametrize("element", MESHES)


@each_element
def test_it_is_the_full_plate_in_a_span(element):
    """Virtual work of all forces, inertia, damping and multipliers, and the constraints, are those of full plates at the recovered motion."""
    few, full = driven(FEW, element).build(), driven(FULL, element).build()
    q, v, a, w = draws(few, 0.03, 1.0, 10.0, 1.0)
    lam, t = np.random.default_rng(1).standard_normal(few.m), 0.3
    at = [few.nodal(x).ravel() for x in (q, v, a)]
    one, other = few.residual(t, q, v, a, lam), full.residual(t, *at, lam)
    assert one @ w == pytest.approx(other @ few.nodal(w).ravel(), rel=1e-11)
    assert np.allclose(few.phi(t, q), full.phi(t, at[0]), atol=1e-13)
    assert np.allclose(few.phi_q(t, q) @ v, full.phi_q(t, at[0]) @ at[1], atol=1e-12)
    assert few.strain_energy(q) == pytest.approx(full.strain_energy(at[0]), rel=1e-12)
    assert few.potential(q) == pytest.approx(full.potential(at[0]), rel=1e-12)
    assert np.allclose(few.stress(q, v), full.stress(at[0], at[1]), rtol=1e-12, atol=1e-6)


def hanging(body, hold):
    scene = pi.Scene(gravity=(0.0, -G))
    plate = scene.add(body(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=60, seed=1), rubber(), 0.01, name="plate")))
    hold(scene, plate)
    return scene.build()


def two_pins(scene, plate):
    scene.add(pi.Revolute(pi.ground, plate.section("left")))
    scene.add(pi.Slot(pi.ground.at(plate.section("right").point, direction=(1.0, 0.0)), plate.section("right")))


def one_pin(scene, plate):
    scene.add(pi.Revolute(pi.ground, plate.section("left")))


@pytest.mark.parametrize("hold", [two_pins, one_pin, lambda scene, plate: None], ids=["two pins", "one pin", "free"])
def test_frequencies_come_to_those_of_the_full_plate_from_above(hold):
    """The lowest frequencies of a span are not below those of the whole (Rayleigh and Ritz), and fall as it grows."""
    full = pi.modes(hanging(FULL, hold), count=5).frequencies
    found = [pi.modes(hanging(lambda plate: pi.Reduced(plate, modes=k), hold), count=5).frequencies for k in (3, 6, 12)]  # noqa: B023
    swings = full > 1e-3
    for lower, upper in zip([full, *found[:0:-1]], found[::-1]):
        assert (upper[swings] > lower[swings] * (1 - 1e-9)).all()
    assert np.abs(found[-1][swings] / full[swings] - 1).max() < 2e-3
    assert np.allclose(found[-1][~swings], 0.0, atol=1e-3)


@pytest.mark.parametrize("size", [1e-6, 1e-2, 1e3])
def test_modes_are_those_of_a_plate_of_any_size(size):
    """Static modes for a unit displacement and for a unit rotation have different units of length: as many of both are kept."""

    def frequencies(size):
        mesh = pi.mesh.quads(size, 0.1 * size, 8, 2)
        scene = pi.Scene()
        plate = scene.add(pi.Reduced(pi.Plate(mesh, rubber(), 0.01 * size, name="plate"), modes=6))
        scene.add(pi.Weld(pi.ground, plate.section("left")))
        scene.add(pi.PointMass(plate.section("right"), 0.3 * size**3))
        return size * pi.modes(scene.build(), count=12).frequencies

    assert np.allclose(frequencies(size), frequencies(1.0), rtol=1e-8)


def test_static_equilibrium_is_exact_where_the_span_holds_it():
    """The full plate's own deflection as a field: the equilibrium of the span is the full plate's, though it bends far."""
    state = pi.static(hanging(FULL, two_pins))
    deflected = state.q.reshape(1, -1, 2)
    few = hanging(lambda plate: pi.Reduced(plate, modes=0, fields=deflected), two_pins)
    found = pi.static(few)
    assert few.n == 6
    assert np.abs(few.nodal(found.q) - deflected[0]).max() < 1e-9 < 1e-3 * np.abs(deflected).max()
    assert np.allclose(found.lam, state.lam, rtol=1e-6, atol=1e-6)


def test_pod_modes_of_a_run_bend_farther_than_modes():
    """A soft plate that is let go level: as many fields of its run are off by less than a twentieth of what modes are, which is told."""
    soft, mesh = pi.Material(E=5e6, nu=0.3, rho=1100.0), pi.mesh.rectangle(1.0, 0.1, cells=16, seed=1)

    def swing(body):
        scene = pi.Scene(gravity=(0.0, -G))
        plate = scene.add(body(pi.Plate(mesh, soft, 0.01, name="plate")))
        scene.add(pi.Revolute(pi.ground, plate.section("left")))
        scene.add(pi.AngleMotor(pi.ground, plate.section("left"), 0.0))
        scene.add(pi.PointMass(plate.section("right"), 0.3, name="tip"))
        return pi.solve(scene.build(), 0.6, pi.GeneralizedAlpha(h=1e-3))

    full = swing(FULL)
    fields = pi.pod_modes(full, "plate", 8)
    with pytest.warns(pi.ReductionWarning, match="the modes of 'plate'"):
        modal = swing(lambda plate: pi.Reduced(plate, modes=8))
    own = swing(lambda plate: pi.Reduced(plate, modes=0, fields=fields))
    off = [np.linalg.norm(run.position("tip") - full.position("tip"), axis=1).max() for run in (modal, own)]
    assert own.model.n == modal.model.n == 20
    assert off[1] < off[0] / 20 and "leave much out" not in own.summary()


def test_fields_that_only_move_it_as_rigid_are_refused():
    turn = np.stack([-plate().points[:, 1], plate().points[:, 0]], axis=1)
    for field in (0 * turn, turn, turn + (1.0, 2.0)):
        scene = pi.Scene()
        scene.add(pi.Reduced(plate(), modes=0, fields=[field]))
        with pytest.raises(pi.InputError, match="'arm': its fields only move it as rigid"):
            scene.build()


def plate(**options):
    return pi.Plate(MESHES["virtual"](), rubber(), 0.01, name="arm", **options)


def test_a_file_keeps_the_modes_that_its_run_had(tmp_path, monkeypatch):
    """Where eigenvectors come out with other signs or in another order, frames mean the same all the same."""
    from polyida.body import reduced

    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.Reduced(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=30, seed=1), pi.Material(5e6, 0.3, 1100.0), 0.01), modes=4))
    scene.add(pi.Revolute(pi.ground, bar.section("left")))
    scene.add(pi.PointMass(bar.section("right"), 0.1, name="tip"))
    run, made = pi.solve(scene.build(), 0.05, pi.GeneralizedAlpha(h=1e-3)), reduced.modes_of
    run.save(tmp_path / "run.h5")
    monkeypatch.setattr(reduced, "modes_of", lambda *given: -made(*given)[:, ::-1])
    loaded = pi.load(tmp_path / "run.h5")
    assert np.array_equal(loaded.position("tip"), run.position("tip"))
    assert np.array_equal(loaded.stress(-1), run.stress(-1))
    loaded.save(tmp_path / "again.h5")
    assert np.array_equal(pi.load(tmp_path / "again.h5").position("tip"), run.position("tip"))


def loaded(body):
    """The model of a free plate with three loaded sections, whose static modes are more than the modes that are kept."""
    scene = pi.Scene()
    plate = scene.add(body(pi.Plate(pi.mesh.quads(1.0, 0.2, 6, 2), rubber(), 0.01, name="plate")))
    for side in ("left", "right", "top"):
        scene.add(pi.PointLoad(plate.section(side), (1.0, 0.0), pi.profile.constant(0.0), name=side))
    return scene.build(), plate


def test_fewer_modes_than_sections_are_the_lowest_of_the_span_of_static_modes():
    """Their frequencies lie between those of the full plate and those that Ritz's method gives with the static modes of all sections."""
    full, plate = loaded(FULL)
    C = rows_of(full.n // 2, [plate.section(side) for side in ("left", "right", "top")])[0]
    M, K, none = full.mass().toarray(), full.force_q(0.0, np.zeros(full.n), np.zeros(full.n)).toarray(), np.zeros((len(C),) * 2)
    static = np.linalg.solve(np.block([[K, C.T], [C, none]]), np.eye(full.n + len(C))[:, full.n :])[: full.n]
    above = np.sqrt(eigh(static.T @ K @ static, static.T @ M @ static, eigvals_only=True)[3:]) / (2 * np.pi)
    below = pi.modes(full, count=7).frequencies[3:]
    for count in (1, 2, 4):
        found = pi.modes(loaded(lambda plate, count=count: pi.Reduced(plate, modes=count))[0], count=3 + count).frequencies[3:]
        assert (found < above[:count] * (1 + 1e-6)).all() and (found > below[:count] * (1 - 1e-6)).all()
