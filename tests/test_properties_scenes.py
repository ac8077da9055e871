"""Random meshes, materials, joints and loads: derivatives agree, rigid motions cost nothing, energies balance, files keep every bit."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import polyida as pi
from polyida.assembly.factors import mass_work, stiffness_work
from polyida.assembly.placement import gravity_at
from polyida.results.motion import unbalanced

PROFILE = settings(max_examples=10, phases=(Phase.generate,))
THOROUGH = settings(PROFILE, max_examples=25)


@st.composite
def meshes(draw):
    """A plate 1 m x 0.2 m of random polygons, quadrilaterals or triangles."""
    kind = draw(st.sampled_from(("polygons", "quads", "triangles")))
    if kind == "polygons":
        return pi.mesh.rectangle(1.0, 0.2, cells=draw(st.integers(3, 24)), seed=draw(st.integers(0, 50)))
    return getattr(pi.mesh, kind)(1.0, 0.2, draw(st.integers(1, 8)), draw(st.integers(1, 3)))


@st.composite
def materials(draw, damped=False):
    damping = {"viscosity": draw(st.floats(1e-5, 1e-2)), "mass_damping": draw(st.floats(0.0, 5.0))} if damped else {}
    return pi.Material(
        E=10 ** draw(st.floats(6.5, 9.0)),
        nu=draw(st.floats(-0.4, 0.45)),
        rho=10 ** draw(st.floats(2.5, 4.0)),
        plane=draw(st.sampled_from(("stress", "strain"))),
        **damping,
    )


@st.composite
def plates(draw, name, origin=(0.0, 0.0), damped=False):
    return pi.Plate(
        draw(meshes()),
        draw(materials(damped)),
        draw(st.floats(1e-3, 0.1)),
        origin=origin,
        name=name,
        element=draw(st.sampled_from(("wachspress", "virtual"))),
    )


@st.composite
def scenes(draw, motors=True, loads=True, damped=False):
    """Two plates end to end: a joint to the ground, a joint between them, perhaps a motor, a mass, springs, loads."""
    scene = pi.Scene(gravity=(draw(st.floats(-5, 5)), draw(st.floats(-10, 10))))
    one = scene.add(draw(plates("one", damped=damped)))
    other = scene.add(draw(plates("other", (1.0, 0.0), damped)))
    left, right, next_left = one.section("left"), one.section("right"), other.section("left")
    scene.add(pi.Clamp(left) if draw(st.booleans()) and not motors else pi.Revolute(pi.ground, left, name="root"))
    elbow = draw(st.sampled_from((pi.Revolute, pi.Clamp, pi.Weld, pi.Prismatic, pi.Slot)))
    scene.add(elbow(right, next_left, name="elbow"))
    if draw(st.booleans()):
        end = other.section("right")
        scene.add(pi.SpringDamper(pi.ground.at((1.5, 0.6)), end, draw(st.floats(0.0, 50.0)), preload=draw(st.floats(-1.0, 1.0))))
        scene.add(pi.TorsionSpring(one.section("right"), end, draw(st.floats(0.0, 1.0)), angle=draw(st.floats(-0.5, 0.5))))
        scene.add(pi.PenaltyContact(end, pi.ground.at((0.0, draw(st.floats(-0.1, 0.01)))), 100.0))
    if motors:
        angle = pi.profile.quintic(0.0, draw(st.floats(-0.5, 0.5)), duration=0.3)
        scene.add(pi.AngleMotor(pi.ground, left, angle, name="drive"))
    if draw(st.booleans()):
        scene.add(pi.PointMass(other.section("right"), draw(st.floats(0.01, 5.0))))
    if loads:
        scene.add(pi.PointLoad(other.section("right"), (draw(st.floats(-1, 1)), draw(st.floats(-1, 1))), pi.profile.sine(1.0, 2.0)))
        scene.add(pi.EdgeTraction(one.section("top"), (0.0, draw(st.floats(-10, 10))), pi.profile.ramp(0.0, 1.0, duration=0.2)))
        scene.add(pi.Torque(other.section("right"), pi.profile.sine(draw(st.floats(-0.1, 0.1)), 3.0)))
        scene.add(pi.Force(other.section("right"), (draw(st.floats(-1, 1)), pi.profile.ramp(0.0, 1.0, duration=0.1)), follower=True))
        scene.gravity = (scene.gravity[0], pi.profile.quintic(0.0, scene.gravity[1], 0.1)) if draw(st.booleans()) else scene.gravity
    return scene


def bent(model, seed, size=0.02):
    """A smooth displacement and rates of about that size, (q, v, a, lam)."""
    random, x = np.random.default_rng(seed), model.reference
    waves = [
        random.standard_normal((2, 3)) @ np.array([np.sin(2 * x[:, 0] + k), np.cos(3 * x[:, 1] + k), x[:, 0] * x[:, 1]]) for k in range(3)
    ]
    q, v, a = (size * wave.T.ravel() for wave in waves)
    return q, v, a, random.standard_normal(model.m)


@PROFILE
@given(scene=scenes(damped=True), seed=st.integers(0, 99))
def test_derivatives_of_damped_scenes_agree_with_differences(scene, seed):
    _derivatives(scene.build(), seed)


@THOROUGH
@given(scene=scenes(), seed=st.integers(0, 99))
def test_derivatives_agree_with_differences(scene, seed):
    _derivatives(scene.build(), seed)


def _derivatives(model, seed):
    """Along one random direction: cheap, and a wrong entry shows all the same."""
    q, v, a, lam = bent(model, seed)
    d, t, s = np.random.default_rng(seed + 1).standard_normal(model.n), 0.11, 1e-5

    def along(function):
        return (8 * (function(s) - function(-s)) - function(2 * s) + function(-2 * s)) / (12 * s)

    noise = 1e-14 * np.abs(model.residual(t, q, v, a, lam)).max() / s

    def near(exact, difference, tolerance=1e-6):
        size = max(np.abs(exact).max(initial=0), np.abs(difference).max(initial=0), 1e-9)
        assert np.abs(exact - difference).max(initial=0) <= tolerance * size + noise

    near(model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0) @ d, along(lambda e: model.residual(t, q + e * d, v, a, lam)))
    near(model.tangent(t, q, v, a, lam, 0.0, 1.0, 0.0) @ d, along(lambda e: model.residual(t, q, v + e * d, a, lam)))
    near(model.tangent(t, q, v, a, lam, 1.0, 0.0, 0.0) @ d, along(lambda e: model.residual(t, q, v, a + e * d, lam)))
    near(model.phi_q(t, q) @ d, along(lambda e: model.phi(t, q + e * d)), 1e-7)
    near(model.phi_t(t, q), along(lambda e: model.phi(t + e, q)))
    near(model.phi_bias(t, q, v), along(lambda e: model.phi_q(t + e, q + e * v) @ v + model.phi_t(t + e, q + e * v)), 1e-5)
    near(model.reaction_q(t, q, lam) @ d, along(lambda e: model.phi_q(t, q + e * d).T @ lam))


@THOROUGH
@given(scene=scenes(motors=False, loads=False), seed=st.integers(0, 99))
def test_the_force_is_the_slope_of_the_energy(scene, seed):
    model = scene.build()
    q, v, _, _ = bent(model, seed)
    s, still = 1e-5, np.zeros(model.n)
    slope = (
        8 * (model.potential(q + s * v) - model.potential(q - s * v)) - model.potential(q + 2 * s * v) + model.potential(q - 2 * s * v)
    ) / (12 * s)
    work = model.force(0.0, q, still) @ v
    assert abs(slope - work) <= 1e-6 * max(abs(work), model.strain_energy(q), 1e-9)


@THOROUGH
@given(plate=plates("one"), angle=st.floats(-7, 7), shift=st.tuples(st.floats(-3, 3), st.floats(-3, 3)))
def test_rigid_motions_cost_nothing(plate, angle, shift):
    scene = pi.Scene()
    scene.add(plate)
    model = scene.build()
    c, s = np.cos(angle), np.sin(angle)
    q = (model.reference @ np.array([[c, s], [-s, c]]) + shift - model.reference).ravel()
    stiffness = plate.material.in_plane[0] * plate.thickness
    force = model.force(0.0, q, np.zeros(model.n))
    assert np.abs(force).max() <= 1e-11 * stiffness and model.strain_energy(q) <= 1e-14 * stiffness
    assert np.abs(model.stress(q)).max() <= 1e-11 * plate.material.in_plane[0]


@THOROUGH
@given(plate=plates("one"))
def test_masses_are_those_of_the_body(plate):
    scene = pi.Scene()
    scene.add(plate)
    model, mass = scene.build(), plate.material.rho * plate.thickness * 0.2
    assert model._even_mass.sum() == pytest.approx(mass, rel=1e-12)
    assert model._even_mass @ model.reference[:, 0] @ np.ones(model.n_nodes) == pytest.approx(mass / 2, rel=1e-9)
    assert np.linalg.eigvalsh(model._even_mass.toarray()).min() > 0


@PROFILE
@given(scene=scenes(damped=True), seed=st.integers(0, 99))
def test_cells_scale_by_factors_of_their_own(scene, seed):
    """`w . r` grows by the works of the cells times their factors less one; what belongs to the scaled scene agrees with differences."""
    solid, random, t = scene.build(), np.random.default_rng(seed), 0.11
    given = {body.name: tuple(10 ** random.uniform(-2, 1, (2, body.mesh.n_cells))) for body in solid.bodies}
    (q, v, a, lam), w = bent(solid, seed), random.standard_normal(solid.n)
    scaled, pulled = solid.with_factors(**given), (a.reshape(-1, 2) - gravity_at(solid.gravity, t)).ravel()
    for body in solid.bodies:
        pulled.reshape(-1, 2)[body.nodes] += body.plate.material.mass_damping * v.reshape(-1, 2)[body.nodes]
    works = stiffness_work(scaled, q[None], v[None], w[None]), mass_work(scaled, pulled[None], w[None])
    shares = np.concatenate([(pair[k] - 1.0) * works[k][name] for name, pair in given.items() for k in range(2)])
    one, other = (model.residual(t, q, v, a, lam) for model in (scaled, solid))
    assert abs(w @ (one - other) - shares.sum()) <= 1e-12 * max(np.abs(shares).sum(), np.abs(w * one).sum(), np.abs(w * other).sum())
    _derivatives(scaled, seed)


@PROFILE
@given(scene=scenes(motors=False, loads=False))
def test_energy_and_phi_are_kept_whatever_the_scene(scene):
    model = scene.build()
    run = pi.solve(model, 0.02, pi.EnergyMomentum(h=1e-3))
    turned = max((run.energy.kinetic + run.energy.strain).max(), np.ptp(run.energy.potential), 1e-9)
    assert run.success and np.abs(unbalanced(run)).max() <= 1e-7 * turned and run.drift.max() < 1e-12


@PROFILE
@given(scene=scenes(damped=True, loads=False, motors=False))
def test_damping_only_takes_energy(scene):
    run = pi.solve(scene.build(), 0.02, pi.EnergyMomentum(h=1e-3))
    total = run.energy.total
    assert run.success and (np.diff(total) <= 1e-9 * np.ptp(run.energy.potential) + 1e-12).all()


@PROFILE
@given(scene=scenes())
def test_integrators_agree(scene):
    """Their paths from rest over 20 ms: to a hundredth of the way gone, and a micrometre."""
    model = scene.build()
    runs = [pi.solve(model, 0.02, integrator, output=[0.02]) for integrator in (pi.GeneralizedAlpha(h=2e-4), pi.IDA(rtol=1e-7, atol=1e-9))]
    moved = np.abs(runs[0].q[-1]).max()
    assert all(run.success for run in runs) and np.abs(runs[0].q[-1] - runs[1].q[-1]).max() <= 0.01 * moved + 1e-6
    assert max(run.drift.max() for run in runs) < 1e-9


@PROFILE
@given(
    scene=scenes(),
    method=st.sampled_from((pi.GeneralizedAlpha(h=1e-3), pi.EnergyMomentum(h=1e-3), pi.IDA(rtol=1e-4), pi.RadauIIA(rtol=1e-4))),
)
def test_a_file_keeps_every_bit(scene, method):
    run = pi.solve(scene.build(), 0.005, method)
    with tempfile.TemporaryDirectory() as folder:
        run.save(Path(folder) / "run.h5")
        again = pi.load(Path(folder) / "run.h5")
    assert all(np.array_equal(getattr(run, name), getattr(again, name)) for name in ("t", "q", "v", "a", "lam"))
    assert again.counts == run.counts and again.status == run.status and repr(again.integrator) == repr(run.integrator)
    q, lam = run.q[-1], run.lam[-1]
    same = (again.model.residual(0.1, q, q, q, lam), run.model.residual(0.1, q, q, q, lam))
    assert np.array_equal(*same) and np.array_equal(again.model.phi(0.1, q), run.model.phi(0.1, q))


@THOROUGH
@given(shape=meshes(), kind=st.sampled_from((".vtu", ".vtk", ".msh")))
def test_a_mesh_file_keeps_the_mesh(shape, kind):
    kind = ".vtu" if np.diff(shape.offsets).max() > 4 else kind
    with tempfile.TemporaryDirectory() as folder:
        pi.mesh.write(shape, Path(folder) / f"a{kind}")
        again = pi.mesh.read(Path(folder) / f"a{kind}")
    assert again.n_cells == shape.n_cells and again.n_nodes == shape.n_nodes and again.area == pytest.approx(0.2, rel=1e-13)
    for side in ("left", "right", "top", "bottom"):
        assert len(again.section(side).nodes) == len(shape.section(side).nodes)


@THOROUGH
@given(cells=st.integers(1, 60), seed=st.integers(0, 10**6), ratio=st.floats(0.05, 1.0))
def test_any_rectangle_is_meshed_by_sound_polygons(cells, seed, ratio):
    shape = pi.mesh.rectangle(1.0, ratio, cells=cells, seed=seed)
    shape.require_convex()
    assert shape.area == pytest.approx(ratio, rel=1e-12) and shape.n_nodes - len(shape.edges) + shape.n_cells == 1
    assert any(np.array_equal(point, (0.0, 0.0)) for point in shape.points)
    again = pi.mesh.rectangle(1.0, ratio, cells=cells, seed=seed)
    assert np.array_equal(shape.points, again.points) and np.array_equal(shape.nodes, again.nodes)
